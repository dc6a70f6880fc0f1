// The filter: which grasps are shown. Of each cell the best grasp that passes is, if there is one.

export const ANY = null;

export class Filter {
  /** @param kinds how many kinds of grasps there are */
  constructor(kinds) {
    /** A flag for each kind: whether it is shown. */
    this.kinds = Array(kinds).fill(true);
    /** The least eta; 0 lets pass what has none, too. */
    this.eta = 0;
    /** The synergy by its place in the gripper; `ANY`: all. */
    this.synergy = ANY;
    /** The box of cells that are shown, both ends in it. */
    this.low = [-Infinity, -Infinity, -Infinity];
    this.high = [Infinity, Infinity, Infinity];
  }

  /** Whether a grasp is shown. */
  passes(kind, eta, synergy) {
    return this.kinds[kind] && (!this.eta || eta >= this.eta) && (this.synergy === ANY || synergy === this.synergy);
  }

  /** Whether a cell is in the box. */
  holds(x, y, z) {
    const { low, high } = this;
    return x >= low[0] && x <= high[0] && y >= low[1] && y <= high[1] && z >= low[2] && z <= high[2];
  }

  /** Whether there are cells that are not in the box. */
  get isBoxed() {
    return this.low.some(Number.isFinite) || this.high.some(Number.isFinite);
  }

  /** How many ways there are in which it leaves something out, the kinds apart. */
  get narrowed() {
    const sides = [0, 1, 2].filter((axis) => Number.isFinite(this.low[axis]) || Number.isFinite(this.high[axis]));
    return Number(this.eta > 0) + Number(this.synergy !== ANY) + sides.length;
  }
}
