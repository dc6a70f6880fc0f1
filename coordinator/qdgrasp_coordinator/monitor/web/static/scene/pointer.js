// The pointer: which voxel is under the mouse or the finger when it is pressed and let go.

const TAP = 5; // px: who moved farther has turned the view
const NEAR = { mouse: 3, pen: 6, touch: 14 }; // px: so close to a voxel is on it

export class Pointer {
  #down = null;

  /** `onpick(slot)` with the slot of the voxel; -1: there is none. */
  constructor(stage, { onpick, onfail }) {
    Object.assign(this, { stage, onpick, onfail });
    this.#listen("addEventListener");
  }

  dispose() {
    this.#listen("removeEventListener");
  }

  #listen(verb) {
    this.stage.canvas[verb]("pointerdown", this.#pressed);
    this.stage.canvas[verb]("pointerup", this.#released);
  }

  #pressed = ({ clientX, clientY, isPrimary }) => {
    this.#down = isPrimary ? [clientX, clientY] : null;
  };

  #released = async ({ clientX, clientY, button, pointerType }) => {
    const moved = this.#down && Math.hypot(clientX - this.#down[0], clientY - this.#down[1]);
    if (!this.stage.voxels || this.#down === null || moved > TAP || button) return;
    const { left, top } = this.stage.canvas.getBoundingClientRect();
    try {
      this.onpick(await this.#slotAt(clientX - left, clientY - top, NEAR[pointerType] ?? NEAR.mouse));
    } catch (error) {
      this.onfail(error);
    }
  };

  /** The slot of the voxel at a place on the canvas [px]: drawn in the colours of their numbers, it is looked up. */
  async #slotAt(x, y, near) {
    const { stage } = this, { lens, renderer, voxels } = stage;
    lens.aim();
    const size = voxels.aim(lens);
    const side = 2 * Math.max(Math.ceil(size / 2), near) + 1;
    const pixels = await stage.sample(x, y, side, (camera) => {
      voxels.material = voxels.named;
      renderer.render(voxels, camera);
    });
    return closest(pixels, side, near);
  }
}

/** The slot that a pixel near the middle names, the nearest one; -1 where none does. */
function closest(pixels, side, near) {
  const middle = (side - 1) / 2;
  let slot = -1, least = near * near + 1;
  for (let y = 0; y < side; y++) {
    for (let x = 0; x < side; x++) {
      const far = (x - middle) ** 2 + (y - middle) ** 2, i = 4 * (y * side + x);
      if (far < least && pixels[i + 3]) {
        least = far;
        slot = pixels[i] + 256 * pixels[i + 1] + 65536 * pixels[i + 2] - 1;
      }
    }
  }
  return slot;
}
