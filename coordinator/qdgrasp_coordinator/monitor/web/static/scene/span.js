// A span: two handles on one line, between which something is shown; a handle at its end leaves nothing out there.

import { element, put, say } from "../element.js";

export class Span {
  #least = 0;
  #most = 0;

  /** `onchange(low, high)`: where the handles stand; infinite at the ends. */
  constructor(name, onchange) {
    this.name = name;
    this.onchange = onchange;
    this.low = this.#handle("lowest");
    this.high = this.#handle("highest");
    this.words = element("output");
    this.node = element("div", { class: "span" }, element("b", {}, name), element("span", { class: "track" }, this.low, this.high), this.words);
  }

  /** Reach from the least to the most there is; what stood at an end stays there. */
  reach(least, most) {
    if (least === this.#least && most === this.#most) return;
    const low = this.from, high = this.upto;
    [this.#least, this.#most] = [least, most];
    for (const handle of [this.low, this.high]) {
      put(handle, "min", least);
      put(handle, "max", most);
    }
    this.low.value = Number.isFinite(low) ? low : least;
    this.high.value = Number.isFinite(high) ? high : most;
    this.#say();
  }

  /** Leave nothing out. */
  open() {
    this.low.value = this.#least;
    this.high.value = this.#most;
    this.#say();
  }

  get from() {
    return Number(this.low.value) > this.#least ? Number(this.low.value) : -Infinity;
  }

  get upto() {
    return Number(this.high.value) < this.#most ? Number(this.high.value) : Infinity;
  }

  #handle(end) {
    const handle = element("input", { type: "range", step: 1, min: 0, max: 0, "aria-label": `${this.name} ${end} [cm]` });
    handle.addEventListener("input", () => this.#moved(end));
    return handle;
  }

  /** A handle takes the other along, rather than go beyond it; so two in one place can be drawn either way. */
  #moved(end) {
    const [mine, other] = end === "lowest" ? [this.low, this.high] : [this.high, this.low];
    if (Number(this.low.value) > Number(this.high.value)) other.value = mine.value;
    this.#say();
    this.onchange(this.from, this.upto);
  }

  #say() {
    const word = (value) => String(value).replace("-", "−");
    say(this.words, `${word(this.low.value)} to ${word(this.high.value)}`);
  }
}
