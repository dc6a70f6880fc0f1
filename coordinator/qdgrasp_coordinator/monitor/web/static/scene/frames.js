// Frames: the axes of the object's frame, of its mesh file's, and of the hand's base, named and seen through everything.

import { Vector3 } from "../vendor/three/three.module.min.js";
import { made, put } from "./axes.js";

const NAMES = ["x", "y", "z"];
const IDENTITY = [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1];
const ARM = 0.04; // m
const LETTER = 6.8; // px: about as wide as one
const SAME = 1e-6; // m: nearer than that the mesh file's frame is the object's

export class Frames {
  #frames = [];
  #isShown = true;

  constructor(parent) {
    this.node = made(parent, "svg", { class: "scene-frames", "aria-hidden": "true" });
  }

  /** Show those of a grasp on the stage that the server tells of; without a grasp: none. */
  show(told, grasp) {
    this.node.replaceChildren();
    this.#frames = grasp ? framesOf(told, grasp).map((frame) => this.#drawn(frame)) : [];
  }

  set shown(value) {
    this.#isShown = value;
    this.node.toggleAttribute("hidden", !value);
  }

  get shown() {
    return this.#isShown;
  }

  /** Draw as a lens sees them. */
  draw(lens) {
    if (!this.#isShown) return;
    for (const { matrix, arms, name } of this.#frames) {
      const origin = new Vector3(matrix[3], matrix[7], matrix[11]), from = seen(lens, origin);
      const tips = arms.map((_, k) => seen(lens, new Vector3(matrix[k], matrix[4 + k], matrix[8 + k]).multiplyScalar(ARM).add(origin)));
      arms.forEach(({ line, letter }, k) => {
        put(line, { x1: from[0], y1: from[1], x2: tips[k][0], y2: tips[k][1] });
        put(letter, { x: from[0] + 1.2 * (tips[k][0] - from[0]), y: from[1] + 1.2 * (tips[k][1] - from[1]) + 4 });
      });
      const away = from[0] < (tips[0][0] + tips[1][0] + tips[2][0]) / 3 ? -1 : 1; // from the arms
      const end = from[0] + away * (8 + LETTER * name.textContent.length), side = end > 0 && end < lens.width ? away : -away;
      put(name, { x: from[0] + 8 * side, y: from[1] + 16 });
      name.setAttribute("text-anchor", side < 0 ? "end" : "start");
    }
  }

  dispose() {
    this.node.remove();
  }

  #drawn({ name: words, matrix, kind }) {
    const group = made(this.node, "g", { class: kind });
    const arms = NAMES.map((axis) => {
      const arm = made(group, "g", { class: axis });
      const line = made(arm, "line"), letter = made(arm, "text");
      letter.textContent = axis;
      return { line, letter };
    });
    const name = made(group, "text", { class: "name" });
    name.textContent = words;
    return { matrix, arms, name };
  }
}

function framesOf({ com_in_mesh: com }, { base, frame }) {
  const object = { name: "object (centre of mass)", matrix: IDENTITY, kind: "object" };
  const mesh = { name: "mesh file", matrix: IDENTITY.with(3, -com[0]).with(7, -com[1]).with(11, -com[2]), kind: "mesh" };
  const hand = { name: `hand (${base})`, matrix: frame, kind: "hand" };
  return Math.hypot(...com) > SAME ? [mesh, object, hand] : [object, hand];
}

/** Where a lens sees a place [px]. */
function seen({ camera, right, up, scale, width, height }, place) {
  const away = place.clone().sub(camera.position);
  return [width / 2 + away.dot(right) * scale, height / 2 - away.dot(up) * scale];
}
