// The key: what the colours of cells mean, how many there are of each, and which are shown; it also steers the view.

import { element, keyed, put, say } from "../element.js";
import { count } from "../words.js";

export class Key {
  #view = null;

  constructor(node) {
    this.kinds = element("ul", { "aria-label": "Cells by the best grasp shown in them; press one to leave out or show such grasps" });
    this.frames = this.#button("Frames", "Draw the frames of a chosen grasp (F)", (view) => (view.framed = !view.framed));
    this.cut = this.#button("Cut open", "Leave out the cells toward you on the right (C)", (view) => (view.cut = !view.cut));
    this.steps = element("div", { class: "steps" },
      this.#button("‹", "Previous grasp (P)", (view) => view.step(-1)), this.#button("›", "Next grasp (N)", (view) => view.step(1)),
      this.#button("Whole", "See everything again (Home)", (view) => view.home()), this.cut, this.frames);
    node.replaceChildren(this.kinds, this.steps);
  }

  /** Steer this view; null: none. */
  steer(view) {
    this.#view = view;
    this.kinds.replaceChildren();
    this.steps.hidden = true;
  }

  /** Show what the view shows now. */
  show() {
    const { told, cells, cut, framed } = this.#view;
    this.steps.hidden = false;
    put(this.cut, "aria-pressed", String(cut));
    put(this.frames, "aria-pressed", String(framed));
    const kinds = told.kinds.map((kind, k) => ({ ...kind, cells: cells.counts[k], shown: cells.filter.kinds[k] }));
    keyed(this.kinds, kinds, ({ outcome }) => outcome, (kind) => this.#made(kind), (item, { cells: number, shown }) => {
      put(item.firstChild, "aria-pressed", String(shown));
      say(item.querySelector("b"), shown ? count(number) : "–");
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
    const { kinds } = this.#view.cells.filter;
    this.#view.sift({ kinds: kinds.map((flag, k) => flag !== (k === place)) });
  }

  #button(words, title, action) {
    const button = element("button", { type: "button", class: "quiet", title, "aria-label": title }, words);
    button.addEventListener("click", () => this.#view && action(this.#view));
    return button;
  }
}
