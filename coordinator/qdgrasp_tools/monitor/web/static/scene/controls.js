// Controls of the view: the legend of colours with its buttons, and the filters of grasps.

import { element, setAttribute, setText, updateChildren } from "../dom.js";
import { count } from "../format.js";
import { keepFilters } from "../job_state.js";
import { ANY } from "./cells.js";

const PARTS = [
  { name: "allowed", words: "may be touched", isThere: ({ mesh }) => mesh.margins },
  { name: "forbidden", words: "may not", isThere: ({ mesh }) => mesh.margins },
  { name: "neighbour", words: "neighbours", isThere: ({ neighbours }) => neighbours },
];

/** The legend of cells: how many show each kind of grasp, which kinds are shown, and the buttons of the view. */
export class Legend {
  #view = null;

  constructor(node) {
    this.kinds = element("ul", { "aria-label": "Cells by the best grasp shown in them; press one to leave out or show such grasps" });
    this.frames = this.#button("Frames", "Draw the frames of a chosen grasp (F)", (view) => (view.showsFrames = !view.showsFrames));
    this.cut = this.#button("Cut open", "Leave out the cells toward you on the right (C)", (view) => (view.cut = !view.cut));
    this.steps = element("div", { class: "steps", hidden: true },
      this.#button("‹", "Previous grasp (P)", (view) => view.step(-1)), this.#button("›", "Next grasp (N)", (view) => view.step(1)),
      this.#button("Whole", "See everything again (Home)", (view) => view.home()), this.cut, this.frames);
    this.parts = element("ul", { class: "parts", "aria-label": "Colours of the object and of what is around it" });
    node.replaceChildren(this.kinds, this.parts, this.steps);
  }

  /** Control this view; null: none. */
  connect(view) {
    this.#view = view;
    this.kinds.replaceChildren();
    this.parts.replaceChildren();
    this.steps.hidden = true;
  }

  /** Show the state of the view. */
  show() {
    const { description, cells, cut, showsFrames } = this.#view;
    this.steps.hidden = false;
    setAttribute(this.cut, "aria-pressed", String(cut));
    setAttribute(this.frames, "aria-pressed", String(showsFrames));
    const kinds = description.kinds.map((kind, k) => ({ ...kind, cells: cells.counts[k], shown: cells.filter.kinds[k] }));
    updateChildren(this.kinds, kinds, ({ outcome }) => outcome, (kind) => this.#made(kind), (item, { cells: number, shown }) => {
      setAttribute(item.firstChild, "aria-pressed", String(shown));
      setText(item.querySelector("b"), shown ? count(number) : "–");
    });
    const parts = PARTS.filter(({ isThere }) => isThere(description));
    updateChildren(this.parts, parts, ({ name }) => name, ({ name, words }) => element("li", {}, swatch(`var(--scene-${name})`), ` ${words}`), () => {});
  }

  #made({ colour, words }) {
    const button = element("button", { type: "button" }, swatch(colour), element("b"), ` ${words}`);
    button.addEventListener("click", () => this.#toggle([...this.kinds.children].indexOf(button.parentNode)));
    return element("li", {}, button);
  }

  #toggle(place) {
    const { kinds } = this.#view.cells.filter;
    this.#view.applyFilter({ kinds: kinds.map((flag, k) => flag !== (k === place)) });
  }

  #button(words, title, action) {
    const button = element("button", { type: "button", class: "quiet", title, "aria-label": title }, words);
    button.addEventListener("click", () => this.#view && action(this.#view));
    return button;
  }
}

function swatch(colour) {
  const node = element("i", { class: "swatch" });
  node.style.background = colour;
  return node;
}

const AXES = ["x", "y", "z"];
const BOUNDS = [
  { name: "penetration", words: "Most penetration [mm]", unit: 1e-3, open: Infinity, step: 0.1 },
  { name: "motion", words: "Most motion [mm]", unit: 1e-3, open: Infinity, step: 0.1, isKnown: (cells) => cells.hasMotions },
  { name: "contacts", words: "Fewest finger links", unit: 1, open: 0, step: 1 },
];
const ALL = Object.fromEntries(BOUNDS.map(({ name, open }) => [name, open]));
const OPEN = { eta: 0, synergy: ANY, ...ALL, low: AXES.map(() => -Infinity), high: AXES.map(() => Infinity) };

/** Filters of grasps by eta, by synergy, by how closing went, and by the hand's position. */
export class FilterControls {
  #view = null;

