// Events: what happened lately, the newest first.

import { element, keyed, put, say } from "./element.js";
import { time } from "./words.js";

export class Events {
  constructor(find) {
    this.root = find("events");
  }

  show({ events }, run) {
    const shown = events.filter((event) => !run || !event.run || event.run === run.run).toReversed();
    keyed(this.root, shown, ({ at, number }) => `${at} ${number}`, make, () => {});
    put(this.root, "data-none", shown.length === 0);
  }
}

function make({ at, kind, words, run }) {
  const date = new Date(at);
  return element(
    "li",
    { "data-kind": kind },
    element("time", { datetime: at, title: date.toLocaleString() }, time(date)),
    element("span", { class: "kind" }, kind),
    element("span", { class: "words" }, words, run && !words.includes(run) ? element("span", { class: "faint" }, ` ${run}`) : ""),
  );
}
