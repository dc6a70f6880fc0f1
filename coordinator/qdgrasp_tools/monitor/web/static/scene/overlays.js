// Drawn over the canvas as SVG: the axes of the object's frame with a scale bar, the frames of a grasp, and its contacts.

import { Vector3 } from "../vendor/three/three.module.min.js";

const SVG = "http://www.w3.org/2000/svg";
const NAMES = ["x", "y", "z"];
const HEIGHT = 92; // px, as the style sheet says: little to draw anew while the view turns
const ARM = 26; // px
const LENGTHS = [0.05, 0.02, 0.01, 0.005, 0.1, 0.2, 0.5]; // m: the first that fits
const SHORTEST = 28, LONGEST = 150; // px

function svgNode(parent, tag, attributes = {}) {
  const node = document.createElementNS(SVG, tag);
  for (const [name, value] of Object.entries(attributes)) node.setAttribute(name, value);
  parent.append(node);
  return node;
}

/** The directions of the object's axes, and a bar that shows the scale. */
export class AxesOverlay {
  constructor(parent) {
    this.node = svgNode(parent, "svg", { class: "scene-axes", "aria-hidden": "true" });
    this.#arms = NAMES.map((name) => {
      const line = svgNode(this.node, "line"), word = svgNode(this.node, "text");
      word.textContent = name;
      return { line, word };
    });
    this.#bar = svgNode(this.node, "line");
    this.#words = svgNode(this.node, "text");
  }

  #arms;
  #bar;
  #words;

  /** Draw for a canvas of this width [px], seen along these axes, with so many pixels in a metre. */
  draw({ width, right, up, scale }) {
    NAMES.forEach((name, k) => this.#arm(this.#arms[k], 44, HEIGHT - 42, right[name], -up[name]));
    const length = LENGTHS.find((each) => each * scale > SHORTEST && each * scale < LONGEST) ?? LENGTHS.at(-1);
    const x = width - 18, y = HEIGHT - 16;
    setNumbers(this.#bar, { x1: x - length * scale, x2: x, y1: y, y2: y });
    setNumbers(this.#words, { x: x - (length * scale) / 2, y: y - 7 });
    const words = `${100 * length} cm`;
    if (this.#words.textContent !== words) this.#words.textContent = words;
  }

  #arm({ line, word }, x, y, dx, dy) {
    setNumbers(line, { x1: x, y1: y, x2: x + ARM * dx, y2: y + ARM * dy });
    setNumbers(word, { x: x + 1.42 * ARM * dx, y: y + 1.42 * ARM * dy + 4 });
  }

  dispose() {
    this.node.remove();
  }
}

function setNumbers(node, attributes) {
  for (const [name, value] of Object.entries(attributes)) node.setAttribute(name, value.toFixed(1));
}

const IDENTITY = [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1];
const FRAME_ARM = 0.04; // m: an axis of a frame,
const LEAST_ARM = 26; // px: and not shorter than that around large objects
const LETTER = 6.8; // px: about as wide as one
const SAME = 1e-6; // m: nearer than that the mesh file's frame is the object's

/** The axes of the object's frame, of its mesh file's and of the hand's base, with their names. */
export class FrameOverlay {
  #frames = [];
  #isShown = true;

  constructor(parent) {
    this.node = svgNode(parent, "svg", { class: "scene-frames", "aria-hidden": "true" });
  }

  /** Show the frames of a grasp in a described scene, the hand's at `hand`, 4 x 4 row by row; without it: none. */
  show(description, hand) {
    this.node.replaceChildren();
    this.#frames = hand ? framesOf(description, hand).map((frame) => this.#drawn(frame)) : [];
  }

  set shown(value) {
    this.#isShown = value;
    this.node.toggleAttribute("hidden", !value);
  }

  get shown() {
    return this.#isShown;
  }

  /** Draw the frames where the projection puts them. */
  draw(projection) {
    if (!this.#isShown) return;
    const length = Math.max(FRAME_ARM, LEAST_ARM / projection.scale);
    for (const { matrix, arms, name } of this.#frames) {
      const origin = new Vector3(matrix[3], matrix[7], matrix[11]), from = projected(projection, origin);
      const tips = arms.map((_, k) => projected(projection, new Vector3(matrix[k], matrix[4 + k], matrix[8 + k]).multiplyScalar(length).add(origin)));
      arms.forEach(({ line, letter }, k) => {
        setNumbers(line, { x1: from[0], y1: from[1], x2: tips[k][0], y2: tips[k][1] });
        setNumbers(letter, { x: from[0] + 1.2 * (tips[k][0] - from[0]), y: from[1] + 1.2 * (tips[k][1] - from[1]) + 4 });
      });
      const away = from[0] < (tips[0][0] + tips[1][0] + tips[2][0]) / 3 ? -1 : 1; // from the arms
      const end = from[0] + away * (8 + LETTER * name.textContent.length), side = end > 0 && end < projection.width ? away : -away;
      setNumbers(name, { x: from[0] + 8 * side, y: from[1] + 16 });
      name.setAttribute("text-anchor", side < 0 ? "end" : "start");
    }
  }

  dispose() {
    this.node.remove();
  }

  #drawn({ name: words, matrix, kind }) {
    const group = svgNode(this.node, "g", { class: kind });
    const arms = NAMES.map((axis) => {
      const arm = svgNode(group, "g", { class: axis });
      const line = svgNode(arm, "line"), letter = svgNode(arm, "text");
      letter.textContent = axis;
      return { line, letter };
    });
    const name = svgNode(group, "text", { class: "name" });
    name.textContent = words;
    return { matrix, arms, name };
  }
}

function framesOf({ com_in_mesh: com, base }, frame) {
  const object = { name: "object (centre of mass)", matrix: IDENTITY, kind: "object" };
  const mesh = { name: "mesh file", matrix: IDENTITY.with(3, -com[0]).with(7, -com[1]).with(11, -com[2]), kind: "mesh" };
  const hand = { name: `hand (${base})`, matrix: frame, kind: "hand" };
  return Math.hypot(...com) > SAME ? [mesh, object, hand] : [object, hand];
}

const NORMAL = 0.018; // m
const RADIUS = 4; // px

/** Contacts: a dot each, and the normal of the object there. */
export class ContactOverlay {
  #marks = [];

  constructor(parent) {
    this.node = svgNode(parent, "svg", { class: "scene-contacts", "aria-hidden": "true" });
  }

  /** Show contacts as the server tells them; none: an empty list. */
  show(contacts) {
    this.node.replaceChildren();
    this.#marks = contacts.map(({ finger, point, normal }) => {
      const group = svgNode(this.node, "g", { class: finger ? "finger" : "other" });
      const from = new Vector3(...point), to = new Vector3(...normal).multiplyScalar(-NORMAL).add(from);
      return { from, to, line: svgNode(group, "line"), dot: svgNode(group, "circle", { r: RADIUS }) };
    });
  }

  /** Draw the contacts where the projection puts them. */
  draw(projection) {
    for (const { from, to, line, dot } of this.#marks) {
      const [x1, y1] = projected(projection, from), [x2, y2] = projected(projection, to);
      setNumbers(line, { x1, y1, x2, y2 });
      setNumbers(dot, { cx: x1, cy: y1 });
    }
  }

  dispose() {
    this.node.remove();
  }
}

/** The pixel at which a place appears. */
function projected({ camera, right, up, scale, width, height }, place) {
  const away = place.clone().sub(camera.position);
  return [width / 2 + away.dot(right) * scale, height / 2 - away.dot(up) * scale];
}
