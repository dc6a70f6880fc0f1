// The pace: how finely the view is drawn while it moves, so that it stays fluid, also without a graphics card.

/** From fine to coarse: pixels drawn per pixel of the page along each side, whether voxels are plain squares, and
 *  the share of them that is drawn, those found first. */
const LEVELS = [
  { scale: 1, plain: false, share: 1 },
  { scale: 0.7, plain: false, share: 1 },
  { scale: 0.5, plain: false, share: 1 },
  { scale: 0.5, plain: true, share: 1 },
  { scale: 0.5, plain: true, share: 0.5 },
  { scale: 0.4, plain: true, share: 0.25 },
];
const SLOW = 40; // ms: a frame that takes longer is drawn more coarsely next time
const AWFUL = 120; // ms: that, and it is drawn much more coarsely
const QUICK = 12; // ms: below it, more finely
const SETTLED = 3; // frames at one level before it is judged
const STALLED = 250; // ms: a frame that is later was held up by something else, and counts as this

export class Pace {
  #level = 0;
  #frames = 0;
  #mean = 0;

  get level() {
    return LEVELS[this.#level];
  }

  /** How finely it is drawn, to be read by whoever measures. */
  get words() {
    const { scale, plain, share } = this.level;
    return `${100 * scale} % of the pixels along each side, ${plain ? "squares" : "cubes"}, ${100 * share} % of the cells`;
  }

  get finest() {
    return !this.#level;
  }

  /** Tell how long a frame took [ms]; true where the level changed. */
  took(ms) {
    const counted = Math.min(ms, STALLED);
    this.#mean = this.#frames ? 0.6 * this.#mean + 0.4 * counted : counted;
    this.#frames += 1;
    if (this.#frames < SETTLED) return false;
    if (this.#mean > SLOW) return this.#go(Math.min(this.#level + (this.#mean > AWFUL ? 2 : 1), LEVELS.length - 1));
    return this.#mean < QUICK && this.#go(this.#level - 1);
  }

  #go(level) {
    const changed = level in LEVELS && level !== this.#level;
    if (changed) this.#level = level;
    this.#frames = 0;
    return changed;
  }
}
