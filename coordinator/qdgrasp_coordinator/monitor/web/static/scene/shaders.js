// Shaders: what the graphics card does for each voxel, and for each of its pixels.

export const GLOW = 1.2; // s: how long a new one shows that it is new

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

export const VERTEX = `
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
export const FRAGMENT = `
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

export const NAMED_VERTEX = `
flat out vec4 name;
${PLACE}
void main() {
  place(vec4(position.xyz, 1.0));
  int number = gl_VertexID + 1;
  name = vec4(number & 255, (number >> 8) & 255, (number >> 16) & 255, 255) / 255.0;
}`;

export const NAMED_FRAGMENT = `
precision highp float;
flat in vec4 name;
out vec4 painted;
void main() { painted = name; }`;
