// The best grasp of every kind and synergy in each cell, and the best of those that the filter lets pass.

export const ANY = null;

/** The filter of grasps: each cell shows the best of its grasps that pass. */
export class CellFilter {
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

  /** The number of criteria in use, the kinds apart. */
  get narrowed() {
    const sides = [0, 1, 2].filter((axis) => Number.isFinite(this.low[axis]) || Number.isFinite(this.high[axis]));
    return Number(this.eta > 0) + Number(this.synergy !== ANY) + sides.length;
  }
}

const FIRST = 4096; // cells that there is room for at first
const NONE = -1;

/** The successes of a run by cell, and the one that each cell shows. */
export class Cells {
  #slots = new Map(); // of cells
  #firsts = new Int32Array(0); // the first grasp in each slot
  #grasps = 0;
  #numbers = new Uint32Array(0); // of each grasp, as are the following
  #etas = new Float32Array(0);
  #kinds = new Int8Array(0);
  #synergies = new Int16Array(0);
  #nexts = new Int32Array(0); // the next grasp in the same slot
  #best = new Int32Array(0); // the grasp that is shown in each slot

  /** @param kinds the scene's kinds of success, from worst to best */
  constructor(kinds) {
    this.worst = kinds[0].outcome;
    this.filter = new CellFilter(kinds.length);
    /** Of each slot its cell, and the kind that is shown there; -1 where nothing is. */
    this.places = new Int16Array(0);
    /** How many cells show each kind. */
    this.counts = kinds.map(() => 0);
    this.low = [Infinity, Infinity, Infinity];
    this.high = [-Infinity, -Infinity, -Infinity];
    this.#makeRoom(FIRST);
    this.#makeGrasps(FIRST);
  }

  /** How many there are. */
  get size() {
    return this.#slots.size;
  }

  /** How many of them show something. */
  get shown() {
    return this.counts.reduce((sum, count) => sum + count, 0);
  }

  /** Add a page of successes; gives the slots, in order, that show another grasp now. */
  update({ n, numbers, etas, cells, synergies, outcomes }) {
    const changed = new Set();
    if (this.size + n > this.#firsts.length) this.#makeRoom(room(this.size + n));
    if (this.#grasps + n > this.#numbers.length) this.#makeGrasps(room(this.#grasps + n));
    for (let i = 0; i < n; i++) {
      const slot = this.#slot(cells[3 * i], cells[3 * i + 1], cells[3 * i + 2]);
      this.#put(slot, outcomes[i] - this.worst, synergies[i], numbers[i], etas[i]);
      changed.add(slot);
    }
    return Uint32Array.from(changed).sort().filter((slot) => this.#choose(slot));
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
    return this.#best[slot] === NONE ? null : this.#numbers[this.#best[slot]];
  }

  /** The slot that shows a grasp; -1 where none does. */
  slotOf(number) {
    for (let slot = 0; slot < this.size; slot++) if (this.number(slot) === number) return slot;
    return NONE;
  }

  /** Journal numbers of what is shown, the best first. */
  order() {
    const slots = Array.from({ length: this.size }, (_, slot) => slot).filter((slot) => this.#best[slot] !== NONE);
    return slots.map((slot) => this.#best[slot]).sort((a, b) => this.#compare(a, b)).map((grasp) => this.#numbers[grasp]);
  }

  /** Whether one grasp comes before another: by kind, then by eta, then by when it was found. */
  #compare(a, b) {
    return this.#kinds[b] - this.#kinds[a] || this.#etas[b] - this.#etas[a] || this.#numbers[a] - this.#numbers[b];
  }

  /** Choose what a slot shows; true where that is another grasp than before, or one of another kind. */
  #choose(slot) {
    const { filter, places } = this, place = 4 * slot, before = this.kind(slot), number = this.number(slot);
    let best = NONE;
    if (filter.holds(places[place], places[place + 1], places[place + 2])) {
      for (let grasp = this.#firsts[slot]; grasp !== NONE; grasp = this.#nexts[grasp]) {
        const passes = filter.passes(this.#kinds[grasp], this.#etas[grasp], this.#synergies[grasp]);
        if (passes && (best === NONE || this.#compare(grasp, best) < 0)) best = grasp;
      }
    }
    const kind = best === NONE ? NONE : this.#kinds[best];
    this.#best[slot] = best;
    places[place + 3] = kind;
    if (before >= 0) this.counts[before] -= 1;
    if (kind >= 0) this.counts[kind] += 1;
    return kind !== before || this.number(slot) !== number;
  }

  /** Set the grasp of a slot, kind and synergy. */
  #put(slot, kind, synergy, number, eta) {
    let grasp = this.#firsts[slot];
    while (grasp !== NONE && (this.#kinds[grasp] !== kind || this.#synergies[grasp] !== synergy)) grasp = this.#nexts[grasp];
    if (grasp === NONE) {
      grasp = this.#grasps++;
      this.#kinds[grasp] = kind;
      this.#synergies[grasp] = synergy;
      this.#nexts[grasp] = this.#firsts[slot];
      this.#firsts[slot] = grasp;
    }
    this.#numbers[grasp] = number;
    this.#etas[grasp] = eta;
  }

  #slot(...cell) {
    const key = ((cell[0] + 32768) * 65536 + cell[1] + 32768) * 65536 + cell[2] + 32768;
    const known = this.#slots.get(key);
    if (known !== undefined) return known;
    const slot = this.#slots.size;
    this.#slots.set(key, slot);
    this.places.set([...cell, NONE], 4 * slot);
    this.#firsts[slot] = this.#best[slot] = NONE;
    for (const axis of [0, 1, 2]) {
      this.low[axis] = Math.min(this.low[axis], cell[axis]);
      this.high[axis] = Math.max(this.high[axis], cell[axis]);
    }
    return slot;
  }

  #makeRoom(slots) {
    this.places = grown(this.places, 4 * slots);
    this.#firsts = grown(this.#firsts, slots);
    this.#best = grown(this.#best, slots);
  }

  #makeGrasps(grasps) {
    this.#numbers = grown(this.#numbers, grasps);
    this.#etas = grown(this.#etas, grasps);
    this.#kinds = grown(this.#kinds, grasps);
    this.#synergies = grown(this.#synergies, grasps);
    this.#nexts = grown(this.#nexts, grasps);
  }
}

function room(count) {
  return 2 ** Math.ceil(Math.log2(count));
}

function grown(array, length) {
  const larger = new array.constructor(length);
  larger.set(array);
  return larger;
}
