// Edges: those of a box, seen through everything.

import { BoxGeometry, EdgesGeometry, GLSL3, LineSegments, RawShaderMaterial } from "../vendor/three/three.module.min.js";
import { raw } from "./solid.js";

const VERTEX = `
in vec3 position;
uniform mat4 modelViewMatrix, projectionMatrix;
void main() { gl_Position = projectionMatrix * modelViewMatrix * vec4(position, 1.0); }`;
const FRAGMENT = `
precision highp float;
uniform vec3 colour;
out vec4 painted;
void main() { painted = vec4(colour, 1.0); }`;

export class Edges extends LineSegments {
  constructor(colour) {
    const uniforms = { colour: { value: raw(colour) } };
    const looks = { glslVersion: GLSL3, uniforms, vertexShader: VERTEX, fragmentShader: FRAGMENT, depthTest: false };
    super(new EdgesGeometry(new BoxGeometry(1, 1, 1)), new RawShaderMaterial(looks));
    this.visible = false;
    this.renderOrder = 4;
  }

  /** Be those of the box between two corners [m]; without any, be gone. */
  span(low = null, high = null) {
    this.visible = Boolean(low);
    if (!low) return;
    this.position.set(...low.map((from, axis) => (from + high[axis]) / 2));
    this.scale.set(...low.map((from, axis) => high[axis] - from));
  }

  wear(colour) {
    this.material.uniforms.colour.value = raw(colour);
  }

  dispose() {
    this.geometry.dispose();
    this.material.dispose();
  }
}
