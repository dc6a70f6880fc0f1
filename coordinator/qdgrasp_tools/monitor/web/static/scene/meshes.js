// Triangle meshes, lit from beside the viewer; the hand; edges of a box.

import {
  BoxGeometry, BufferAttribute, BufferGeometry, Color, DoubleSide, EdgesGeometry, FrontSide, GLSL3, Group, LineSegments, Matrix4,
  Mesh, Quaternion, RawShaderMaterial, Vector3,
} from "../vendor/three/three.module.min.js";

const MESH_VERTEX = `
in vec3 position;
in vec3 normal;
in float margin;
uniform mat4 modelViewMatrix, projectionMatrix;
uniform mat3 normalMatrix;
out vec3 n;
out float inside;
void main() {
  n = normalMatrix * normal;
  inside = margin;
  gl_Position = projectionMatrix * modelViewMatrix * vec4(position, 1.0);
}`;
const MESH_FRAGMENT = `
precision highp float;
uniform vec3 colour, forbidden;
uniform float solidity;
in vec3 n;
in float inside;
out vec4 painted;
void main() {
  vec3 m = normalize(gl_FrontFacing ? n : -n);
  float light = 0.5 + 0.5 * max(dot(m, vec3(-0.4, 0.62, 0.68)), 0.0) + 0.1 * m.y;
  float edge = pow(1.0 - abs(m.z), 2.0);
  float alpha = mix(solidity, 1.0, edge * (1.0 - solidity) * 0.8);
  painted = vec4((inside < 0.0 ? forbidden : colour) * light * alpha, alpha);
}`;

/** A material in a colour, where a mesh has margins below 0 in another one; `solidity` below 1 makes it glass whose edges show. */
export function meshMaterial(colour, solidity = 1, forbidden = colour) {
  const glass = solidity < 1;
  return new RawShaderMaterial({
    glslVersion: GLSL3,
    uniforms: { colour: { value: drawnColour(colour) }, forbidden: { value: drawnColour(forbidden) }, solidity: { value: solidity } },
    vertexShader: MESH_VERTEX,
    fragmentShader: MESH_FRAGMENT,
    transparent: glass,
    premultipliedAlpha: true,
    depthWrite: !glass,
    side: glass ? FrontSide : DoubleSide,
  });
}

/** A CSS colour as it is drawn: no conversion between colour spaces. */
export function drawnColour(colour) {
  return new Color().setStyle(colour, "srgb-linear");
}

/** The geometry of a mesh as the server sends it: faces that meet at a sharp angle share no vertices. */
export function meshGeometry({ positions, indices, margins }) {
  const geometry = new BufferGeometry();
  geometry.setAttribute("position", new BufferAttribute(new Float32Array(bytes(positions)), 3));
  if (margins) geometry.setAttribute("margin", new BufferAttribute(new Float32Array(bytes(margins)), 1));
  geometry.setIndex(new BufferAttribute(new Uint32Array(bytes(indices)), 1));
  geometry.computeVertexNormals();
  return geometry;
}

function bytes(base64) {
  return Uint8Array.from(atob(base64), (letter) => letter.charCodeAt(0)).buffer;
}

const PALM = 0.42; // solidity

const ONE = new Vector3(1, 1, 1);

/** The frame of a link at a place on its way, from 0 at its first pose to 1 at its last.
 *  `poses` are evenly spaced, each x y z qx qy qz qw. */
export function frameAt(poses, place) {
  const along = place * (poses.length - 1), first = Math.min(Math.floor(along), poses.length - 2), share = along - first;
  const [from, to] = [poses[first], poses[first + 1]];
  const position = new Vector3(...from.slice(0, 3)).lerp(new Vector3(...to.slice(0, 3)), share);
  const turn = new Quaternion(...from.slice(3)).slerp(new Quaternion(...to.slice(3)), share);
  return new Matrix4().compose(position, turn, ONE);
}

/** The hand: its links in the frames that the server gives; fingers solid, the palm like glass. */
export class HandMesh extends Group {
  #links = new Map();

  /** @param links the scene's, each with its name, mesh and whether it is a finger */
  constructor(links, colour) {
    super();
    this.visible = false;
    for (const { name, finger, mesh } of links) {
      const link = new Mesh(meshGeometry(mesh), meshMaterial(colour, finger ? 1 : PALM));
      link.renderOrder = finger ? 2 : 3;
      link.matrixAutoUpdate = false;
      this.#links.set(name, link);
      this.add(link);
    }
  }

  /** Place the links at a place on their ways (`frameAt`), of which `frames` has each; null: hide the hand. */
  pose(frames, place) {
    this.visible = Boolean(frames);
    if (frames) for (const [name, link] of this.#links) link.matrix.copy(frameAt(frames[name], place));
  }

  recolour(colour) {
    for (const link of this.#links.values()) link.material.uniforms.colour.value = drawnColour(colour);
  }

  dispose() {
    for (const link of this.#links.values()) {
      link.geometry.dispose();
      link.material.dispose();
    }
  }
}

const EDGE_VERTEX = `
in vec3 position;
uniform mat4 modelViewMatrix, projectionMatrix;
void main() { gl_Position = projectionMatrix * modelViewMatrix * vec4(position, 1.0); }`;
const EDGE_FRAGMENT = `
precision highp float;
uniform vec3 colour;
out vec4 painted;
void main() { painted = vec4(colour, 1.0); }`;

/** The edges of a box, drawn over everything. */
export class BoxEdges extends LineSegments {
  constructor(colour) {
    const uniforms = { colour: { value: drawnColour(colour) } };
    const looks = { glslVersion: GLSL3, uniforms, vertexShader: EDGE_VERTEX, fragmentShader: EDGE_FRAGMENT, depthTest: false };
    super(new EdgesGeometry(new BoxGeometry(1, 1, 1)), new RawShaderMaterial(looks));
    this.visible = false;
    this.renderOrder = 4;
  }

  /** Show the box between two corners [m]; without any: hide it. */
  span(low = null, high = null) {
    this.visible = Boolean(low);
    if (!low) return;
    this.position.set(...low.map((from, axis) => (from + high[axis]) / 2));
    this.scale.set(...low.map((from, axis) => high[axis] - from));
  }

  recolour(colour) {
    this.material.uniforms.colour.value = drawnColour(colour);
  }

  dispose() {
    this.geometry.dispose();
    this.material.dispose();
  }
}