  /** @param node a details element with its summary */
  constructor(node) {
    this.node = node;
    this.words = node.querySelector("summary span");
    this.eta = element("input", { type: "range", min: 0, max: 1, step: 0.01, value: 0 });
    this.least = element("output");
    this.synergy = element("select");
    this.ends = AXES.map((name) => ["lowest", "highest"].map((end) => this.#input(`${name} ${end} [cm]`, { step: 1, placeholder: end })));
    this.scores = element("label", { class: "sort" }, element("span", {}, "eta at least"), this.eta, this.least);
    this.synergies = element("label", { class: "sort" }, element("span", {}, "Synergy"), this.synergy);
    this.reset = element("button", { type: "button", class: "quiet" }, "Show all");
    this.sorts = element("div", { hidden: true }, this.scores, this.synergies);
    this.bounds = BOUNDS.map((bound) => this.#bound(bound));
    const after = element("fieldset", { class: "bounds" }, element("legend", {}, "After closing"), ...this.bounds.map(({ node }) => node));
    const legend = element("legend", {}, "Hand's position from the centre of mass [cm]");
    const spans = AXES.map((name, axis) => element("div", { class: "bound" }, element("b", {}, name), ...this.ends[axis]));
    const region = element("fieldset", { class: "bounds" }, legend, ...spans);
    node.append(element("div", { class: "filter-form" }, this.sorts, after, region, this.reset));
    this.eta.addEventListener("input", () => this.#apply({ eta: Number(this.eta.value) }));
    this.synergy.addEventListener("change", () => this.#apply({ synergy: this.synergy.value === "" ? ANY : Number(this.synergy.value) }));
    this.reset.addEventListener("click", () => this.#showAll());
  }

  /** Filter what this view shows, from the beginning by some filters; null: there is no view. */
  connect(view, filters = {}) {
    this.#view = view;
    this.node.hidden = !view;
    this.#reset();
    this.eta.value = filters.eta ?? 0;
    for (const { bound, input } of this.bounds) input.value = filters[bound.name] ?? "";
    if (view) view.filter = { eta: Number(this.eta.value), synergy: filters.synergy ?? ANY, ...this.#given() };
  }

  /** Show the state of the view's filter. */
  show() {
    const { description, cells } = this.#view, { filter } = cells;
    this.scores.hidden = !description.scored;
    this.synergies.hidden = !description.synergies.length;
    this.sorts.hidden = this.scores.hidden && this.synergies.hidden;
    const names = [{ value: "", name: "any" }, ...description.synergies.map((name, value) => ({ value, name }))];
    for (const { bound, node } of this.bounds) node.hidden = bound.isKnown?.(cells) === false && filter[bound.name] === bound.open;
    updateChildren(this.synergy, names, ({ value }) => value, ({ value, name }) => element("option", { value }, name), (option, { name }) => setText(option, name));
    this.synergy.value = filter.synergy ?? "";
    setText(this.least, filter.eta.toFixed(2));
    setText(this.words, filter.narrowed ? `${filter.narrowed} in use` : "");
    setAttribute(this.reset, "disabled", !filter.narrowed);
  }

  #showAll() {
    this.#reset();
    this.#apply(OPEN);
  }

  /** Filter by this too, and keep in the address what is filtered by; the hand's position is not kept. */
  #apply(part) {
    if (!this.#view) return;
    this.#view.applyFilter(part);
    const { eta, synergy } = this.#view.cells.filter;
    const bounds = this.bounds.map(({ bound, input }) => [bound.name, number(input)]);
    keepFilters({ eta: eta || NaN, synergy: synergy === ANY ? NaN : synergy, ...Object.fromEntries(bounds) });
  }

  /** The bounds as a part of a filter: float32, as the quantities are. */
  #given() {
    const part = this.bounds.map(({ bound, input }) => [bound.name, input.value === "" ? bound.open : Math.fround(bound.unit * number(input))]);
    const [low, high] = [-Infinity, Infinity].map((open, end) => this.ends.map((inputs) => (inputs[end].value === "" ? open : inputs[end].valueAsNumber)));
    return { ...Object.fromEntries(part), low, high };
  }

  #bound(bound) {
    const input = this.#input(bound.words, { min: 0, step: bound.step, placeholder: "any" });
    return { bound, input, node: element("label", { class: "bound" }, element("span", {}, bound.words), input) };
  }

  #input(words, looks) {
    const input = element("input", { type: "number", inputmode: "decimal", "aria-label": words, ...looks });
    input.addEventListener("input", () => this.#apply(this.#given()));
    return input;
  }

  /** Set all controls so that they leave nothing out. */
  #reset() {
    this.eta.value = 0;
    this.synergy.value = "";
    for (const input of [...this.bounds.map((bound) => bound.input), ...this.ends.flat()]) input.value = "";
  }
}

/** The number in an input, 0 or more; NaN where there is none. */
function number(input) {
  return input.value === "" ? NaN : Math.max(0, input.valueAsNumber);
}
