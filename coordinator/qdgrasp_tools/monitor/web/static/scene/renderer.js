// The renderer: draws when something changed and only then, coarsely while it moves where drawing takes long.

import { OrbitControls } from "../vendor/three/OrbitControls.js";
import { OrthographicCamera, Scene, Vector3, WebGLRenderer } from "../vendor/three/three.module.min.js";
import { AxesOverlay, ContactOverlay, FrameOverlay } from "./overlays.js";

const REST = 180; // ms after the last movement: then it is drawn finely
const SLOW = 40; // ms: where frames take longer, what moves is drawn with half of the pixels along each side
const PIXELS = 6e6; // drawn at most for one picture

/** Draws the scene on a canvas; without a change nothing is drawn. */
export class Renderer {
  /** @throws where the browser draws no 3D */
  constructor(canvas) {
    this.canvas = canvas;
    this.scene = new Scene();
    this.projection = new Projection();
    /** Whether nothing may move by itself. */
    this.calm = matchMedia("(prefers-reduced-motion: reduce)").matches;
    /** Whether the view was turned by hand since it was last shown whole. */
    this.touched = false;
    const context = canvas.getContext("webgl2", { antialias: true, alpha: true, powerPreference: "low-power" });
    if (!context) throw new Error("no WebGL 2");
    this.webgl = new WebGLRenderer({ canvas, context });
    this.webgl.setClearAlpha(0);
    this.controls = this.#madeControls();
    this.axes = new AxesOverlay(canvas.parentElement);
    this.contacts = new ContactOverlay(canvas.parentElement);
    this.frames = new FrameOverlay(canvas.parentElement);
    this.#sizes = new ResizeObserver(() => this.#fit());
    this.#sizes.observe(canvas);
    canvas.addEventListener("webglcontextlost", this.#lost);
    canvas.addEventListener("webglcontextrestored", this.#restored);
    canvas.addEventListener("pointerdown", this.#focus);
    canvas.addEventListener("focus", this.#captureInput);
    canvas.addEventListener("blur", this.#captureInput);
    this.#fit();
    this.#captureInput();
  }

  /** The voxels, which are drawn in a way of their own; null before there are any. */
  voxels = null;
  /** Called when the graphics are lost (true) and back (false). */
  onlost = () => {};
  /** Called when the view was turned, moved or zoomed, unless it follows another. */
  onmoved = () => {};
  #sizes;
  #frame = 0;
  #movedAt = -Infinity;
  #hasMoved = false;
  #drawnAt = 0;
  #mean = 0; // ms that a frame takes while it moves
  #disposed = false;
  #follows = false; // what follows another view does not lead it

  /** Draw the view once more, at the next frame. */
  invalidate() {
    if (!this.#frame && !this.#disposed) this.#frame = requestAnimationFrame((at) => this.#draw(at));
  }

  /** Draw it as something that moves. */
  moved() {
    this.#hasMoved = true;
    this.#movedAt = performance.now();
    this.invalidate();
    this.#lead();
  }

  /** Look from where another renderer does, at the same scale. */
  follow({ projection, controls, touched }) {
    this.#follows = true;
    const { camera } = this.projection, { position, quaternion, zoom } = projection.camera;
    camera.position.copy(position);
    camera.quaternion.copy(quaternion);
    camera.zoom = zoom;
    camera.updateProjectionMatrix();
    this.controls.target.copy(controls.target);
    Object.assign(this.controls, { minZoom: controls.minZoom, maxZoom: controls.maxZoom });
    this.controls.update();
    this.touched = touched;
    this.#follows = false;
    this.invalidate();
  }

  #lead() {
    if (!this.#follows) this.onmoved();
  }

  /** Look at a place with a sphere of this radius [m] in the picture, along a direction. */
  lookAt(target, radius, direction = new Vector3(-0.62, -1, 0.58)) {
    this.controls.enableDamping = false; // what is left of a movement is over
    this.controls.update();
    this.projection.lookAt(target, direction, radius);
    this.controls.target.copy(target);
    this.controls.minZoom = this.projection.scale / 6;
    this.controls.maxZoom = this.projection.scale * 30;
    this.controls.update();
    this.touched = false;
    this.invalidate();
    this.#lead();
  }

  dispose() {
    this.#disposed = true;
    cancelAnimationFrame(this.#frame);
    this.#sizes.disconnect();
    this.controls.dispose();
    this.axes.dispose();
    this.contacts.dispose();
    this.frames.dispose();
    this.canvas.removeEventListener("webglcontextlost", this.#lost);
    this.canvas.removeEventListener("webglcontextrestored", this.#restored);
    this.canvas.removeEventListener("pointerdown", this.#focus);
    this.canvas.removeEventListener("focus", this.#captureInput);
    this.canvas.removeEventListener("blur", this.#captureInput);
    this.webgl.resetState(); // another renderer may use the canvas
    this.webgl.dispose();
  }

  #draw(at) {
    this.#frame = 0;
    if (this.webgl.getContext().isContextLost()) return;
    const isSlow = this.#mean > SLOW;
    this.controls.enableDamping = !this.calm && !isSlow; // where pictures are few it would go on for long
    const moving = this.controls.update() || this.#hasMoved || performance.now() - this.#movedAt < REST;
    this.#hasMoved = false; // however late this picture is, what moved before it is drawn as moving
    if (moving && this.#drawnAt) this.#mean = 0.6 * this.#mean + 0.4 * Math.min(at - this.#drawnAt, 5 * SLOW);
    this.projection.aim();
    this.#paint(moving && isSlow ? 0.5 : this.#finest);
    if (moving) this.invalidate();
    this.#drawnAt = moving ? at : 0;
    this.axes.draw(this.projection);
    this.contacts.draw(this.projection);
    this.frames.draw(this.projection);
  }

  get #finest() {
    return Math.min(devicePixelRatio, Math.sqrt(PIXELS / (this.projection.width * this.projection.height)));
  }

  #paint(scale) {
    const { projection, webgl, voxels } = this;
    const width = Math.max(1, Math.round(projection.width * scale)), height = Math.max(1, Math.round(projection.height * scale));
    if (this.canvas.width !== width || this.canvas.height !== height) webgl.setSize(width, height, false);
    const { right, up, toward } = projection;
    const size = voxels?.aim({ right, up, toward, scale: projection.scale * scale, page: projection.scale }) ?? 0;
    const band = Math.ceil(size / 2); // a voxel whose middle is beyond the edge may still be seen
    webgl.setViewport(-band, -band, width + 2 * band, height + 2 * band);
    webgl.render(this.scene, projection.margined(band / scale));
  }

  #fit() {
    const { clientWidth: width, clientHeight: height } = this.canvas;
    if (!width || !height) return;
    const grown = Math.min(width, height) / Math.min(this.projection.width, this.projection.height);
    this.projection.camera.zoom *= grown;
    this.controls.minZoom *= grown; // else a canvas that is tiny for a moment would be seen too closely ever after
    this.controls.maxZoom *= grown;
    this.projection.resize(width, height);
    this.invalidate();
    this.#lead();
  }

  #madeControls() {
    const controls = new OrbitControls(this.projection.camera, this.canvas);
    controls.dampingFactor = 0.18;
    controls.addEventListener("change", () => this.moved());
    controls.addEventListener("start", () => (this.touched = true));
    return controls;
  }

  #focus = () => this.canvas.focus({ preventScroll: true });

  /** The wheel and a finger scroll the page until the canvas has the focus. */
  #captureInput = () => {
    const held = document.activeElement === this.canvas;
    this.controls.enableZoom = held;
    this.canvas.style.touchAction = held ? "none" : "pan-y";
  };

  #lost = (event) => {
    event.preventDefault(); // so that it comes back
    this.onlost(true);
  };

  #restored = () => {
    this.onlost(false);
    this.invalidate();
  };
}

const FAR = 40; // m

/** Parallel projection, so that a length is the same number of pixels everywhere. */
class Projection {
  constructor() {
    /** What the controls turn; its zoom is pixels per metre. */
    this.camera = new OrthographicCamera(-1, 1, 1, -1, 0.01, FAR);
    this.camera.up.set(0, 0, 1);
    this.right = new Vector3();
    this.up = new Vector3();
    this.toward = new Vector3();
    this.#drawn = this.camera.clone();
    this.resize(300, 300); // until the canvas is seen
  }

  #drawn;

  /** Pixels of the page in a metre. */
  get scale() {
    return this.camera.zoom;
  }

  resize(width, height) {
    Object.assign(this.camera, { left: -width / 2, right: width / 2, top: height / 2, bottom: -height / 2 });
    Object.assign(this, { width, height });
    this.camera.updateProjectionMatrix();
  }

  /** Read the directions that the picture has in the world. */
  aim() {
    this.camera.updateMatrixWorld();
    this.camera.matrixWorld.extractBasis(this.right, this.up, this.toward);
  }

  /** A camera for what is seen now, and so many pixels of the page around it. */
  margined(band) {
    const drawn = this.#drawn;
    const across = (this.width / 2 + band) / this.scale, along = (this.height / 2 + band) / this.scale;
    drawn.position.copy(this.camera.position);
    drawn.quaternion.copy(this.camera.quaternion);
    Object.assign(drawn, { left: -across, right: across, top: along, bottom: -along });
    drawn.updateProjectionMatrix();
    drawn.updateMatrixWorld();
    return drawn;
  }

  /** Look at a place from a direction, with a sphere of this radius [m] in the picture. */
  lookAt(target, direction, radius) {
    this.camera.position.copy(direction).setLength(FAR / 2).add(target);
    this.camera.lookAt(target);
    this.camera.zoom = (0.47 * Math.min(this.width, this.height)) / radius;
    this.camera.updateProjectionMatrix();
  }
}
