// The axes of the object's frame, and a bar that says how large things are; drawn over the canvas as text and lines.

const SVG = "http://www.w3.org/2000/svg";
const NAMES = ["x", "y", "z"];
const HEIGHT = 92; // px, as the style sheet says: little to draw anew while the view turns
const ARM = 26; // px
const LENGTHS = [0.05, 0.02, 0.01, 0.005, 0.1, 0.2, 0.5]; // m: the first that fits
const SHORTEST = 28, LONGEST = 150; // px

export function made(parent, tag, attributes = {}) {
  const node = document.createElementNS(SVG, tag);
  for (const [name, value] of Object.entries(attributes)) node.setAttribute(name, value);
  parent.append(node);
  return node;
}

export class Axes {
  constructor(parent) {
    this.node = made(parent, "svg", { class: "scene-axes", "aria-hidden": "true" });
    this.#arms = NAMES.map((name) => {
      const line = made(this.node, "line"), word = made(this.node, "text");
      word.textContent = name;
      return { line, word };
    });
    this.#bar = made(this.node, "line");
    this.#words = made(this.node, "text");
  }

  #arms;
  #bar;
  #words;

  /** Draw for a canvas of this width [px], seen along these axes, with so many pixels in a metre. */
  draw({ width, right, up, scale }) {
    NAMES.forEach((name, k) => this.#arm(this.#arms[k], 44, HEIGHT - 42, right[name], -up[name]));
    const length = LENGTHS.find((each) => each * scale > SHORTEST && each * scale < LONGEST) ?? LENGTHS.at(-1);
    const x = width - 18, y = HEIGHT - 16;
    put(this.#bar, { x1: x - length * scale, x2: x, y1: y, y2: y });
    put(this.#words, { x: x - (length * scale) / 2, y: y - 7 });
    const words = `${100 * length} cm`;
    if (this.#words.textContent !== words) this.#words.textContent = words;
  }

  #arm({ line, word }, x, y, dx, dy) {
    put(line, { x1: x, y1: y, x2: x + ARM * dx, y2: y + ARM * dy });
    put(word, { x: x + 1.42 * ARM * dx, y: y + 1.42 * ARM * dy + 4 });
  }

  dispose() {
    this.node.remove();
  }
}

export function put(node, attributes) {
  for (const [name, value] of Object.entries(attributes)) node.setAttribute(name, value.toFixed(1));
}
