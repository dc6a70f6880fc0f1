// The stage: where things are drawn, when something changed and only then; coarsely while it moves, then finely.

import { Scene, Vector3, WebGLRenderer, WebGLRenderTarget } from "../vendor/three/three.module.min.js";
import { OrbitControls } from "../vendor/three/OrbitControls.js";
import { Axes } from "./axes.js";
import { Frames } from "./frames.js";
import { Lens } from "./lens.js";
import { Pace } from "./pace.js";

const REST = 180; // ms after the last movement: then it is drawn finely
const COSTLY = 160; // ms: a still picture that takes longer is not smoothed
const BRISK = 60; // ms between pictures of what glows, at least; a fourth of the time at most is spent on them
const PIXELS = 6e6; // drawn at most for one picture

export class Stage {
  /** @throws where the browser draws no 3D */
  constructor(canvas) {
    this.canvas = canvas;
    this.things = new Scene();
    this.lens = new Lens();
    this.pace = new Pace();
    /** Whether nothing may move by itself. */
    this.calm = matchMedia("(prefers-reduced-motion: reduce)").matches;
    /** Whether somebody has turned the view since it was last shown whole. */
    this.touched = false;
    /** How many pictures were drawn. */
    this.drawn = 0;
    /** How long to wait before the next picture of something that glows [ms]. */
    this.rest = BRISK;
    const context = canvas.getContext("webgl2", { antialias: false, alpha: true, powerPreference: "low-power" });
    if (!context) throw new Error("no WebGL 2");
    this.renderer = new WebGLRenderer({ canvas, context });
    this.renderer.setClearAlpha(0);
    this.controls = this.#steered();
    this.axes = new Axes(canvas.parentElement);
    this.frames = new Frames(canvas.parentElement);
    this.#sizes = new ResizeObserver(() => this.#fit());
    this.#sizes.observe(canvas);
    canvas.addEventListener("webglcontextlost", this.#lost);
    canvas.addEventListener("webglcontextrestored", this.#back);
    canvas.addEventListener("pointerdown", this.#focus);
    canvas.addEventListener("focus", this.#hold);
    canvas.addEventListener("blur", this.#hold);
    this.#fit();
    this.#hold();
  }

  /** The voxels, which are drawn in a way of their own; null before there are any. */
  voxels = null;
  /** Called before each picture. */
  onframe = () => {};
  /** Told when the graphics are lost (true) and back (false). */
  onlost = () => {};
  #sizes;
  #frame = 0;
  #timer = 0;
  #movedAt = -Infinity;
  #stirred = false;
  #before = 0;
  #smooth = false;
  #gone = false;

  /** Have the view drawn once more. */
  invalidate() {
    if (!this.#frame && !this.#gone) this.#frame = requestAnimationFrame((at) => this.#draw(at));
  }

  /** Have it drawn as something that moves. */
  moved() {
    this.#stirred = true;
    this.#movedAt = performance.now();
    this.invalidate();
  }

  /** Draw what is at a place [px of the page] with another camera, into a target; gives its pixels. */
  async sample(x, y, side, draw) {
    const target = new WebGLRenderTarget(side, side);
    const pixels = new Uint8Array(4 * side * side);
    this.lens.aim();
    this.renderer.setRenderTarget(target);
    this.renderer.clear();
    draw(this.lens.around(x - this.lens.width / 2, this.lens.height / 2 - y, side, side));
    this.renderer.setRenderTarget(null);
    await this.renderer.readRenderTargetPixelsAsync(target, 0, 0, side, side, pixels);
    target.dispose();
    return pixels;
  }

  look(target, radius, direction = new Vector3(-0.62, -1, 0.58)) {
    this.controls.enableDamping = false; // what is left of a movement is over
    this.controls.update();
    this.lens.look(target, direction, radius);
    this.controls.target.copy(target);
    this.controls.minZoom = this.lens.scale / 6;
    this.controls.maxZoom = this.lens.scale * 30;
    this.controls.update();
    this.touched = false;
    this.invalidate();
  }

  dispose() {
    this.#gone = true;
    cancelAnimationFrame(this.#frame);
    clearTimeout(this.#timer);
    this.#sizes.disconnect();
    this.controls.dispose();
    this.axes.dispose();
    this.frames.dispose();
    this.canvas.removeEventListener("webglcontextlost", this.#lost);
    this.canvas.removeEventListener("webglcontextrestored", this.#back);
    this.canvas.removeEventListener("pointerdown", this.#focus);
    this.canvas.removeEventListener("focus", this.#hold);
    this.canvas.removeEventListener("blur", this.#hold);
    this.renderer.resetState(); // another stage may use the canvas
    this.renderer.dispose();
  }

  #draw(at) {
    this.#frame = 0;
    if (this.renderer.getContext().isContextLost()) return;
    this.controls.enableDamping = !this.calm && this.pace.finest; // where pictures are few it would go on for long
    const moving = this.controls.update() || this.#stirred || performance.now() - this.#movedAt < REST;
    this.#stirred = false; // however late this picture is, what moved before it is drawn as moving
    if (moving) this.#follow(at);
    this.onframe(at);
    this.lens.aim();
    this.#paint(moving ? this.pace.level : { scale: this.#finest() });
    if (moving) this.invalidate();
    else this.#judge();
    this.#before = moving ? at : 0;
    this.axes.draw(this.lens);
    this.frames.draw(this.lens);
    this.drawn += 1;
  }

  /** Keep the pace while it moves. */
  #follow(at) {
    if (this.#before) this.pace.took(at - this.#before);
    this.canvas.dataset.pace = this.pace.words;
  }

  /** See how long a still picture takes: it is smoothed where that costs little, and by a second picture. */
  #judge() {
    const began = performance.now(), context = this.renderer.getContext(), smooth = this.#smooth;
    const fence = context.fenceSync(context.SYNC_GPU_COMMANDS_COMPLETE, 0);
    context.flush();
    const look = () => {
      if (this.#gone || context.isContextLost()) return;
      if (context.getSyncParameter(fence, context.SYNC_STATUS) !== context.SIGNALED) return (this.#timer = setTimeout(look, 4));
      context.deleteSync(fence);
      const took = performance.now() - began;
      this.rest = Math.max(BRISK, 4 * took);
      this.#smooth = took < (smooth ? COSTLY : COSTLY / 5);
      if (this.#smooth && !smooth) this.invalidate();
    };
    clearTimeout(this.#timer);
    this.#timer = setTimeout(look, 4);
  }

  #finest() {
    const dense = devicePixelRatio * (this.#smooth && devicePixelRatio < 2 ? 2 : 1);
    return Math.min(dense, Math.sqrt(PIXELS / (this.lens.width * this.lens.height)));
  }

  #paint({ scale, ...looks }) {
    const { lens, renderer, voxels } = this;
    const width = Math.max(1, Math.round(lens.width * scale)), height = Math.max(1, Math.round(lens.height * scale));
    if (this.canvas.width !== width || this.canvas.height !== height) renderer.setSize(width, height, false);
    const now = performance.now() / 1000, { right, up, toward } = lens;
    const size = voxels?.aim({ right, up, toward, scale: lens.scale * scale, now, ...looks }) ?? 0;
    const band = Math.ceil(size / 2); // a voxel whose middle is beyond the edge may still be seen
    renderer.setViewport(-band, -band, width + 2 * band, height + 2 * band);
    renderer.render(this.things, lens.around(0, 0, lens.width + (2 * band) / scale, lens.height + (2 * band) / scale));
  }

  #fit() {
    const { clientWidth: width, clientHeight: height } = this.canvas;
    if (!width || !height) return;
    const grown = Math.min(width, height) / Math.min(this.lens.width, this.lens.height);
    this.lens.camera.zoom *= grown;
    this.controls.minZoom *= grown; // else a canvas that is tiny for a moment would be seen too closely ever after
    this.controls.maxZoom *= grown;
    this.lens.resize(width, height);
    this.invalidate();
  }

  #steered() {
    const controls = new OrbitControls(this.lens.camera, this.canvas);
    controls.dampingFactor = 0.18;
    controls.addEventListener("change", () => this.moved());
    controls.addEventListener("start", () => (this.touched = true));
    return controls;
  }

  #focus = () => this.canvas.focus({ preventScroll: true });

  /** The wheel and a finger scroll the page until the view has been chosen. */
  #hold = () => {
    const held = document.activeElement === this.canvas;
    this.controls.enableZoom = held;
    this.canvas.style.touchAction = held ? "none" : "pan-y";
  };

  #lost = (event) => {
    event.preventDefault(); // so that it comes back
    this.onlost(true);
  };

  #back = () => {
    this.onlost(false);
    this.invalidate();
  };
}
