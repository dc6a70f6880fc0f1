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
    /** The greatest penetration and motion [m], infinite: any; the least number of finger links and the least margin, 0: any.
     *  A motion or a margin that is not known passes no bound. */
    this.penetration = Infinity;
    this.motion = Infinity;
    this.contacts = 0;
    this.margin = 0;
    /** Whether those alone are shown that hold in all engines. */
    this.all = false;
    /** The synergy by its place in the gripper; `ANY`: all. */
    this.synergy = ANY;
    /** The box of cells that are shown, both ends in it. */
    this.low = [-Infinity, -Infinity, -Infinity];
    this.high = [Infinity, Infinity, Infinity];
  }

  /** Whether a grasp is shown. */
  passes({ kind, eta, synergy, penetration, motion, contacts, margin, inAll }) {
    return this.kinds[kind] && (!this.all || inAll) && (!this.eta || eta >= this.eta) && (this.synergy === ANY || synergy === this.synergy)
      && penetration <= this.penetration && (this.motion === Infinity || motion <= this.motion)
      && contacts >= this.contacts && (!this.margin || margin >= this.margin);
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
    const bounds = [this.eta > 0, this.synergy !== ANY, this.penetration < Infinity, this.motion < Infinity, this.contacts > 0, this.margin > 0, this.all];
    return bounds.filter(Boolean).length + sides.length;
  }
}

const FIRST = 4096; // cells that there is room for at first
const NONE = -1;

/** The successes of a run by cell, and the one that each cell shows. */
export class Cells {
  #slots = new Map(); // of cells
  #firsts = new Int32Array(0); // the first grasp in each slot
  #known = new Map(); // the place of each grasp in what follows, by its number
  #numbers = new Uint32Array(0); // of each grasp, as are the following
  #etas = new Float32Array(0);
  #kinds = new Int8Array(0);
  #synergies = new Int16Array(0);
  #penetrations = new Float32Array(0);
  #motions = new Float32Array(0);
  #contacts = new Uint8Array(0);
  #margins = new Float32Array(0);
  #inAll = new Uint8Array(0);
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
    /** Whether the motion of any grasp is known, and thus its margin can be. */
    this.hasMotions = false;
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

  /** Of how many grasps the margin is `known`, and of how many it is `possible`: of those whose motion is. */
  get margins() {
    const known = (values) => values.subarray(0, this.#known.size).reduce((sum, value) => sum + !Number.isNaN(value), 0);
    return { known: known(this.#margins), possible: known(this.#motions) };
  }

  /** Whether margins are filtered by that are not all known. */
  get lacksMargins() {
    return this.filter.margin > 0 && this.margins.known < this.margins.possible;
  }

  /** Add a page of successes; gives the slots, in order, that show another grasp now. */
  update(page) {
    const { n, cells } = page, grasps = this.#known.size;
    const changed = new Set();
    if (this.size + n > this.#firsts.length) this.#makeRoom(room(this.size + n));
    if (grasps + n > this.#numbers.length) this.#makeGrasps(room(grasps + n));
    for (let i = 0; i < n; i++) {
      const slot = this.#slot(cells[3 * i], cells[3 * i + 1], cells[3 * i + 2]);
      this.#put(slot, page, i);
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

  /** The few best of what is shown, the best first: number, kind and penetration [m] of each. */
  best(most) {
    const found = []; // a hundred thousand are not sorted for it
    for (const grasp of this.#best.subarray(0, this.size)) {
      if (grasp === NONE || (found.length === most && this.#compare(grasp, found.at(-1)) > 0)) continue;
      const place = found.findIndex((other) => this.#compare(grasp, other) < 0);
      found.splice(place < 0 ? found.length : place, 0, grasp);
      if (found.length > most) found.pop();
    }
    return found.map((grasp) => ({ number: this.#numbers[grasp], kind: this.#kinds[grasp], penetration: this.#penetrations[grasp] }));
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
        if (filter.passes(this.#grasp(grasp)) && (best === NONE || this.#compare(grasp, best) < 0)) best = grasp;
      }
    }
    const kind = best === NONE ? NONE : this.#kinds[best];
    this.#best[slot] = best;
    places[place + 3] = kind;
    if (before >= 0) this.counts[before] -= 1;
    if (kind >= 0) this.counts[kind] += 1;
    return kind !== before || this.number(slot) !== number;
  }

  /** A grasp as the filter sees it. */
  #grasp(place) {
    return {
      kind: this.#kinds[place], eta: this.#etas[place], synergy: this.#synergies[place], penetration: this.#penetrations[place],
      motion: this.#motions[place], contacts: this.#contacts[place], margin: this.#margins[place], inAll: this.#inAll[place],
    };
  }

  /** Take grasp `i` of a page into a slot; one that comes again stays there. */
  #put(slot, page, i) {
    const number = page.numbers[i];
    let grasp = this.#known.get(number);
    if (grasp === undefined) {
      grasp = this.#known.size;
      this.#known.set(number, grasp);
      this.#nexts[grasp] = this.#firsts[slot];
      this.#firsts[slot] = grasp;
    }
    this.#numbers[grasp] = number;
    this.#kinds[grasp] = page.outcomes[i] - this.worst;
    this.#etas[grasp] = page.etas[i];
    this.#synergies[grasp] = page.synergies[i];
    this.#penetrations[grasp] = page.penetrations[i];
    this.#motions[grasp] = page.motions[i];
    this.#contacts[grasp] = page.contacts[i];
    this.#margins[grasp] = page.margins[i];
    this.#inAll[grasp] = page.inAll[i];
    this.hasMotions ||= !Number.isNaN(page.motions[i]);
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
    this.#penetrations = grown(this.#penetrations, grasps);
    this.#motions = grown(this.#motions, grasps);
    this.#contacts = grown(this.#contacts, grasps);
    this.#margins = grown(this.#margins, grasps);
    this.#inAll = grown(this.#inAll, grasps);
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
