// Voxels: one vertex each, drawn as a square of pixels in which a ray finds the cube. 100 000 of them as instances
// of a cube take seconds a frame where the processor draws; as points they take milliseconds.

import {
  BufferAttribute, BufferGeometry, DynamicDrawUsage, GLSL3, Matrix4, Points, RawShaderMaterial, Vector3, Vector4,
} from "../vendor/three/three.module.min.js";
import { FRAGMENT, GLOW, NAMED_FRAGMENT, NAMED_VERTEX, VERTEX } from "./shaders.js";
import { raw } from "./solid.js";

export const CELL = 0.01; // m
const EDGE = 0.0078; // m: less than a cell, so that voxels stay apart
const DOT = 0.0026; // m: while a hand is shown among them
const CELLS = new Vector3(CELL, CELL, CELL);
const BEHIND = -1; // order of drawing
const FADED = 0.5; // how pale they are then
const OLD = -1e6;
const CLOSE = 256; // slots: it takes longer to send two pieces than what lies between

export class Voxels extends Points {
  #born = new Float32Array(0);
  #uniforms = {
    seen: { value: new Matrix4() }, sideways: { value: new Vector4() }, onward: { value: new Vector4() },
    cut: { value: 0 }, size: { value: 1 }, now: { value: 0 },
    colours: { value: [] }, flash: { value: raw("#ffffff") },
    paper: { value: raw("#ffffff") }, faded: { value: 0 },
    across: { value: new Vector3() }, down: { value: new Vector3() }, enter: { value: new Vector3() },
    thick: { value: new Vector3() }, light: { value: new Vector3() },
  };
  #edge = EDGE;
  #newest = OLD;
  #most = 0; // m from the middle
  #measured = 0; // slots whose places are in that
  #renewed = false; // whether all are to be sent to the graphics card

  /** @param cells what was found; @param kinds their looks; @param middle where the object is [m] */
  constructor(cells, kinds, middle) {
    super();
    this.cells = cells;
    this.frustumCulled = false;
    this.renderOrder = 1;
    this.middle = new Vector3(...middle);
    this.#uniforms.colours.value = kinds.map(({ colour }) => raw(colour));
    this.fine = this.#material(VERTEX, FRAGMENT);
    this.plain = this.#material(VERTEX, FRAGMENT, { PLAIN: 1 });
    this.named = this.#material(NAMED_VERTEX, NAMED_FRAGMENT);
    this.material = this.fine;
    this.#fit();
  }

  /** Show what changed in these slots, which are in order; `now` [s] is when they are born, null: they were there. */
  change(slots, now) {
    this.#fit();
    for (const slot of slots) this.#born[slot] = now ?? OLD;
    if (!slots.length) return;
    this.#send(slots);
    if (now !== null) this.#newest = now;
  }

  /** Show all anew. */
  renew() {
    this.#renewed = true;
    for (const attribute of this.#attributes) {
      attribute.clearUpdateRanges();
      attribute.needsUpdate = true;
    }
  }

  /** Whether some still show that they are new. */
  glows(now) {
    return now - this.#newest < GLOW;
  }

  /** How far from the middle the farthest one is [m]. */
  get farthest() {
    const { x, y, z } = this.middle;
    for (; this.#measured < this.cells.size; this.#measured++) {
      const [a, b, c] = this.cells.cell(this.#measured);
      this.#most = Math.max(this.#most, Math.hypot(CELL * a - x, CELL * b - y, CELL * c - z));
    }
    return this.#most;
  }

  /** Whether those toward the viewer's right are left out, so that one sees inside. */
  set cut(value) {
    this.#uniforms.cut.value = Number(value);
  }

  get cut() {
    return Boolean(this.#uniforms.cut.value);
  }

  /** Whether they are small and pale and behind everything, to let one see what stands among them. */
  set small(value) {
    this.renderOrder = value ? BEHIND : 1;
    this.#edge = value ? DOT : EDGE;
    this.#uniforms.faded.value = value ? FADED : 0;
  }

  /** Look so when new, and fade into this paper. */
  wear(flash, paper) {
    this.#uniforms.flash.value = raw(flash);
    this.#uniforms.paper.value = raw(paper);
  }

  /** Make ready to be drawn along these axes, with so many drawn pixels in a metre; gives the size of each [px].
   *  Plain, they are squares; of a share of them each is larger. */
  aim({ right, up, toward, scale, now = 0, plain = false, share = 1 }) {
    const uniforms = this.#uniforms;
    const span = (axis) => Math.abs(axis.x) + Math.abs(axis.y) + Math.abs(axis.z);
    const extent = this.#edge * (plain ? 1.25 / Math.cbrt(share) : Math.max(span(right), span(up)));
    this.material = plain ? this.plain : this.fine;
    const most = this.farthest || 1; // m
    for (const [plane, axis, unit] of [[uniforms.sideways, right, 1], [uniforms.onward, toward, most]]) {
      plane.value.set(...axis.clone().multiplyScalar(CELL / unit), -axis.dot(this.middle) / unit);
    }
    this.geometry.setDrawRange(0, Math.ceil(share * this.cells.size));
    uniforms.now.value = now;
    uniforms.size.value = Math.max(1, extent * scale);
    for (const k of ["x", "y", "z"]) {
      const along = Math.abs(toward[k]) < 1e-4 ? 1e-4 : toward[k];
      uniforms.across.value[k] = (extent * right[k]) / along;
      uniforms.down.value[k] = (-extent * up[k]) / along;
      uniforms.thick.value[k] = this.#edge / Math.abs(along);
      uniforms.enter.value[k] = -uniforms.thick.value[k] / 2;
      uniforms.light.value[k] = plain ? 0.88 : lit(k, toward, right, up);
    }
    return uniforms.size.value;
  }

  /** Called by the renderer. */
  onBeforeRender(_renderer, _scene, camera) {
    this.#uniforms.seen.value.multiplyMatrices(camera.projectionMatrix, camera.matrixWorldInverse).scale(CELLS);
  }

  /** Called by the renderer. */
  onAfterRender(renderer) {
    this.#renewed = false;
    if (this.renderOrder === BEHIND) renderer.clearDepth();
  }

  dispose() {
    this.geometry.dispose();
    for (const material of [this.fine, this.plain, this.named]) material.dispose();
  }

  #material(vertexShader, fragmentShader, defines = {}) {
    return new RawShaderMaterial({ glslVersion: GLSL3, uniforms: this.#uniforms, vertexShader, fragmentShader, defines });
  }

  /** Have these slots, in order, sent to the graphics card, those close to each other together. */
  #send(slots) {
    if (this.#renewed) return; // all of them are sent anyway
    let first = slots[0], last = slots[0];
    const range = () => this.#attributes.forEach((each) => each.addUpdateRange(first * each.itemSize, (last - first + 1) * each.itemSize));
    for (const slot of slots) {
      if (slot > last + CLOSE) {
        range();
        first = slot;
      }
      last = slot;
    }
    range();
    for (const attribute of this.#attributes) attribute.needsUpdate = true;
  }

  get #attributes() {
    return Object.values(this.geometry.attributes);
  }

  /** Have room for all cells. */
  #fit() {
    const { places } = this.cells;
    if (this.geometry.attributes.position?.array === places) return;
    const born = new Float32Array(places.length / 4).fill(OLD);
    born.set(this.#born);
    this.#born = born;
    this.geometry.dispose();
    this.geometry = new BufferGeometry();
    this.geometry.setAttribute("position", new BufferAttribute(places, 4).setUsage(DynamicDrawUsage));
    this.geometry.setAttribute("born", new BufferAttribute(born, 1).setUsage(DynamicDrawUsage));
  }
}

/** How bright the face of a cube is that looks along axis `k` and toward the viewer. */
function lit(k, toward, right, up) {
  const side = Math.sign(toward[k]) || 1;
  const seen = side * (-0.4 * right[k] + 0.62 * up[k] + 0.68 * toward[k]);
  return 0.62 + 0.42 * Math.max(0, seen);
}
