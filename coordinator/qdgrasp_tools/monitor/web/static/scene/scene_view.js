// The view in 3D: the object, a voxel for each cell in which a run has grasped it, and the hand in the
// selected grasp.

import { BufferGeometry, Mesh, Vector3 } from "../vendor/three/three.module.min.js";
import { darkMode } from "../dom.js";
import { count, several } from "../format.js";
import { Cells } from "./cells.js";
import { handleKey, isFor, VoxelPicker } from "./input.js";
import { BoxEdges, drawnColour, frameAt, HandMesh, meshGeometry, meshMaterial } from "./meshes.js";
import { Renderer } from "./renderer.js";
import { CellUpdates, RunClient } from "./run_data.js";
import { CELL, Voxels } from "./voxels.js";

const RETRY = 5000; // ms until a scene that could not be loaded is asked for again
const CUT_OPEN = 600; // cells: from this number on the view is cut open at first
const GROWN = 1.1; // cells so much farther out make the view zoom out, until it was turned by hand
const COLOURS = { object: "#f7e6ca", allowed: "#a0dd7c", forbidden: "#ecc9b4", neighbour: "#7d8894", hand: "#009e8c", mark: "#22262b", paper: "#ffffff" };
const GLASS = 0.2; // solidity of neighbours

export class SceneView {
  /** Called with the server's description of the selected grasp; null: none is selected. */
  onselect = () => {};
  /** Called with a sentence on what is shown, or why nothing is. */
  onstatus = () => {};
  /** Called when what is shown changes. */
  onchange = () => {};
  /** Called when the hand was opened or closed, or frames were shown or left out. */
  onplace = () => {};
  /** Called when another journal is shown from now on, maybe of another object. */
  onreopen = () => {};
  /** What is filtered from the beginning: some of the fields of a `CellFilter`. */
  filter = {};
  #grasp = null; // the selected one, as the server tells it
  #closed = 1;
  #selected = null;
  #timer = 0;
  #stopped = false;
  #whole = 0; // m: how far voxels were from the middle when all was shown

