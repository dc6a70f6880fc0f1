// The lens: parallel projection, so that a length is the same number of pixels everywhere, and what it shows.

import { OrthographicCamera, Vector3 } from "../vendor/three/three.module.min.js";

const FAR = 40; // m

export class Lens {
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

  /** A camera for what is seen in a rectangle around a place [px, from the middle], seen as now. */
  around(x, y, width, height) {
    const drawn = this.#drawn;
    const half = [width / 2 / this.scale, height / 2 / this.scale];
    drawn.position.copy(this.camera.position);
    drawn.quaternion.copy(this.camera.quaternion);
    Object.assign(drawn, { left: x / this.scale - half[0], right: x / this.scale + half[0] });
    Object.assign(drawn, { top: y / this.scale + half[1], bottom: y / this.scale - half[1] });
    drawn.updateProjectionMatrix();
    drawn.updateMatrixWorld();
    return drawn;
  }

  /** Look at a place from a direction, with a sphere of this radius [m] in the picture. */
  look(target, direction, radius) {
    this.camera.position.copy(direction).setLength(FAR / 2).add(target);
    this.camera.lookAt(target);
    this.camera.zoom = (0.47 * Math.min(this.width, this.height)) / radius;
    this.camera.updateProjectionMatrix();
  }
}
