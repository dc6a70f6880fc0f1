// The best grasps as small pictures, and what a run was asked for.

import { element, setAttribute, setText, updateChildren } from "./dom.js";
import { several } from "./format.js";

const MOST = 12; // pictures
const PAUSE = 1000; // ms between two looks at which grasps are the best

/** The best grasps that pass the filters, each a button with a picture that selects it. */
export class Gallery {
  #view = null;
  #timer = 0;
  #looked = -Infinity;

  /** @param node a details element with its summary */
  constructor(node) {
    this.node = node;
    this.words = node.querySelector("summary span");
    this.list = element("ol", { "aria-label": "The best grasps, the best first; press one to select it" });
    node.append(this.list);
    node.addEventListener("toggle", () => this.#look());
  }

  /** Show grasps of this view; null: none. */
  connect(view) {
    clearTimeout(this.#timer);
    this.#timer = 0;
    this.#looked = -Infinity;
    this.#view = view;
    this.node.hidden = true;
    this.list.replaceChildren();
  }

  /** Show what is the best now, not more often than each second. */
  show() {
    this.node.hidden = !this.#view.cells.shown;
    if (this.#timer) return;
    this.#timer = setTimeout(() => this.#look(), Math.max(0, this.#looked + PAUSE - performance.now()));
  }

  /** Mark the selected grasp; null: none is. */
  mark(number) {
    for (const item of this.list.children) setAttribute(item.firstChild, "aria-pressed", String(item.dataset.key === String(number)));
  }

  #look() {
    clearTimeout(this.#timer);
    this.#timer = 0;
    const view = this.#view;
    if (!view?.objects || !this.node.open) return;
    this.#looked = performance.now();
    const best = view.cells.best(MOST), { kinds, origin } = view.description;
    setText(this.words, `${best.length} of ${several(view.cells.shown, "cell")}`);
    updateChildren(this.list, best, ({ number }) => number, (grasp) => this.#made(grasp, kinds[grasp.kind], origin), () => {});
    this.mark(view.selected);
  }

  #made({ number, penetration }, { colour, words }, origin) {
    const picture = element("img", { src: `${this.#view.client.root}/grasps/${number}/picture?of=${origin}`, alt: "", width: 132, height: 108, loading: "lazy", decoding: "async" });
    const swatch = element("i", { class: "swatch" });
    swatch.style.background = colour;
    const depth = `${(1000 * penetration).toFixed(1)} mm`;
    const button = element("button", { type: "button", "aria-label": `Grasp ${number}: ${words}, penetration ${depth}`, title: `${words}, penetration ${depth}` }, picture, element("span", {}, swatch, String(number)));
    button.addEventListener("click", () => this.#view.select(number));
    return element("li", {}, button);
  }
}
