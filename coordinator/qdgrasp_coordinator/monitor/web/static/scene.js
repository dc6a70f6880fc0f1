// The view in 3D: the object, a voxel for each cell in which a run has grasped it, and the hand in a chosen grasp.

import { Mesh, Vector3 } from "./vendor/three/three.module.min.js";
import { Hand } from "./scene/hand.js";
import { press } from "./scene/keys.js";
import { Mark } from "./scene/mark.js";
import { paint, raw, solid } from "./scene/solid.js";
import { Source } from "./scene/source.js";
import { Stage } from "./scene/stage.js";
import { CELL, Voxels } from "./scene/voxels.js";

const LISTEN = 1000; // ms between questions for what is new
const PATIENCE = 10000; // ms at most between them while nobody answers
const TAP = 5; // px: who moved farther has turned the view
const NEAR = { mouse: 3, pen: 6, touch: 14 }; // px: so close to a voxel is on it
const CUT_OPEN = 600; // cells: of more, those toward the viewer's right are left out at first
const GROWN = 1.1; // what was found so much farther out is brought into the picture, until somebody has turned it
const COLOURS = { object: "#f7e6ca", hand: "#009e8c", mark: "#22262b", flash: "#ffffff", paper: "#ffffff" };

export class SceneView {
  /** Called with what the server says of the chosen grasp; null: none is chosen. */
  onselect = () => {};
  /** Called with a sentence on what is shown, or why nothing is. */
  onstatus = () => {};
  /** Called with the kinds of cells: `{ words, colour, count, shown }`, from worst to best. */
  onkinds = () => {};
  #from = 0;
  #chosen = null;
  #timer = 0;
  #wait = LISTEN;
  #down = null;
  #stopped = false;
  #whole = 0; // m: how far voxels were from the middle when all was shown

  /**
   * @param canvas the canvas to draw on; its parent is positioned, and gets the axes laid over it
   * @param api where the server's answers are, such as "api"
   * @throws where the browser draws no 3D
   */
  constructor(canvas, api, job, run) {
    this.canvas = canvas;
    this.source = new Source(api, job, run);
    this.stage = new Stage(canvas);
    this.stage.onlost = (lost) => this.#say(lost ? "The graphics were lost, and come back by themselves." : "");
  }

