// The server's data of a run in 3D: its scene, pages of voxels that are polled, and single grasps.

/** Requests for one run's data. */
export class RunClient {
  #ended = new AbortController();

  constructor(api, job, run) {
    this.root = `${api}/jobs/${encodeURIComponent(job)}/runs/${encodeURIComponent(run)}`;
  }

  async scene() {
    return (await this.#get("scene")).json();
  }

  /** Voxels from a serial on. */
  async cells(from) {
    return readVoxelPage(await (await this.#get(`cells?from=${from}`)).arrayBuffer());
  }

  async grasp(number) {
    return (await this.#get(`grasps/${number}`)).json();
  }

  /** Ask for nothing more; what is under way ends with an `AbortError`. */
  end() {
    this.#ended.abort();
  }

  async #get(path) {
    const answer = await fetch(`${this.root}/${path}`, { signal: this.#ended.signal }).catch(unreachable);
    if (answer.ok) return answer;
    const said = await answer.json().catch(() => ({}));
    throw new Error(said.error ?? `The server answered with ${answer.status}.`);
  }
}

/** Throw what a failed fetch means. */
function unreachable(error) {
  throw error.name === "AbortError" ? error : new Error("Nobody answers: the page's server has ended, or cannot be reached.");
}

const MARK = 0x34474451; // "QDG4"
const HEADER = 24; // bytes
/** Columns of a page, in their order: the type of their items, and how many of them a voxel has. */
const COLUMNS = {
  numbers: [Uint32Array, 1], etas: [Float32Array, 1], penetrations: [Float32Array, 1], motions: [Float32Array, 1],
  cells: [Int16Array, 3], synergies: [Int16Array, 1], outcomes: [Uint8Array, 1], contacts: [Uint8Array, 1],
};
const WIDTH = 26; // bytes of each voxel

/** Unpack a page of voxels, little-endian as the server packs it: `n` voxels with journal numbers, etas (-1: none), penetrations
 *  [m], motions [m] (NaN: not known), cells (three each), synergies (-1: none), outcomes and finger links in contact; the serial
 *  to ask from `next`, whether there is `more` at once, and the `origin` of all of it. */
function readVoxelPage(buffer) {
  const [mark, n, next, more, total, origin] = buffer.byteLength < HEADER ? [] : new Uint32Array(buffer, 0, 6);
  if (mark !== MARK || buffer.byteLength !== HEADER + WIDTH * n) throw new Error("What came is not a page of voxels.");
  const page = { n, next, more: Boolean(more), total, origin };
  let start = HEADER;
  for (const [name, [Items, each]] of Object.entries(COLUMNS)) {
    page[name] = new Items(buffer, start, each * n);
    start += page[name].byteLength;
  }
  return page;
}

const POLL = 1000; // ms between queries for new successes
const LONGEST = 10000; // ms at most between them while there is no answer

/** Reads the successes of a run page by page, and polls for new ones. */
export class CellUpdates {
  #from = 0;
  #timer = 0;
  #wait = POLL;
  #stopped = false;

  /** `onpage(page, isFirst)` with each page; `onother()` where the journal is another one now, which is awaited;
   *  `onfail(error)` where there is no answer. */
  constructor(client, { onpage, onother, onfail }) {
    Object.assign(this, { client, onpage, onother, onfail });
  }

  /** Read all successes of the scene with this origin, and from then on new ones. */
  async begin(origin) {
    this.origin = origin;
    this.#from = 0;
    await this.#read(true);
    this.#schedule(POLL);
  }

  stop() {
    this.#stopped = true;
    clearTimeout(this.#timer);
  }

  /** Read what is new, and schedule the next query. */
  async #poll() {
    try {
      if (!document.hidden) await this.#read(false);
      this.#wait = POLL;
    } catch (error) {
      this.#wait = Math.min(2 * this.#wait, LONGEST);
      this.onfail(error);
    }
    this.#schedule(this.#wait);
  }

  #schedule(wait) {
    clearTimeout(this.#timer);
    if (!this.#stopped) this.#timer = setTimeout(() => this.#poll(), wait);
  }

  /** Read all pages that there are. */
  async #read(isFirst) {
    for (;;) {
      const page = await this.client.cells(this.#from);
      if (page.origin !== this.origin) return this.onother();
      this.#from = page.next;
      this.onpage(page, isFirst);
      if (!page.more || !page.n) return;
    }
  }
}
