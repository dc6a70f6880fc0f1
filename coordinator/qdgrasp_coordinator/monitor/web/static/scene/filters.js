// Filters: which grasps are shown, by eta, by synergy, and by where the hand is.

import { element, keyed, put, say } from "../element.js";
import { ANY } from "./filter.js";
import { Span } from "./span.js";

const AXES = ["x", "y", "z"];
const OPEN = { eta: 0, synergy: ANY, low: AXES.map(() => -Infinity), high: AXES.map(() => Infinity) };

export class Filters {
  #view = null;

  /** @param node a details element with its summary */
  constructor(node) {
    this.node = node;
    this.words = node.querySelector("summary span");
    this.eta = element("input", { type: "range", min: 0, max: 1, step: 0.01, value: 0 });
    this.least = element("output");
    this.synergy = element("select");
    this.spans = AXES.map((name, axis) => new Span(name, (low, high) => this.#bound(axis, low, high)));
    this.scores = element("label", { class: "sort" }, element("span", {}, "eta at least"), this.eta, this.least);
    this.synergies = element("label", { class: "sort" }, element("span", {}, "Synergy"), this.synergy);
    this.reset = element("button", { type: "button", class: "quiet" }, "Show all");
    this.sorts = element("div", { hidden: true }, this.scores, this.synergies);
    const legend = element("legend", {}, "Hand's position from the centre of mass [cm]");
    const region = element("fieldset", {}, legend, ...this.spans.map((span) => span.node));
    node.append(element("div", { class: "sieve" }, this.sorts, region, this.reset));
    this.eta.addEventListener("input", () => this.#sift({ eta: Number(this.eta.value) }));
    this.synergy.addEventListener("change", () => this.#sift({ synergy: this.synergy.value === "" ? ANY : Number(this.synergy.value) }));
    this.reset.addEventListener("click", () => this.#open());
  }

  /** Filter what this view shows; null: there is none. */
  steer(view) {
    this.#view = view;
    this.node.hidden = !view;
    this.#rest();
  }

  /** Show what the view's filter lets pass now. */
  show() {
    const { told, cells } = this.#view, { filter } = cells;
    this.scores.hidden = !told.scored;
    this.synergies.hidden = !told.synergies.length;
    this.sorts.hidden = this.scores.hidden && this.synergies.hidden;
    const names = [{ value: "", name: "any" }, ...told.synergies.map((name, value) => ({ value, name }))];
    keyed(this.synergy, names, ({ value }) => value, ({ value, name }) => element("option", { value }, name), (option, { name }) => say(option, name));
    this.spans.forEach((span, axis) => cells.size && span.reach(cells.low[axis], cells.high[axis]));
    say(this.least, filter.eta.toFixed(2));
    say(this.words, filter.narrowed ? `${filter.narrowed} in use` : "");
    put(this.reset, "disabled", !filter.narrowed);
  }

  #bound(axis, low, high) {
    const { filter } = this.#view.cells;
    this.#sift({ low: filter.low.with(axis, low), high: filter.high.with(axis, high) });
  }

  #open() {
    this.#rest();
    this.#sift(OPEN);
  }

  #sift(part) {
    this.#view?.sift(part);
  }

  /** Have all controls leave nothing out. */
  #rest() {
    this.eta.value = 0;
    this.synergy.value = "";
    for (const span of this.spans) span.open();
  }
}
