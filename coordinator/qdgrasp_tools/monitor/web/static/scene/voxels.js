// Voxels: one vertex each, drawn as a square of pixels in which a ray finds the cube. 100 000 of them as instances
// of a cube take seconds a frame where the processor draws; as points they take milliseconds.

import {
  BufferAttribute, BufferGeometry, DynamicDrawUsage, GLSL3, Matrix4, Points, RawShaderMaterial, Vector3, Vector4,
} from "../vendor/three/three.module.min.js";
import { drawnColour } from "./meshes.js";

export const CELL = 0.01; // m
const EDGE = 0.0078; // m: less than a cell, so that voxels stay apart
const DOT = 0.0026; // m: while a hand is shown among them
const LEAST = { edge: 5, dot: 2 }; // px of the page: around a large object voxels are drawn larger, so that they are seen
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
    colours: { value: [] }, flash: { value: drawnColour("#ffffff") },
    paper: { value: drawnColour("#ffffff") }, faded: { value: 0 },
    across: { value: new Vector3() }, down: { value: new Vector3() }, enter: { value: new Vector3() },
    thick: { value: new Vector3() }, light: { value: new Vector3() },
  };
  #edge = EDGE;
  #least = LEAST.edge;
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
    this.#uniforms.colours.value = kinds.map(({ colour }) => drawnColour(colour));
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

  /** Send all voxels to the graphics card anew. */
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

  /** Whether those toward the viewer's right are left out, which shows the inside. */
  set cut(value) {
    this.#uniforms.cut.value = Number(value);
  }

  get cut() {
    return Boolean(this.#uniforms.cut.value);
  }

  /** Whether they are small and pale and behind everything, so that the hand among them can be seen. */
  set small(value) {
    this.renderOrder = value ? BEHIND : 1;
    this.#edge = value ? DOT : EDGE;
    this.#least = value ? LEAST.dot : LEAST.edge;
    this.#uniforms.faded.value = value ? FADED : 0;
  }

  /** Set the colour of new voxels, and the one that faded voxels are mixed with. */
  recolour(flash, paper) {
    this.#uniforms.flash.value = drawnColour(flash);
    this.#uniforms.paper.value = drawnColour(paper);
  }

  /** Make ready to be drawn along these axes, with so many drawn pixels in a metre, and so many of the `page`; gives the
   *  size of each [px]. Plain, they are squares; of a share of them each is larger. */
  aim({ right, up, toward, scale, page = scale, now = 0, plain = false, share = 1 }) {
    const uniforms = this.#uniforms, edge = Math.max(this.#edge, this.#least / page);
    const span = (axis) => Math.abs(axis.x) + Math.abs(axis.y) + Math.abs(axis.z);
    const extent = edge * (plain ? 1.25 / Math.cbrt(share) : Math.max(span(right), span(up)));
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
      uniforms.thick.value[k] = edge / Math.abs(along);
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

  /** Send these slots, in order, to the graphics card, those close to each other in one piece. */
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

  /** Make room for all cells. */
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

const GLOW = 1.2; // s: how long a new one shows that it is new

// Cells become places on the screen by one matrix; what lies behind both planes is left out.
const PLACE = `
in vec4 position;
uniform mat4 seen;
uniform vec4 sideways, onward;
uniform float size, cut;
float place(vec4 cell) {
  float near = dot(cell, onward);
  bool open = cut > 0.5 && near > 0.0 && dot(cell, sideways) > 0.0;
  gl_PointSize = size;
  gl_Position = position.w > -0.5 && !open ? seen * cell : vec4(2.0);
  return near;
}`;

const VERTEX = `
in float born;
uniform vec3 colours[3], flash, paper;
uniform float now, faded;
flat out vec3 colour;
${PLACE}
void main() {
  float near = place(vec4(position.xyz, 1.0)), kind = position.w;
  colour = kind < 0.5 ? colours[0] : kind < 1.5 ? colours[1] : colours[2];
#ifndef PLAIN
  colour = mix(colour, flash, 0.85 * clamp(1.0 - (now - born) / ${GLOW.toFixed(1)}, 0.0, 1.0));
#endif
  colour = mix(colour * clamp(0.9 + 0.14 * near, 0.72, 1.06), paper, faded);
}`;

// The ray through a pixel enters the cube where the last of its three slabs is entered, if none was left before.
const FRAGMENT = `
precision highp float;
uniform vec3 across, down, enter, thick, light;
flat in vec3 colour;
out vec4 painted;
void main() {
#ifdef PLAIN
  painted = vec4(colour * light.x, 1.0);
#else
  vec2 p = gl_PointCoord - 0.5;
  vec3 near = p.x * across + p.y * down + enter, far = near + thick;
  float hit = max(max(near.x, near.y), near.z);
  if (hit > min(min(far.x, far.y), far.z)) discard;
  painted = vec4(colour * (hit == near.x ? light.x : hit == near.y ? light.y : light.z), 1.0);
#endif
}`;

const NAMED_VERTEX = `
flat out vec4 name;
${PLACE}
void main() {
  place(vec4(position.xyz, 1.0));
  int number = gl_VertexID + 1;
  name = vec4(number & 255, (number >> 8) & 255, (number >> 16) & 255, 255) / 255.0;
}`;

const NAMED_FRAGMENT = `
precision highp float;
flat in vec4 name;
out vec4 painted;
void main() { painted = name; }`;