  /** Begin to show the run, and what is found in it from now on. */
  async start() {
    this.#listen("addEventListener");
    this.#from = 0;
    try {
      this.#set(await this.source.scene());
      await this.#read(null);
      this.home();
      this.#timer = setTimeout(() => this.#hear(), LISTEN);
    } catch (error) {
      this.#fail(error);
      if (!this.#stopped) this.#timer = setTimeout(() => this.start(), PATIENCE / 2);
    }
  }

  /** Let go of all that it holds; it cannot be started again. */
  stop() {
    this.#stopped = true;
    clearTimeout(this.#timer);
    clearTimeout(this.glowing);
    this.source.end();
    this.#listen("removeEventListener");
    this.#clear();
    this.stage.dispose();
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
    const order = this.#order();
    const place = order.indexOf(this.#chosen);
    if (order.length) this.select(order[(place < 0 ? (by > 0 ? 0 : -1) : place + by + order.length) % order.length] ?? order.at(-1));
  }

  /** See everything, from where it was seen at first. */
  home() {
    const low = new Vector3(...this.told.low), high = new Vector3(...this.told.high);
    const middle = low.clone().add(high).divideScalar(2);
    this.#whole = this.voxels.farthest;
    this.stage.look(middle, Math.max(high.distanceTo(low) / 2, this.voxels.farthest) + CELL);
  }

  /** Which kinds of cells are shown: a flag for each. */
  set shown(flags) {
    this.voxels.shown = flags;
    this.#tell();
  }

  get shown() {
    return this.voxels.shown;
  }

  /** Whether cells toward the viewer's right are left out, so that one sees inside. */
  set cut(value) {
    this.voxels.cut = value;
    this.#tell();
  }

  get cut() {
    return this.voxels.cut;
  }

  #set(told) {
    this.told = told;
    const { things } = this.stage;
    const middle = told.low.map((low, k) => (low + told.high[k]) / 2);
    this.#clear();
    this.body = new Mesh(solid(told.mesh), paint(this.#colour("object")));
    this.hand = new Hand(told.links, this.#colour("hand"));
    this.mark = new Mark(this.#colour("mark"));
    this.voxels = this.stage.voxels = new Voxels(told.kinds, middle);
    things.add(this.body, this.voxels, this.hand, this.mark);
    this.#wear();
  }

  #clear() {
    if (!this.body) return;
    this.body.material.dispose();
    for (const thing of [this.body.geometry, this.voxels, this.hand, this.mark]) thing.dispose();
    this.stage.things.clear();
    this.stage.voxels = this.body = null;
  }

  /** Ask for what is new, and go on asking. */
  async #hear() {
    try {
      if (!document.hidden) await this.#read(performance.now() / 1000);
      this.#wait = LISTEN;
    } catch (error) {
      this.#wait = Math.min(2 * this.#wait, PATIENCE);
      this.#fail(error);
    }
    if (!this.#stopped) this.#timer = setTimeout(() => this.#hear(), this.#wait);
  }

  /** Read all pages that there are; what is new glows from `now` on. */
  async #read(now) {
    for (;;) {
      const page = await this.source.cells(this.#from);
      if (page.rows < this.#from || page.origin !== this.told.origin) return this.#again();
      const known = this.voxels.size;
      if (page.n) this.voxels.update(page, this.stage.calm ? null : now);
      if (known < CUT_OPEN && this.voxels.size >= CUT_OPEN) this.voxels.cut = true;
      const went = page.next > this.#from;
      this.#from = page.next;
      if (page.n || now === null) this.#tell();
      if (!this.stage.touched && this.voxels.farthest > GROWN * this.#whole) this.home();
      if (page.next >= page.rows || !went) return;
    }
  }

  /** Begin from nothing: this is another journal, maybe of another object. */
  async #again() {
    this.#from = 0;
    this.select(null);
    this.onselect(null);
    this.#set(await this.source.scene());
    await this.#read(null);
    this.home();
  }

  #show(grasp) {
    this.hand.pose(grasp?.links ?? null);
    this.mark.at(grasp?.cell ?? null);
    this.voxels.small = Boolean(grasp);
    this.stage.invalidate();
    this.onselect(grasp);
  }

  #tell() {
    const { voxels } = this;
    const shown = voxels.kinds.reduce((sum, _, k) => sum + (voxels.shown[k] ? voxels.counts[k] : 0), 0);
    const all = voxels.size.toLocaleString("en");
    this.#say(voxels.size ? `${shown === voxels.size ? all : `${shown.toLocaleString("en")} of ${all}`} cells of 1 cm${voxels.cut ? ", cut open" : ""}` : "Nothing found yet.");
    this.onkinds(voxels.kinds.map((kind, k) => ({ ...kind, count: voxels.counts[k], shown: voxels.shown[k] })));
    this.#animate();
  }

  /** Draw, and go on while something glows; rarely where drawing takes long. */
  #animate() {
    this.stage.invalidate();
    if (this.#stopped || !this.voxels?.glows(performance.now() / 1000)) return;
    clearTimeout(this.glowing);
    this.glowing = setTimeout(() => this.#animate(), this.stage.rest);
  }

  #say(words) {
    this.onstatus(words);
  }

  #fail(error) {
    if (error.name !== "AbortError") this.#say(error.message);
  }

  /** Journal numbers of what is shown, in the order of `step`. */
  #order() {
    const { voxels } = this;
    const slots = Array.from({ length: voxels.size }, (_, slot) => slot).filter((slot) => voxels.shown[voxels.kind(slot)]);
    slots.sort((a, b) => voxels.kind(b) - voxels.kind(a) || voxels.numbers[a] - voxels.numbers[b]);
    return slots.map((slot) => voxels.numbers[slot]);
  }

  /** The journal number of the voxel at a place on the canvas [px]; null where there is none. */
  async #at(x, y, near) {
    const { stage, voxels } = this;
    const { right, up, toward, scale } = stage.lens;
    stage.lens.aim();
    const size = voxels.aim({ right, up, toward, scale });
    const side = 2 * Math.max(Math.ceil(size / 2), near) + 1;
    const pixels = await stage.sample(x, y, side, (camera) => {
      voxels.material = voxels.named;
      stage.renderer.render(voxels, camera);
    });
    const slot = closest(pixels, side, near);
    return slot < 0 ? null : voxels.numbers[slot];
  }

  #listen(verb) {
    this.canvas[verb]("pointerdown", this.#pressed);
    this.canvas[verb]("pointerup", this.#released);
    this.canvas[verb]("keydown", this.#key);
    document[verb]("themechange", this.#wear);
  }

  #pressed = ({ clientX, clientY, isPrimary }) => {
    this.#down = isPrimary ? [clientX, clientY] : null;
  };

  #released = async ({ clientX, clientY, button, pointerType }) => {
    const moved = this.#down && Math.hypot(clientX - this.#down[0], clientY - this.#down[1]);
    if (!this.voxels || this.#down === null || moved > TAP || button) return;
    const { left, top } = this.canvas.getBoundingClientRect();
    try {
      const number = await this.#at(clientX - left, clientY - top, NEAR[pointerType] ?? NEAR.mouse);
      if (!this.#stopped) this.select(number);
    } catch (error) {
      this.#fail(error);
    }
  };

  #key = (event) => {
    if (this.voxels && press(this, event)) event.preventDefault();
  };

  #wear = () => {
    if (!this.body) return;
    this.body.material.uniforms.colour.value = raw(this.#colour("object"));
    this.hand.wear(this.#colour("hand"));
    this.mark.wear(this.#colour("mark"));
    this.voxels.wear(this.#colour("flash"), this.#colour("paper"));
    this.stage.invalidate();
  };

  #colour(name) {
    return getComputedStyle(this.canvas).getPropertyValue(`--scene-${name}`).trim() || COLOURS[name];
  }
}

/** The slot that a pixel near the middle names, the nearest one; -1 where none does. */
function closest(pixels, side, near) {
  const middle = (side - 1) / 2;
  let slot = -1, least = near * near + 1;
  for (let y = 0; y < side; y++) {
    for (let x = 0; x < side; x++) {
      const far = (x - middle) ** 2 + (y - middle) ** 2, i = 4 * (y * side + x);
      if (far < least && pixels[i + 3]) {
        least = far;
        slot = pixels[i] + 256 * pixels[i + 1] + 65536 * pixels[i + 2] - 1;
      }
    }
  }
  return slot;
}
