// The cast: all that stands on the stage of one run.

import { Mesh } from "../vendor/three/three.module.min.js";
import { Cells } from "./cells.js";
import { Edges } from "./edges.js";
import { Hand } from "./hand.js";
import { paint, raw, solid } from "./solid.js";
import { CELL, Voxels } from "./voxels.js";

export class Cast {
  /** @param told what the server says of the scene; @param colour gives a colour by its name */
  constructor(told, colour) {
    this.told = told;
    this.cells = new Cells(told.kinds);
    this.body = new Mesh(solid(told.mesh), paint(colour("object")));
    this.hand = new Hand(told.links, colour("hand"));
    this.mark = new Edges(colour("mark"));
    this.box = new Edges(colour("mark"));
    this.voxels = new Voxels(this.cells, told.kinds, told.low.map((low, k) => (low + told.high[k]) / 2));
  }

  enter(things) {
    things.add(this.body, this.voxels, this.hand, this.mark, this.box);
  }

  leave(things) {
    things.clear();
    this.body.material.dispose();
    for (const thing of [this.body.geometry, this.voxels, this.hand, this.mark, this.box]) thing.dispose();
  }

  wear(colour) {
    this.body.material.uniforms.colour.value = raw(colour("object"));
    this.hand.wear(colour("hand"));
    this.mark.wear(colour("mark"));
    this.box.wear(colour("mark"));
    this.voxels.wear(colour("flash"), colour("paper"));
  }

  /** Stand as in a grasp that the server tells of; null: in none. */
  pose(grasp) {
    this.hand.pose(grasp?.links ?? null);
    this.mark.span(...(grasp ? [grasp.cell.map(from), grasp.cell.map(upto)] : []));
    this.voxels.small = Boolean(grasp);
  }

  /** Show what passes the filter now. */
  sift() {
    const { filter, low, high } = this.cells;
    this.cells.sift();
    this.voxels.renew();
    const corners = [low.map((least, k) => from(Math.max(least, filter.low[k]))), high.map((most, k) => upto(Math.min(most, filter.high[k])))];
    this.box.span(...(filter.isBoxed && this.cells.size ? corners : []));
  }
}

function from(cell) {
  return CELL * (cell - 0.5);
}

function upto(cell) {
  return CELL * (cell + 0.5);
}
