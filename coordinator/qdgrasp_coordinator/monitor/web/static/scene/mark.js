// The mark: the edges of the cell of the chosen grasp, seen through everything.

import { BoxGeometry, EdgesGeometry, GLSL3, LineSegments, RawShaderMaterial } from "../vendor/three/three.module.min.js";
import { raw } from "./solid.js";
import { CELL } from "./voxels.js";

const VERTEX = `
in vec3 position;
uniform mat4 modelViewMatrix, projectionMatrix;
void main() { gl_Position = projectionMatrix * modelViewMatrix * vec4(position, 1.0); }`;
const FRAGMENT = `
precision highp float;
uniform vec3 colour;
out vec4 painted;
void main() { painted = vec4(colour, 1.0); }`;

export class Mark extends LineSegments {
  constructor(colour) {
    const uniforms = { colour: { value: raw(colour) } };
    const looks = { glslVersion: GLSL3, uniforms, vertexShader: VERTEX, fragmentShader: FRAGMENT, depthTest: false };
    super(new EdgesGeometry(new BoxGeometry(CELL, CELL, CELL)), new RawShaderMaterial(looks));
    this.visible = false;
    this.renderOrder = 4;
  }

  /** Stand at a cell; null: be gone. */
  at(cell) {
    this.visible = Boolean(cell);
    if (cell) this.position.set(...cell.map((k) => CELL * k));
  }

  wear(colour) {
    this.material.uniforms.colour.value = raw(colour);
  }

  dispose() {
    this.geometry.dispose();
    this.material.dispose();
  }
}
