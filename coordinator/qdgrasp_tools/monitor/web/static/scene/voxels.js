// Voxels: one vertex each, drawn as a square of pixels in which a ray finds the cube. 100 000 of them as instances
// of a cube take seconds a frame where the processor draws; as points they take milliseconds.

import { BufferAttribute, BufferGeometry, GLSL3, Matrix4, Points, RawShaderMaterial, Vector3, Vector4 } from "../vendor/three/three.module.min.js";
import { drawnColour } from "./meshes.js";

export const CELL = 0.01; // m
const EDGE = 0.0078; // m: less than a cell, so that voxels stay apart
const DOT = 0.0026; // m: while a hand is shown among them
const LEAST = { edge: 5, dot: 2 }; // px of the page: around a large object voxels are drawn larger, so that they are seen
const CELLS = new Vector3(CELL, CELL, CELL);
const BEHIND = -1; // order of drawing
const FADED = 0.5; // how pale they are then

export class Voxels extends Points {
  #uniforms = {
    seen: { value: new Matrix4() }, sideways: { value: new Vector4() }, onward: { value: new Vector4() },
    cut: { value: 0 }, size: { value: 1 }, colours: { value: [] }, paper: { value: drawnColour("#ffffff") }, faded: { value: 0 },
    across: { value: new Vector3() }, down: { value: new Vector3() }, enter: { value: new Vector3() },
    thick: { value: new Vector3() }, light: { value: new Vector3() },
  };
  #edge = EDGE;
  #least = LEAST.edge;
  #most = 0; // m from the middle
  #measured = 0; // slots whose places are in that

  /** @param cells what was found; @param kinds their looks; @param middle where the object is [m] */
  constructor(cells, kinds, middle) {
    super();
    this.cells = cells;
    this.frustumCulled = false;
    this.renderOrder = 1;
    this.middle = new Vector3(...middle);
    this.#uniforms.colours.value = kinds.map(({ colour }) => drawnColour(colour));
    this.material = new RawShaderMaterial({ glslVersion: GLSL3, uniforms: this.#uniforms, vertexShader: VERTEX, fragmentShader: FRAGMENT });
    this.renew();
  }

  /** Send all voxels to the graphics card anew. */
  renew() {
    const { places } = this.cells, { position } = this.geometry.attributes;
    if (position?.array === places) position.needsUpdate = true;
    else {
      this.geometry.dispose();
      this.geometry = new BufferGeometry().setAttribute("position", new BufferAttribute(places, 4));
    }
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

  /** Set the colour that faded voxels are mixed with. */
  recolour(paper) {
    this.#uniforms.paper.value = drawnColour(paper);
  }

  /** Make ready to be drawn along these axes, with so many drawn pixels in a metre, and so many of the `page`; gives the
   *  size of each [px]. */
  aim({ right, up, toward, scale, page = scale }) {
    const uniforms = this.#uniforms, edge = Math.max(this.#edge, this.#least / page);
    const span = (axis) => Math.abs(axis.x) + Math.abs(axis.y) + Math.abs(axis.z);
    const extent = edge * Math.max(span(right), span(up));
    const most = this.farthest || 1; // m
    for (const [plane, axis, unit] of [[uniforms.sideways, right, 1], [uniforms.onward, toward, most]]) {
      plane.value.set(...axis.clone().multiplyScalar(CELL / unit), -axis.dot(this.middle) / unit);
    }
    this.geometry.setDrawRange(0, this.cells.size);
    uniforms.size.value = Math.max(1, extent * scale);
    for (const k of ["x", "y", "z"]) {
      const along = Math.abs(toward[k]) < 1e-4 ? 1e-4 : toward[k];
      uniforms.across.value[k] = (extent * right[k]) / along;
      uniforms.down.value[k] = (-extent * up[k]) / along;
      uniforms.thick.value[k] = edge / Math.abs(along);
      uniforms.enter.value[k] = -uniforms.thick.value[k] / 2;
      uniforms.light.value[k] = lit(k, toward, right, up);
    }
    return uniforms.size.value;
  }

  /** Called by the renderer. */
  onBeforeRender(_renderer, _scene, camera) {
    this.#uniforms.seen.value.multiplyMatrices(camera.projectionMatrix, camera.matrixWorldInverse).scale(CELLS);
  }

  /** Called by the renderer. */
  onAfterRender(renderer) {
    if (this.renderOrder === BEHIND) renderer.clearDepth();
  }

  /** The slot of the voxel at a place [px of the page, from the middle], or so near to it, the frontmost one; -1: none. */
  slotAt(x, y, near, projection) {
    const { right, up, toward, camera, scale } = projection, { sideways, onward, cut } = this.#uniforms;
    const half = this.aim(projection) / 2, place = new Vector3(), cell = new Vector4(0, 0, 0, 1);
    let found = -1, least = Infinity;
    for (let slot = 0; slot < this.cells.size; slot++) {
      if (this.cells.kind(slot) < 0) continue;
      place.fromArray(this.cells.cell(slot));
      cell.set(...place, 1);
      if (cut.value && cell.dot(onward.value) > 0 && cell.dot(sideways.value) > 0) continue;
      place.multiplyScalar(CELL).sub(camera.position);
      const beyond = Math.max(Math.abs(place.dot(right) * scale - x), Math.abs(place.dot(up) * scale - y), half) - half;
      const rank = beyond - 1e-3 * place.dot(toward); // a metre nearer counts as a thousandth of a pixel
      if (beyond > near || rank >= least) continue;
      least = rank;
      found = slot;
    }
    return found;
  }

  dispose() {
    this.geometry.dispose();
    this.material.dispose();
  }
}

/** How bright the face of a cube is that looks along axis `k` and toward the viewer. */
function lit(k, toward, right, up) {
  const side = Math.sign(toward[k]) || 1;
  const seen = side * (-0.4 * right[k] + 0.62 * up[k] + 0.68 * toward[k]);
  return 0.62 + 0.42 * Math.max(0, seen);
}

// Cells become places on the screen by one matrix; what lies behind both planes is left out.
const VERTEX = `
in vec4 position;
uniform mat4 seen;
uniform vec4 sideways, onward;
uniform vec3 colours[3], paper;
uniform float size, cut, faded;
flat out vec3 colour;
void main() {
  vec4 cell = vec4(position.xyz, 1.0);
  float near = dot(cell, onward), kind = position.w;
  bool open = cut > 0.5 && near > 0.0 && dot(cell, sideways) > 0.0;
  gl_PointSize = size;
  gl_Position = kind > -0.5 && !open ? seen * cell : vec4(2.0);
  colour = kind < 0.5 ? colours[0] : kind < 1.5 ? colours[1] : colours[2];
  colour = mix(colour * clamp(0.9 + 0.14 * near, 0.72, 1.06), paper, faded);
}`;

// The ray through a pixel enters the cube where the last of its three slabs is entered, if none was left before.
const FRAGMENT = `
precision highp float;
uniform vec3 across, down, enter, thick, light;
flat in vec3 colour;
out vec4 painted;
void main() {
  vec2 p = gl_PointCoord - 0.5;
  vec3 near = p.x * across + p.y * down + enter, far = near + thick;
  float hit = max(max(near.x, near.y), near.z);
  if (hit > min(min(far.x, far.y), far.z)) discard;
  painted = vec4(colour * (hit == near.x ? light.x : hit == near.y ? light.y : light.z), 1.0);
}`;
