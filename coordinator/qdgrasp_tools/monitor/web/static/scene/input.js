// Input to the view: keys do all that mouse and fingers do; a click selects the voxel under it.

const TURN = Math.PI / 24;
const SHIFT = 24; // px

const TYPED_IN = "input, select, textarea, [contenteditable]";

/** Whether a key is for the view: on its canvas any; elsewhere on the page a letter or escape that is not typed into
 *  something, and any while nothing has the focus on a page that does not scroll. */
export function isFor(canvas, { target, key }) {
  if (target === canvas) return true;
  if (target.closest?.(TYPED_IN) || target.matches?.("canvas")) return false;
  return /^([a-z]|Escape)$/.test(key) || (document.body.matches(".whole") && target.matches?.("body, main"));
}

/** Carry out the action of a key; false where it has none. */
export function handleKey(view, { key, shiftKey, ctrlKey, altKey, metaKey }) {
  if (ctrlKey || altKey || metaKey) return false;
  const action = ACTIONS[`${shiftKey && key.startsWith("Arrow") ? "Shift+" : ""}${key}`];
  if (!action) return false;
  action(view);
  return true;
}

const turn = (left, up) => ({ renderer }) => {
  if (left) renderer.controls.rotateLeft(left * TURN);
  if (up) renderer.controls.rotateUp(up * TURN);
  renderer.touched = true;
  renderer.moved();
};
const shift = (x, y) => ({ renderer }) => {
  renderer.controls.pan(x * SHIFT, y * SHIFT);
  renderer.touched = true;
  renderer.moved();
};
const zoom = (factor) => ({ renderer }) => {
  renderer.controls.dollyIn(1 / factor);
  renderer.touched = true;
  renderer.moved();
};

const ACTIONS = {
  ArrowLeft: turn(1, 0), ArrowRight: turn(-1, 0), ArrowUp: turn(0, 1), ArrowDown: turn(0, -1),
  "Shift+ArrowLeft": shift(1, 0), "Shift+ArrowRight": shift(-1, 0), "Shift+ArrowUp": shift(0, 1), "Shift+ArrowDown": shift(0, -1),
  "+": zoom(1.2), "=": zoom(1.2), "-": zoom(1 / 1.2),
  n: (view) => view.step(1), p: (view) => view.step(-1),
  Escape: (view) => view.select(null),
  Home: (view) => view.home(), 0: (view) => view.home(),
  c: (view) => (view.cut = !view.cut),
  f: (view) => (view.showsFrames = !view.showsFrames),
};

const TAP = 5; // px: a longer movement turns the view
const NEAR = { mouse: 3, pen: 6, touch: 14 }; // px: a press so close to a voxel selects it

/** Finds the voxel under the mouse or the finger when it is pressed and let go. */
export class VoxelPicker {
  #down = null;

  /** `onpick(slot)` with the slot of the voxel; -1: there is none. */
  constructor(renderer, onpick) {
    Object.assign(this, { renderer, onpick });
    this.#listen("addEventListener");
  }

  dispose() {
    this.#listen("removeEventListener");
  }

  #listen(verb) {
    this.renderer.canvas[verb]("pointerdown", this.#pressed);
    this.renderer.canvas[verb]("pointerup", this.#released);
  }

  #pressed = ({ clientX, clientY, isPrimary }) => {
    this.#down = isPrimary ? [clientX, clientY] : null;
  };

  #released = ({ clientX, clientY, button, pointerType }) => {
    const moved = this.#down && Math.hypot(clientX - this.#down[0], clientY - this.#down[1]);
    const { canvas, projection, voxels } = this.renderer;
    if (!voxels || this.#down === null || moved > TAP || button) return;
    const { left, top } = canvas.getBoundingClientRect();
    projection.aim();
    this.onpick(voxels.slotAt(clientX - left - projection.width / 2, projection.height / 2 - (clientY - top), NEAR[pointerType] ?? NEAR.mouse, projection));
  };
}
