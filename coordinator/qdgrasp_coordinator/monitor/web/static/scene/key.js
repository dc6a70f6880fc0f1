// The key: what the colours of cells mean, how many there are of each, and which are shown; it also steers the view.

import { element, keyed, put, say } from "../element.js";
import { count } from "../words.js";

export class Key {
  #view = null;

  constructor(node) {
    this.kinds = element("ul", { "aria-label": "Cells by the best grasp in them; press one to hide or show its cells" });
    this.cut = this.#button("Cut open", "Leave out the cells toward you on the right (C)", (view) => (view.cut = !view.cut));
    this.steps = element("div", { class: "steps" },
      this.#button("‹", "Previous grasp (P)", (view) => view.step(-1)), this.#button("›", "Next grasp (N)", (view) => view.step(1)),
      this.#button("Whole", "See everything again (Home)", (view) => view.home()), this.cut);
    node.replaceChildren(this.kinds, this.steps);
  }

  /** Steer this view; null: none. */
  steer(view) {
    this.#view = view;
    this.kinds.replaceChildren();
    this.steps.hidden = true;
  }

  /** Show the kinds as a view tells them. */
  show(kinds) {
    this.steps.hidden = false;
    put(this.cut, "aria-pressed", String(this.#view.cut));
    keyed(this.kinds, kinds, ({ outcome }) => outcome, (kind) => this.#made(kind), (item, { count: cells, shown }) => {
      put(item.firstChild, "aria-pressed", String(shown));
      say(item.querySelector("b"), count(cells));
    });
  }

  #made({ colour, words }) {
    const swatch = element("i", { class: "swatch" });
    swatch.style.background = colour;
    const button = element("button", { type: "button" }, swatch, element("b"), ` ${words}`);
    button.addEventListener("click", () => this.#toggle([...this.kinds.children].indexOf(button.parentNode)));
    return element("li", {}, button);
  }

  #toggle(place) {
    this.#view.shown = this.#view.shown.map((flag, k) => flag !== (k === place));
  }

  #button(words, title, action) {
    const button = element("button", { type: "button", class: "quiet", title, "aria-label": title }, words);
    button.addEventListener("click", () => this.#view && action(this.#view));
    return button;
  }
}
