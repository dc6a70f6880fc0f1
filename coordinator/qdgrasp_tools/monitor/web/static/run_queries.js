// Queries for what only the recorder knows: runs that ended before the monitor started, and their curves.

/** The JSON at an address; null where there is no answer: the connection's status shows that the monitor is away. */
export async function fetchJson(address) {
  try {
    const answer = await fetch(address);
    return answer.ok ? await answer.json() : null;
  } catch {
    return null;
  }
}

const SECONDS = 15; // between two queries for the same
const MOST = 64; // curves that are kept
export const MANY = 256; // runs of a job: of more, those that have ended are shown object by object

/** All runs of a job, also those that ended before the monitor started. */
export class RecordedRuns {
  #known = new Map(); // of each job: { asked, done, runs }

  /** `onnews()` is called when more runs are known. */
  constructor(api, onnews) {
    this.api = api;
    this.onnews = onnews;
  }

  /**
   * The runs of a job, or of one of its objects: those whose status is published, and before them what the
   * recorder knew of the others. Of a job of many runs and no object: the published ones.
   */
  of(job, object = "") {
    const shown = object ? job.runs.filter((run) => run.object === object) : job.runs;
    if (!object && (job.figures.runs <= job.runs.length || job.figures.runs > MANY)) return shown;
    const address = `${this.api}/jobs/${encodeURIComponent(job.job)}/${object ? `objects/runs?${new URLSearchParams({ file: object })}` : "runs"}`;
    this.#query(address, job.figures.runs_done);
    const published = new Set(shown.map(({ run }) => run));
    return [...this.#known.get(address).runs.filter(({ run }) => !published.has(run)), ...shown];
  }

  async #query(address, done) {
    const known = this.#known.get(address) ?? { asked: -Infinity, done: -1, runs: [] };
    const since = performance.now() - known.asked;
    if (since < 1000 || (since < 1000 * SECONDS && known.done === done)) return;
    this.#known.set(address, { ...known, asked: performance.now(), done });
    if (this.#known.size > MOST) this.#known.delete(this.#known.keys().next().value);
    const answer = await fetchJson(address);
    if (!answer) return; // no recorder, or a finished one: the published ones are shown
    const { runs, uncounted } = answer;
    Object.assign(this.#known.get(address) ?? {}, { runs }, uncounted ? { done: -1 } : {}); // uncounted ones: ask again soon
    this.onnews();
  }
}

/** Curves of runs that were over before the monitor started. */
export class RecordedCurves {
  #known = new Map(); // of each run, by its address: { asked, points }

  constructor(api) {
    this.api = api;
  }

  /** The points of a run's curve; empty until the answer comes, and where there is none. */
  of(job, run) {
    const address = `${this.api}/jobs/${encodeURIComponent(job)}/runs/${encodeURIComponent(run)}/curve`;
    this.#query(address);
    return this.#known.get(address).points;
  }

  async #query(address) {
    const known = this.#known.get(address);
    if (known && (known.points.length || performance.now() < known.asked + 1000 * SECONDS)) return;
    const curve = { asked: performance.now(), points: [] };
    this.#known.set(address, curve);
    if (this.#known.size > MOST) this.#known.delete(this.#known.keys().next().value);
    curve.points = (await fetchJson(address))?.points ?? [];
  }
}
