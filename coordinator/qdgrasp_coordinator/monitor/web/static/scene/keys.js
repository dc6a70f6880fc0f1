// Keys: all that mouse and fingers do with the view.

const TURN = Math.PI / 24;
const SHIFT = 24; // px

/** What a key does to a view; false where it is none of these. */
export function press(view, { key, shiftKey, ctrlKey, altKey, metaKey }) {
  if (ctrlKey || altKey || metaKey) return false;
  const action = ACTIONS[`${shiftKey && key.startsWith("Arrow") ? "Shift+" : ""}${key}`];
  if (!action) return false;
  action(view);
  return true;
}

const turn = (left, up) => ({ stage }) => {
  if (left) stage.controls.rotateLeft(left * TURN);
  if (up) stage.controls.rotateUp(up * TURN);
  stage.touched = true;
  stage.moved();
};
const shift = (x, y) => ({ stage }) => {
  stage.controls.pan(x * SHIFT, y * SHIFT);
  stage.touched = true;
  stage.moved();
};
const zoom = (factor) => ({ stage }) => {
  stage.controls.dollyIn(1 / factor);
  stage.touched = true;
  stage.moved();
};

const ACTIONS = {
  ArrowLeft: turn(1, 0), ArrowRight: turn(-1, 0), ArrowUp: turn(0, 1), ArrowDown: turn(0, -1),
  "Shift+ArrowLeft": shift(1, 0), "Shift+ArrowRight": shift(-1, 0), "Shift+ArrowUp": shift(0, 1), "Shift+ArrowDown": shift(0, -1),
  "+": zoom(1.2), "=": zoom(1.2), "-": zoom(1 / 1.2),
  n: (view) => view.step(1), p: (view) => view.step(-1),
  Escape: (view) => view.select(null),
  Home: (view) => view.home(), 0: (view) => view.home(),
  c: (view) => (view.cut = !view.cut),
  f: (view) => (view.framed = !view.framed),
};
