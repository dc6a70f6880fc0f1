// The view in 3D: the object, a voxel for each cell in which a run has grasped it, and the hand in a chosen grasp.

import { Vector3 } from "./vendor/three/three.module.min.js";
import { Cast } from "./scene/cast.js";
import { press } from "./scene/keys.js";
import { News } from "./scene/news.js";
import { Pointer } from "./scene/pointer.js";
import { Source } from "./scene/source.js";
import { Stage } from "./scene/stage.js";
import { CELL } from "./scene/voxels.js";
import { count, several } from "./words.js";

const TRY = 5000; // ms until what is not there is asked for again
const CUT_OPEN = 600; // cells: of more, those toward the viewer's right are left out at first
const GROWN = 1.1; // what was found so much farther out is brought into the picture, until somebody has turned it
const COLOURS = { object: "#f7e6ca", hand: "#009e8c", mark: "#22262b", flash: "#ffffff", paper: "#ffffff" };

export class SceneView {
  /** Called with what the server says of the chosen grasp; null: none is chosen. */
  onselect = () => {};
  /** Called with a sentence on what is shown, or why nothing is. */
  onstatus = () => {};
  /** Called when what is shown is another. */
  onchange = () => {};
  #chosen = null;
  #timer = 0;
  #glowing = 0;
  #stopped = false;
  #whole = 0; // m: how far voxels were from the middle when all was shown

  /**
   * @param canvas the canvas to draw on; its parent is positioned, and gets the axes laid over it
   * @param api where the server's answers are, such as "api"
   * @throws where the browser draws no 3D
   */
  constructor(canvas, api, job, run) {
    this.canvas = canvas;
    this.cast = null;
    this.source = new Source(api, job, run);
    this.stage = new Stage(canvas);
    this.stage.onlost = (lost) => this.onstatus(lost ? "The graphics were lost, and come back by themselves." : "");
    const onfail = (error) => this.#fail(error);
    this.news = new News(this.source, { onpage: (page, isFirst) => this.#take(page, isFirst), onother: () => this.#another(), onfail });
    this.pointer = new Pointer(this.stage, { onpick: (slot) => this.#picked(slot), onfail });
  }

  /** Begin to show the run, and what is found in it from now on. */
  async start() {
    this.canvas.addEventListener("keydown", this.#key);
    document.addEventListener("themechange", this.#wear);
    try {
      await this.#open();
    } catch (error) {
      this.#fail(error);
      if (!this.#stopped) this.#timer = setTimeout(() => this.start(), TRY);
    }
  }

  /** Let go of all that it holds; it cannot be started again. */
  stop() {
    this.#stopped = true;
    clearTimeout(this.#timer);
    clearTimeout(this.#glowing);
    this.news.stop();
    this.source.end();
    this.canvas.removeEventListener("keydown", this.#key);
    document.removeEventListener("themechange", this.#wear);
    this.pointer.dispose();
    this.#clear();
    this.stage.dispose();
  }

  /** What the server says of the scene. */
  get told() {
    return this.cast.told;
  }

  get cells() {
    return this.cast.cells;
  }

  /** Choose the grasp with this journal number; null: none. */
  async select(number) {
    this.#chosen = number;
    if (number === null) return this.#show(null);
    try {
      const grasp = await this.source.grasp(number);
      if (this.#chosen === number) this.#show(grasp);
    } catch (error) {
      this.#fail(error);
    }
  }

  /** Choose the next grasp that is shown, or the one before: the best first, of equals the earliest. */
  step(by) {
    const order = this.cells.order();
    const place = order.indexOf(this.#chosen);
    const next = place < 0 ? (by > 0 ? 0 : -1) : place + by;
    if (order.length) this.select(order.at(next % order.length));
  }

  /** See everything, from where it was seen at first. */
  home() {
    const low = new Vector3(...this.told.low), high = new Vector3(...this.told.high);
    const middle = low.clone().add(high).divideScalar(2);
    this.#whole = this.cast.voxels.farthest;
    this.stage.look(middle, Math.max(high.distanceTo(low) / 2, this.#whole) + CELL);
  }

  /** Let other grasps pass: `part` has some of what a `Filter` has. */
  sift(part) {
    Object.assign(this.cells.filter, part);
    this.cast.sift();
    this.#tell();
  }

  /** Whether cells toward the viewer's right are left out, so that one sees inside. */
  set cut(value) {
    this.cast.voxels.cut = value;
    this.#tell();
  }

  get cut() {
    return this.cast.voxels.cut;
  }

  /** Whether the frames of a chosen grasp are drawn. */
  set framed(value) {
    this.stage.frames.shown = value;
    this.#tell();
  }

  get framed() {
    return this.stage.frames.shown;
  }

  async #open() {
    const told = await this.source.scene();
    if (this.#stopped) return;
    this.#clear();
    this.cast = new Cast(told, this.#colour);
    this.cast.enter(this.stage.things);
    this.stage.voxels = this.cast.voxels;
    this.#wear();
    await this.news.begin(told.origin);
    if (!this.#stopped) this.home();
  }

  #clear() {
    this.cast?.leave(this.stage.things);
    this.stage.frames.show(null, null);
    this.stage.voxels = this.cast = null;
  }

  /** Begin from nothing: this is another journal, maybe of another object. */
  #another() {
    this.#chosen = null;
    this.onselect(null);
    return this.#open();
  }

  /** Take in what was found; where it is new it glows. */
  #take(page, isFirst) {
    if (this.#stopped) return;
    const { cells, voxels } = this.cast, known = cells.size;
    const now = isFirst || this.stage.calm ? null : performance.now() / 1000;
    if (page.n) voxels.change(cells.update(page), now);
    if (known < CUT_OPEN && cells.size >= CUT_OPEN) voxels.cut = true;
    if (page.n || isFirst) this.#tell();
    if (!this.stage.touched && voxels.farthest > GROWN * this.#whole) this.home();
  }

  #picked(slot) {
    if (!this.#stopped && this.cast) this.select(slot < 0 ? null : this.cells.number(slot));
  }

  #show(grasp) {
    if (!this.cast) return;
    this.cast.pose(grasp);
    this.stage.frames.show(this.told, grasp);
    this.stage.invalidate();
    this.onselect(grasp);
  }

  #tell() {
    const { size, shown } = this.cells;
    const open = this.cut ? ", cut open" : "";
    this.onstatus(size ? `${shown === size ? "" : `${count(shown)} of `}${several(size, "cell")} of 1 cm${open}` : "Nothing found yet.");
    this.onchange();
    this.#animate();
  }

  /** Draw, and go on while something glows; rarely where drawing takes long. */
  #animate() {
    this.stage.invalidate();
    if (this.#stopped || !this.cast?.voxels.glows(performance.now() / 1000)) return;
    clearTimeout(this.#glowing);
    this.#glowing = setTimeout(() => this.#animate(), this.stage.rest);
  }

  #fail(error) {
    if (error.name !== "AbortError") this.onstatus(error.message);
  }

  #key = (event) => {
    if (this.cast && press(this, event)) event.preventDefault();
  };

  #wear = () => {
    this.cast?.wear(this.#colour);
    this.stage.invalidate();
  };

  #colour = (name) => getComputedStyle(this.canvas).getPropertyValue(`--scene-${name}`).trim() || COLOURS[name];
}
