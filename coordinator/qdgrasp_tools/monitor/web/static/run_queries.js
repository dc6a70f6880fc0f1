// Queries for what only the recorder knows: runs that ended before the monitor started, and curves.

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
const CURVE_SECONDS = 5; // between two queries for the same curve
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

/** Curves of runs from their beginnings, and of jobs while the monitor watched. */
export class RecordedCurves {
  #known = new Map(); // of each address: { asked, answer }

  constructor(api) {
    this.api = api;
  }

  /** The curve of a run; null until the answer comes, and where there is none. */
  of(job, { run, finished }) {
    const known = this.#latest(`${this.api}/jobs/${encodeURIComponent(job)}/runs/${encodeURIComponent(run)}/curve`, finished ? Infinity : CURVE_SECONDS);
    return known?.points.length ? known : null;
  }

  /** Figures of a job over time; null until the answer comes. */
  history(job) {
    return this.#latest(`${this.api}/jobs/${encodeURIComponent(job)}/history`, CURVE_SECONDS);
  }

  /** The last answer at an address, which is asked for anew after so many seconds, or where there was none. */
  #latest(address, seconds) {
    const known = this.#known.get(address) ?? { asked: -Infinity, answer: null };
    if (performance.now() > known.asked + 1000 * (known.answer ? seconds : CURVE_SECONDS)) {
      known.asked = performance.now();
      this.#known.set(address, known);
      if (this.#known.size > MOST) this.#known.delete(this.#known.keys().next().value);
      fetchJson(address).then((answer) => (known.answer = answer ?? known.answer));
    }
    return known.answer;
  }
}
