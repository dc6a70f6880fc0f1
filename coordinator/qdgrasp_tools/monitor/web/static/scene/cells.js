// The grasps in each cell, and the best of those that the filter lets pass.

export const ANY = null;

/** The filter of grasps: each cell shows the best of its grasps that pass. */
export class CellFilter {
  /** @param kinds how many kinds of grasps there are */
  constructor(kinds) {
    /** A flag for each kind: whether it is shown. */
    this.kinds = Array(kinds).fill(true);
    /** The least eta; 0 lets pass what has none, too. */
    this.eta = 0;
    /** The greatest penetration and motion [m], infinite: any; the least number of finger links, 0: any. A motion that is not
     *  known passes no bound. */
    this.penetration = Infinity;
    this.motion = Infinity;
    this.contacts = 0;
    /** The synergy by its place in the gripper; `ANY`: all. */
    this.synergy = ANY;
    /** The box of cells that are shown, both ends in it. */
    this.low = [-Infinity, -Infinity, -Infinity];
    this.high = [Infinity, Infinity, Infinity];
  }

  /** Whether a grasp is shown. */
  passes({ kind, eta, synergy, penetration, motion, contacts }) {
    return this.kinds[kind] && (!this.eta || eta >= this.eta) && (this.synergy === ANY || synergy === this.synergy)
      && penetration <= this.penetration && (this.motion === Infinity || motion <= this.motion)
      && contacts >= this.contacts;
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

  /** The number of criteria in use, the kinds apart. */
  get narrowed() {
    const sides = [0, 1, 2].filter((axis) => Number.isFinite(this.low[axis]) || Number.isFinite(this.high[axis]));
    const bounds = [this.eta > 0, this.synergy !== ANY, this.penetration < Infinity, this.motion < Infinity, this.contacts > 0];
    return bounds.filter(Boolean).length + sides.length;
  }
}

const NONE = -1;

/** The successes of a run by cell, and the one that each cell shows. */
export class Cells {
  #slots = new Map(); // of cells
  #grasps = []; // those in each slot
  #known = new Map(); // each grasp by its number
  #best = []; // the grasp that is shown in each slot; null: none

  /** @param kinds the scene's kinds of success, from worst to best */
  constructor(kinds) {
    this.worst = kinds[0].outcome;
    this.filter = new CellFilter(kinds.length);
    /** Of each slot its cell, and the kind that is shown there; -1 where nothing is. There is room for more slots. */
    this.places = new Int16Array(4 * 4096);
    /** How many cells show each kind. */
    this.counts = kinds.map(() => 0);
    /** Whether the motion of any grasp is known. */
    this.hasMotions = false;
    this.low = [Infinity, Infinity, Infinity];
    this.high = [-Infinity, -Infinity, -Infinity];
  }

  /** How many there are. */
  get size() {
    return this.#slots.size;
  }

  /** How many of them show something. */
  get shown() {
    return this.counts.reduce((sum, count) => sum + count, 0);
  }

  /** Add a page of successes. */
  update(page) {
    const changed = new Set();
    for (let i = 0; i < page.n; i++) {
      const slot = this.#slot(...page.cells.subarray(3 * i, 3 * i + 3));
      this.#put(slot, page, i);
      changed.add(slot);
    }
    for (const slot of changed) this.#choose(slot);
  }

  /** Choose again what is shown in each cell: the filter is another. */
  applyFilter() {
    for (let slot = 0; slot < this.size; slot++) this.#choose(slot);
  }

  cell(slot) {
    return this.places.subarray(4 * slot, 4 * slot + 3);
  }

  /** The kind that a slot shows; -1: none. */
  kind(slot) {
    return this.places[4 * slot + 3];
  }

  /** The journal number of the grasp that a slot shows; null: none. */
  number(slot) {
    return this.#best[slot]?.number ?? null;
  }

  /** The slot that shows a grasp; -1 where none does. */
  slotOf(number) {
    return this.#best.findIndex((grasp) => grasp?.number === number);
  }

  /** The grasps that are shown, at most so many, the best first: by kind, then by eta, then by when they were found. */
  best(most = Infinity) {
    const shown = this.#best.filter(Boolean).sort(compare);
    return shown.slice(0, most);
  }

  /** Choose what a slot shows. */
  #choose(slot) {
    const { filter, places } = this, before = this.kind(slot);
    let best = null;
    if (filter.holds(...this.cell(slot))) {
      for (const grasp of this.#grasps[slot]) if (filter.passes(grasp) && (!best || compare(grasp, best) < 0)) best = grasp;
    }
    this.#best[slot] = best;
    places[4 * slot + 3] = best ? best.kind : NONE;
    if (before >= 0) this.counts[before] -= 1;
    if (best) this.counts[best.kind] += 1;
  }

  /** Take grasp `i` of a page into a slot; one that comes again stays there. */
  #put(slot, page, i) {
    const grasp = {
      number: page.numbers[i], kind: page.outcomes[i] - this.worst, eta: page.etas[i], synergy: page.synergies[i],
      penetration: page.penetrations[i], motion: page.motions[i], contacts: page.contacts[i],
    };
    const known = this.#known.get(grasp.number);
    if (known) Object.assign(known, grasp);
    else this.#grasps[slot].push(grasp);
    if (!known) this.#known.set(grasp.number, grasp);
    this.hasMotions ||= !Number.isNaN(grasp.motion);
  }

  #slot(...cell) {
    const key = ((cell[0] + 32768) * 65536 + cell[1] + 32768) * 65536 + cell[2] + 32768;
    const known = this.#slots.get(key);
    if (known !== undefined) return known;
    const slot = this.#slots.size;
    this.#slots.set(key, slot);
    if (4 * slot >= this.places.length) {
      const larger = new Int16Array(2 * this.places.length);
      larger.set(this.places);
      this.places = larger;
    }
    this.places.set([...cell, NONE], 4 * slot);
    this.#grasps[slot] = [];
    this.#best[slot] = null;
    this.low = this.low.map((low, axis) => Math.min(low, cell[axis]));
    this.high = this.high.map((high, axis) => Math.max(high, cell[axis]));
    return slot;
  }
}

/** Whether one grasp comes before another. */
function compare(a, b) {
  return b.kind - a.kind || b.eta - a.eta || a.number - b.number;
}
