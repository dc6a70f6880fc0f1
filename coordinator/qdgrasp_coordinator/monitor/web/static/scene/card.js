// The card: the numbers of a chosen grasp, and what replays it.

import { element } from "../element.js";

const MILLIMETRES = (values) => `${values.map((value) => (1000 * value).toFixed(1)).join(", ")} mm`;

export class Card {
  constructor(node, onclose) {
    this.node = node;
    this.onclose = onclose;
  }

  /** Show what the server says of a grasp; null: nothing. */
  show(grasp) {
    this.node.hidden = !grasp;
    if (grasp) this.node.replaceChildren(this.#header(grasp), figures(grasp), joints(grasp), replay(grasp));
  }

  #header({ number }) {
    const close = element("button", { type: "button", class: "quiet", "aria-label": "Close" }, "×");
    close.addEventListener("click", () => this.onclose());
    return element("header", {}, element("h4", {}, `Grasp ${number}`), close);
  }
}

function figures({ words, fitness, cell, position, quaternion }) {
  const lines = [
    ["Outcome", words], ["Fitness", String(fitness)], ["Cell", cell.join(", ")],
    ["Position", MILLIMETRES(position)], ["Quaternion", quaternion.map((part) => part.toFixed(3)).join(", ")],
  ];
  return element("dl", {}, ...lines.map(([name, value]) => element("div", {}, element("dt", {}, name), element("dd", {}, value))));
}

function joints({ joints: positions }) {
  const lines = Object.entries(positions).map(([name, value]) => element("div", {}, element("dt", {}, name), element("dd", {}, value.toFixed(4))));
  return element("details", {}, element("summary", {}, `${lines.length} joints [rad or m]`), element("dl", {}, ...lines));
}

function replay({ command }) {
  const copy = element("button", { type: "button", class: "quiet" }, "Copy");
  copy.addEventListener("click", async () => {
    try {
      await navigator.clipboard.writeText(command);
      copy.textContent = "Copied";
    } catch {
      copy.textContent = "Select it"; // a page that is not served over TLS may not copy
    }
  });
  return element("div", { class: "replay" }, element("code", { tabindex: "0" }, command), copy);
}
