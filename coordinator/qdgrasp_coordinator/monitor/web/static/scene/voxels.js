// Voxels: one vertex each, drawn as a square of pixels in which a ray finds the cube. 100 000 of them as instances
// of a cube take seconds a frame where the processor draws; as points they take milliseconds.

import {
  BufferAttribute, BufferGeometry, DynamicDrawUsage, GLSL3, Matrix4, Points, RawShaderMaterial, Vector3, Vector4,
} from "../vendor/three/three.module.min.js";
import { raw } from "./solid.js";

export const CELL = 0.01; // m
const EDGE = 0.0078; // m: less than a cell, so that voxels stay apart
const DOT = 0.0026; // m: while a hand is shown among them
const CELLS = new Vector3(CELL, CELL, CELL);
const BEHIND = -1; // order of drawing
const FADED = 0.5; // how pale they are then
const GLOW = 1.2; // s: how long a new one shows that it is new
const OLD = -1e6;
const FIRST = 4096; // voxels that there is room for at first
const CLOSE = 256; // slots: it takes longer to send two pieces than what lies between

// Cells become places on the screen by one matrix; what lies behind both planes is left out.
const PLACE = `
in vec4 position;
uniform mat4 seen;
uniform vec4 sideways, onward;
uniform vec3 shown;
uniform float size, cut;
float place(vec4 cell) {
  float near = dot(cell, onward), kind = position.w;
  bool open = cut > 0.5 && near > 0.0 && dot(cell, sideways) > 0.0;
  bool kept = (kind < 0.5 ? shown.x : kind < 1.5 ? shown.y : shown.z) > 0.5;
  gl_PointSize = size;
  gl_Position = kept && !open ? seen * cell : vec4(2.0);
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

export class Voxels extends Points {
  #slots = new Map();
  #cells = new Int16Array(0);
  #born = new Float32Array(0);
  #uniforms = {
    seen: { value: new Matrix4() }, sideways: { value: new Vector4() }, onward: { value: new Vector4() },
    shown: { value: [1, 1, 1] }, cut: { value: 0 }, size: { value: 1 }, now: { value: 0 },
    colours: { value: [] }, flash: { value: raw("#ffffff") },
    paper: { value: raw("#ffffff") }, faded: { value: 0 },
    across: { value: new Vector3() }, down: { value: new Vector3() }, enter: { value: new Vector3() },
    thick: { value: new Vector3() }, light: { value: new Vector3() },
  };
  #edge = EDGE;
  #newest = OLD;
  #most = 0; // m from the middle

  /** @param kinds the scene's kinds of success, from worst to best */
  constructor(kinds, middle) {
    super();
    this.kinds = kinds;
    this.numbers = new Uint32Array(0);
    this.counts = kinds.map(() => 0);
    this.frustumCulled = false;
    this.renderOrder = 1;
    this.middle = new Vector3(...middle);
    this.#uniforms.colours.value = kinds.map(({ colour }) => raw(colour));
    this.fine = this.#material(VERTEX, FRAGMENT);
    this.plain = this.#material(VERTEX, FRAGMENT, { PLAIN: 1 });
    this.named = this.#material(NAMED_VERTEX, NAMED_FRAGMENT);
    this.material = this.fine;
    this.#grow(FIRST);
  }

  get size() {
    return this.#slots.size;
  }

  /** Take a page in; `now` [s] is when its voxels are born, null where they are to be there already. */
  update({ n, numbers, cells, outcomes }, now) {
    const worst = this.kinds[0].outcome;
    const changed = new Uint32Array(n);
    if (this.size + n > this.numbers.length) this.#grow(2 ** Math.ceil(Math.log2(this.size + n)));
    for (let i = 0; i < n; i++) {
      const slot = this.#slot(cells[3 * i], cells[3 * i + 1], cells[3 * i + 2]);
      const kind = outcomes[i] - worst;
      if (this.numbers[slot] !== numbers[i]) this.#born[slot] = now ?? OLD;
      this.#count(slot, kind);
      this.numbers[slot] = numbers[i];
      this.#cells[4 * slot + 3] = kind;
      changed[i] = slot;
    }
    if (n) this.#send(changed.sort());
    if (n && now !== null) this.#newest = now;
  }

  /** Whether some still show that they are new. */
  glows(now) {
    return now - this.#newest < GLOW;
  }

  cell(slot) {
    return this.#cells.subarray(4 * slot, 4 * slot + 3);
  }

  kind(slot) {
    return this.#cells[4 * slot + 3];
  }

  /** How far from the middle the farthest one is [m]. */
  get farthest() {
    return this.#most;
  }

  /** The slot of the voxel with a find; -1 where there is none. */
  slotOf(number) {
    return this.numbers.subarray(0, this.size).indexOf(number);
  }

  /** Which kinds are shown. */
  set shown(flags) {
    this.#uniforms.shown.value = flags.map(Number);
  }

  get shown() {
    return this.#uniforms.shown.value.map(Boolean);
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
    const most = this.#most || 1; // m
    for (const [plane, axis, unit] of [[uniforms.sideways, right, 1], [uniforms.onward, toward, most]]) {
      plane.value.set(...axis.clone().multiplyScalar(CELL / unit), -axis.dot(this.middle) / unit);
    }
    this.geometry.setDrawRange(0, Math.ceil(share * this.size));
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
    if (this.renderOrder === BEHIND) renderer.clearDepth();
  }

  dispose() {
    this.geometry.dispose();
    for (const material of [this.fine, this.plain, this.named]) material.dispose();
  }

  #material(vertexShader, fragmentShader, defines = {}) {
    return new RawShaderMaterial({ glslVersion: GLSL3, uniforms: this.#uniforms, vertexShader, fragmentShader, defines });
  }

  #slot(x, y, z) {
    const key = ((x + 32768) * 65536 + y + 32768) * 65536 + z + 32768;
    const known = this.#slots.get(key);
    if (known !== undefined) return known;
    const slot = this.#slots.size;
    this.#slots.set(key, slot);
    const place = 4 * slot;
    this.#cells[place] = x;
    this.#cells[place + 1] = y;
    this.#cells[place + 2] = z;
    this.#cells[place + 3] = -1;
    const { x: a, y: b, z: c } = this.middle;
    this.#most = Math.max(this.#most, Math.hypot(CELL * x - a, CELL * y - b, CELL * z - c));
    return slot;
  }

  #count(slot, kind) {
    const before = this.kind(slot);
    if (before >= 0) this.counts[before] -= 1;
    this.counts[kind] += 1;
  }

  /** Have these slots, in order, sent to the graphics card, those close to each other together. */
  #send(slots) {
    const attributes = Object.values(this.geometry.attributes);
    let first = slots[0], last = slots[0];
    const range = () => attributes.forEach((each) => each.addUpdateRange(first * each.itemSize, (last - first + 1) * each.itemSize));
    for (const slot of slots) {
      if (slot > last + CLOSE) {
        range();
        first = slot;
      }
      last = slot;
    }
    range();
    for (const attribute of attributes) attribute.needsUpdate = true;
  }

  #grow(room) {
    const grown = (Type, old, width) => {
      const array = new Type(width * room);
      array.set(old);
      return array;
    };
    this.numbers = grown(Uint32Array, this.numbers, 1);
    this.#cells = grown(Int16Array, this.#cells, 4);
    this.#born = grown(Float32Array, this.#born, 1);
    this.geometry.dispose();
    this.geometry = new BufferGeometry();
    this.geometry.setAttribute("position", new BufferAttribute(this.#cells, 4).setUsage(DynamicDrawUsage));
    this.geometry.setAttribute("born", new BufferAttribute(this.#born, 1).setUsage(DynamicDrawUsage));
  }
}

/** How bright the face of a cube is that looks along axis `k` and toward the viewer. */
function lit(k, toward, right, up) {
  const side = Math.sign(toward[k]) || 1;
  const seen = side * (-0.4 * right[k] + 0.62 * up[k] + 0.68 * toward[k]);
  return 0.62 + 0.42 * Math.max(0, seen);
}