  /**
   * @param canvas the canvas to draw on; its parent is positioned, and gets the axes laid over it
   * @param api where the server's answers are, such as "api"
   * @throws where the browser draws no 3D
   */
  constructor(canvas, api, job, run) {
    this.canvas = canvas;
    this.objects = null;
    this.client = new RunClient(api, job, run);
    this.renderer = new Renderer(canvas);
    this.renderer.onlost = (lost) => this.onstatus(lost ? "The graphics were lost, and come back by themselves." : "");
    const onfail = (error) => this.#fail(error);
    const onpage = (page, isFirst) => this.#addPage(page, isFirst);
    this.updates = new CellUpdates(this.client, { onpage, onother: () => this.#reopen(), onfail });
    this.pointer = new VoxelPicker(this.renderer, (slot) => this.#selectSlot(slot));
  }

  /** Begin to show the run, and what is found in it from now on. */
  async start() {
    document.addEventListener("keydown", this.#key);
    darkMode.addEventListener("change", this.#recolour);
    try {
      await this.#open();
    } catch (error) {
      this.#fail(error);
      if (!this.#stopped) this.#timer = setTimeout(() => this.start(), RETRY);
    }
  }

  /** Release everything; it cannot be started again. */
  stop() {
    this.#stopped = true;
    clearTimeout(this.#timer);
    this.updates.stop();
    this.client.end();
    document.removeEventListener("keydown", this.#key);
    darkMode.removeEventListener("change", this.#recolour);
    this.pointer.dispose();
    this.#clear();
    this.renderer.dispose();
  }

  /** The server's description of the scene. */
  get description() {
    return this.objects.description;
  }

  get cells() {
    return this.objects.cells;
  }

  /** The journal number of the selected grasp; null: none is. */
  get selected() {
    return this.#selected;
  }

  /** A colour of the scene by its name, in the page's theme. */
  colour = (name) => getComputedStyle(this.canvas).getPropertyValue(`--scene-${name}`).trim() || COLOURS[name];

  /** Select the grasp with this journal number; null: none. */
  async select(number) {
    this.#selected = number;
    if (number === null) return this.#show(null);
    try {
      const grasp = await this.client.grasp(number);
      if (this.#selected === number) this.#show(grasp);
    } catch (error) {
      this.#fail(error);
    }
  }

  /** Select the next grasp that is shown, or the one before: the best first, of equals the earliest. */
  step(by) {
    const order = this.cells.best().map(({ number }) => number);
    const place = order.indexOf(this.#selected);
    const next = place < 0 ? (by > 0 ? 0 : -1) : place + by;
    if (order.length) this.select(order.at(next % order.length));
  }

  /** Show everything, from the first direction. */
  home() {
    const low = new Vector3(...this.description.low), high = new Vector3(...this.description.high);
    const middle = low.clone().add(high).divideScalar(2);
    this.#whole = this.objects.voxels.farthest;
    this.renderer.lookAt(middle, Math.max(high.distanceTo(low) / 2, this.#whole) + CELL);
  }

  /** Change the filter: `part` has some of the fields of a `CellFilter`. */
  applyFilter(part) {
    Object.assign(this.filter, part);
    Object.assign(this.cells.filter, part);
    this.objects.applyFilter();
    this.#changed();
  }

  /** Whether cells toward the viewer's right are left out, so that one sees inside. */
  set cut(value) {
    this.objects.voxels.cut = value;
    this.#changed();
  }

  get cut() {
    return this.objects.voxels.cut;
  }

  /** How far the hand is closed: 0 as it is commanded, open; 1 as it settled, closed. */
  set closed(value) {
    this.#closed = value;
    this.#place();
  }

  get closed() {
    return this.#closed;
  }

  /** Whether the frames of the selected grasp are drawn. */
  set showsFrames(value) {
    this.renderer.frames.shown = value;
    this.#changed();
    this.onplace();
  }

  get showsFrames() {
    return this.renderer.frames.shown;
  }

  async #open() {
    const description = await this.client.scene();
    if (this.#stopped) return;
    this.#clear();
    this.objects = new SceneObjects(description, this.colour);
    this.objects.addTo(this.renderer.scene);
    Object.assign(this.cells.filter, this.filter);
    this.renderer.voxels = this.objects.voxels;
    this.#recolour();
    await this.updates.begin(description.origin);
    if (!this.#stopped) this.home();
  }

  #clear() {
    this.objects?.removeFrom(this.renderer.scene);
    this.#grasp = null;
    this.renderer.frames.show(null, null);
    this.renderer.contacts.show([]);
    this.renderer.voxels = this.objects = null;
  }

  /** Start anew: this is another journal, maybe of another object. */
  #reopen() {
    this.#selected = null;
    this.onselect(null);
    this.onreopen();
    return this.#open();
  }

  /** Add a page of successes. */
  #addPage(page, isFirst) {
    if (this.#stopped) return;
    const { cells, voxels } = this.objects, known = cells.size;
    cells.update(page);
    voxels.renew();
    if (known < CUT_OPEN && cells.size >= CUT_OPEN) voxels.cut = true;
    if (page.n || isFirst) this.#changed();
    if (!this.renderer.touched && voxels.farthest > GROWN * this.#whole) this.home();
  }

  #selectSlot(slot) {
    if (!this.#stopped && this.objects) this.select(slot < 0 ? null : this.cells.number(slot));
  }

  #show(grasp) {
    if (!this.objects) return;
    this.#grasp = grasp;
    this.#place();
    this.onselect(grasp);
  }

  /** Place the hand as far closed as it is; contacts are there when it is closed. */
  #place() {
    if (!this.objects) return;
    const grasp = this.#grasp, place = this.#closed;
    this.objects.pose(grasp, place);
    this.renderer.frames.show(this.description, grasp && frameAt(grasp.frames[grasp.base], place).transpose().toArray());
    this.renderer.contacts.show(grasp && place === 1 ? grasp.contacts : []);
    this.renderer.invalidate();
    this.onplace();
  }

  #changed() {
    const { size, shown } = this.cells;
    const open = this.cut ? ", cut open" : "";
    this.onstatus(size ? `${shown === size ? "" : `${count(shown)} of `}${several(size, "cell")} of 1 cm${open}` : "Nothing found yet.");
    this.onchange();
    this.renderer.invalidate();
  }

  #fail(error) {
    if (error.name !== "AbortError") this.onstatus(error.message);
  }

  #key = (event) => {
    if (this.objects && isFor(this.canvas, event) && handleKey(this, event)) event.preventDefault();
  };

  #recolour = () => {
    this.objects?.recolour(this.colour);
    this.renderer.invalidate();
  };
}

/** All objects in the three.js scene of one run. */
class SceneObjects {
  /** @param description the server's description of the scene; @param colour gives a colour by its name */
  constructor(description, colour) {
    this.description = description;
    this.cells = new Cells(description.kinds);
    this.surface = description.mesh.margins ? "allowed" : "object";
    this.body = new Mesh(meshGeometry(description.mesh), meshMaterial(colour(this.surface), 1, colour("forbidden")));
    this.around = new Mesh(description.neighbours ? meshGeometry(description.neighbours) : new BufferGeometry(), meshMaterial(colour("neighbour"), GLASS));
    this.around.renderOrder = 3;
    this.hand = new HandMesh(description.links, colour("hand"));
    this.mark = new BoxEdges(colour("mark"));
    this.box = new BoxEdges(colour("mark"));
    this.voxels = new Voxels(this.cells, description.kinds, description.low.map((low, k) => (low + description.high[k]) / 2));
  }

  addTo(scene) {
    scene.add(this.body, this.around, this.voxels, this.hand, this.mark, this.box);
  }

  removeFrom(scene) {
    scene.clear();
    for (const { material, geometry } of [this.body, this.around]) [material, geometry].forEach((part) => part.dispose());
    for (const part of [this.voxels, this.hand, this.mark, this.box]) part.dispose();
  }

  recolour(colour) {
    for (const [name, value] of Object.entries({ colour: this.surface, forbidden: "forbidden" }))
      this.body.material.uniforms[name].value = drawnColour(colour(value));
    this.around.material.uniforms.colour.value = drawnColour(colour("neighbour"));
    this.hand.recolour(colour("hand"));
    this.mark.recolour(colour("mark"));
    this.box.recolour(colour("mark"));
    this.voxels.recolour(colour("paper"));
  }

  /** Pose the hand as in a grasp of the server's, as far closed as `place` says; null: hide it. */
  pose(grasp, place) {
    this.hand.pose(grasp?.frames ?? null, place);
    this.mark.span(...(grasp ? [grasp.cell.map(lowerEdge), grasp.cell.map(upperEdge)] : []));
    this.voxels.small = Boolean(grasp);
  }

  /** Show the cells that pass the filter now. */
  applyFilter() {
    const { filter, low, high } = this.cells;
    this.cells.applyFilter();
    this.voxels.renew();
    const corners = [low.map((least, k) => lowerEdge(Math.max(least, filter.low[k]))), high.map((most, k) => upperEdge(Math.min(most, filter.high[k])))];
    this.box.span(...(filter.isBoxed && this.cells.size ? corners : []));
  }
}

function lowerEdge(cell) {
  return CELL * (cell - 0.5);
}

function upperEdge(cell) {
  return CELL * (cell + 0.5);
}
