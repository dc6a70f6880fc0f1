// The hand: its links, each where the server says that it is; fingers solid, the palm like glass.

import { Group, Matrix4, Mesh } from "../vendor/three/three.module.min.js";
import { paint, raw, solid } from "./solid.js";

const PALM = 0.42; // solidity

export class Hand extends Group {
  #links = new Map();

  /** @param links the scene's, each with its name, mesh and whether it is a finger */
  constructor(links, colour) {
    super();
    this.visible = false;
    for (const { name, finger, mesh } of links) {
      const link = new Mesh(solid(mesh), paint(colour, finger ? 1 : PALM));
      link.renderOrder = finger ? 2 : 3;
      link.matrixAutoUpdate = false;
      this.#links.set(name, link);
      this.add(link);
    }
  }

  /** Stand as in a grasp: `links` has each link's frame, 4 x 4 row by row; null: be gone. */
  pose(links) {
    this.visible = Boolean(links);
    if (links) for (const [name, link] of this.#links) link.matrix.copy(new Matrix4().set(...links[name]));
  }

  wear(colour) {
    for (const link of this.#links.values()) link.material.uniforms.colour.value = raw(colour);
  }

  dispose() {
    for (const link of this.#links.values()) {
      link.geometry.dispose();
      link.material.dispose();
    }
  }
}
