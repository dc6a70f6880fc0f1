// Solids: triangle meshes with creases where they have edges, lit calmly from beside the viewer.

import { BufferAttribute, BufferGeometry, Color, DoubleSide, FrontSide, GLSL3, RawShaderMaterial } from "../vendor/three/three.module.min.js";

const CREASE = 0.7; // cosine: faces that meet at a sharper angle keep an edge
const VERTEX = `
in vec3 position;
in vec3 normal;
uniform mat4 modelViewMatrix, projectionMatrix;
uniform mat3 normalMatrix;
out vec3 n;
void main() {
  n = normalMatrix * normal;
  gl_Position = projectionMatrix * modelViewMatrix * vec4(position, 1.0);
}`;
const FRAGMENT = `
precision highp float;
uniform vec3 colour;
uniform float solidity;
in vec3 n;
out vec4 painted;
void main() {
  vec3 m = normalize(gl_FrontFacing ? n : -n);
  float light = 0.5 + 0.5 * max(dot(m, vec3(-0.4, 0.62, 0.68)), 0.0) + 0.1 * m.y;
  float edge = pow(1.0 - abs(m.z), 2.0);
  float alpha = mix(solidity, 1.0, edge * (1.0 - solidity) * 0.8);
  painted = vec4(colour * light * alpha, alpha);
}`;

/** A material in a colour; `solidity` below 1 makes it glass whose edges show. */
export function paint(colour, solidity = 1) {
  const glass = solidity < 1;
  return new RawShaderMaterial({
    glslVersion: GLSL3,
    uniforms: { colour: { value: raw(colour) }, solidity: { value: solidity } },
    vertexShader: VERTEX,
    fragmentShader: FRAGMENT,
    transparent: glass,
    premultipliedAlpha: true,
    depthWrite: !glass,
    side: glass ? FrontSide : DoubleSide,
  });
}

/** A CSS colour as it is drawn: no conversion between colour spaces. */
export function raw(colour) {
  return new Color().setStyle(colour, "srgb-linear");
}

/** The geometry of a mesh as the server sends it. */
export function solid({ positions, indices }) {
  return creased(new Float32Array(bytes(positions)), new Uint32Array(bytes(indices)));
}

function bytes(base64) {
  return Uint8Array.from(atob(base64), (letter) => letter.charCodeAt(0)).buffer;
}

function creased(vertices, corners) {
  const normals = faceNormals(vertices, corners);
  const around = facesAround(vertices.length / 3, corners);
  const position = new Float32Array(3 * corners.length), normal = new Float32Array(3 * corners.length);
  corners.forEach((vertex, corner) => {
    position.set(vertices.subarray(3 * vertex, 3 * vertex + 3), 3 * corner);
    smooth(normals, Math.floor(corner / 3), around, vertex, normal, 3 * corner);
  });
  const geometry = new BufferGeometry();
  geometry.setAttribute("position", new BufferAttribute(position, 3));
  geometry.setAttribute("normal", new BufferAttribute(normal, 3));
  return geometry;
}

/** (4 f): each face's unit normal, and twice its area. */
function faceNormals(vertices, corners) {
  const normals = new Float32Array(corners.length / 3 * 4);
  for (let face = 0; face < corners.length / 3; face++) {
    const [a, b, c] = [0, 1, 2].map((k) => 3 * corners[3 * face + k]);
    const u = [0, 1, 2].map((k) => vertices[b + k] - vertices[a + k]);
    const v = [0, 1, 2].map((k) => vertices[c + k] - vertices[a + k]);
    const cross = [u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]];
    const area = Math.hypot(...cross);
    normals.set([...cross.map((part) => part / (area || 1)), area], 4 * face);
  }
  return normals;
}

/** The faces around each vertex: those of vertex k are `faces` from `first[k]` up to `first[k + 1]`. */
function facesAround(count, corners) {
  const first = new Uint32Array(count + 1), faces = new Uint32Array(corners.length);
  for (const vertex of corners) first[vertex + 1] += 1;
  for (let vertex = 0; vertex < count; vertex++) first[vertex + 1] += first[vertex];
  const place = first.slice();
  corners.forEach((vertex, corner) => (faces[place[vertex]++] = Math.floor(corner / 3)));
  return { first, faces };
}

/** The mean normal of the faces around a corner of `face` that are no crease away, weighed by area. */
function smooth(normals, face, { first, faces }, vertex, out, place) {
  const [x, y, z] = normals.subarray(4 * face, 4 * face + 3);
  const sum = [0, 0, 0];
  for (let i = first[vertex]; i < first[vertex + 1]; i++) {
    const other = 4 * faces[i];
    if (x * normals[other] + y * normals[other + 1] + z * normals[other + 2] < CREASE) continue;
    for (let k = 0; k < 3; k++) sum[k] += normals[other + k] * normals[other + 3];
  }
  const length = Math.hypot(...sum);
  out.set(length ? sum.map((part) => part / length) : [x, y, z], place);
}
