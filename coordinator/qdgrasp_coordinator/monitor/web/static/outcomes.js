// Outcomes: where evaluations end, from worst to best.

import { element, keyed, put, say } from "./element.js";
import { count, percent } from "./words.js";

const OUTCOMES = [
  ["error", "Error", "the simulator failed three times"],
  ["dead_end", "Dead end", "no pose worth a simulation"],
  ["overlap", "Overlap", "the open hand is inside the object"],
  ["missed", "Missed", "no finger touched it while closing"],
  ["brushed", "Brushed", "touched while closing, not after"],
  ["dropped", "Dropped", "touched; no shake survived"],
  ["shaken", "Shaken", "one shake survived"],
  ["held", "Held", "both survived: robust"],
];

export class Outcomes {
  constructor(find) {
    this.bar = find("outcomes-bar");
    this.list = find("outcomes");
    this.words = find("outcomes-words");
  }

  show(job, run) {
    const counts = run ? run.outcomes : total(job.runs);
    const whole = Object.values(counts).reduce((sum, each) => sum + each, 0);
    const parts = OUTCOMES.map(([name, title, meaning]) => ({ name, title, meaning, number: counts[name] ?? 0, whole }));
    say(this.words, run || job.runs.length < 2 ? `${count(whole)} genomes` : `${count(whole)} genomes of the runs listed`);
    keyed(this.bar, parts, ({ name }) => name, segment, grow);
    keyed(this.list, parts, ({ name }) => name, entry, tell);
  }
}

function total(runs) {
  const sums = {};
  for (const { outcomes } of runs) {
    for (const [name, number] of Object.entries(outcomes)) sums[name] = (sums[name] ?? 0) + number;
  }
  return sums;
}

function segment({ name }) {
  return element("i", { class: name });
}

function grow(node, { number, whole, title }) {
  node.style.flexGrow = whole ? number / whole : 0;
  node.hidden = !number;
  put(node, "title", `${title}: ${count(number)}`);
}

function entry({ name, title, meaning }) {
  const words = element("span", { class: "what" }, element("b", {}, title), ` ${meaning}`);
  return element("li", {}, element("i", { class: `swatch ${name}` }), words, element("span", { class: "number" }), element("span", { class: "share" }));
}

function tell(node, { number, whole }) {
  put(node, "data-none", number === 0);
  say(node.children[2], count(number));
  say(node.children[3], percent(number, whole));
}
