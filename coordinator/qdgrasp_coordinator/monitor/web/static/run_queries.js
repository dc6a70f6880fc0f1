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

/** All runs of a job, also those that ended before the monitor started. */
export class RecordedRuns {
  #known = new Map(); // of each job: { asked, done, runs }

  /** `onnews()` is called when more runs are known. */
  constructor(api, onnews) {
    this.api = api;
    this.onnews = onnews;
  }

  /** The runs of a job: those whose status is published, and before them what the recorder knew of the others. */
  of(job) {
    if (job.figures.runs <= job.runs.length) return job.runs;
    this.#query(job);
    const published = new Set(job.runs.map(({ run }) => run));
    return [...(this.#known.get(job.job)?.runs ?? []).filter(({ run }) => !published.has(run)), ...job.runs];
  }

  async #query({ job, figures: { runs_done: done } }) {
    const known = this.#known.get(job) ?? { asked: -Infinity, done: -1, runs: [] };
    const since = performance.now() - known.asked;
    if (since < 1000 || (since < 1000 * SECONDS && known.done === done)) return;
    this.#known.set(job, { ...known, asked: performance.now(), done });
    const answer = await fetchJson(`${this.api}/jobs/${encodeURIComponent(job)}/runs`);
    if (!answer) return; // no recorder, or a finished one: the published ones are shown
    const { runs, uncounted } = answer;
    Object.assign(this.#known.get(job), { runs }, uncounted ? { done: -1 } : {}); // uncounted ones: ask again soon
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
