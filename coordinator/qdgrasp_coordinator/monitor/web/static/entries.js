// Entries: the runs of a job, those that ended before anybody watched among them; the recorder knows them.

const SECONDS = 15; // between two questions

export class Entries {
  #known = new Map(); // of each job: { asked, done, runs }

  /** `onnews()` is called when more runs are known. */
  constructor(api, onnews) {
    this.api = api;
    this.onnews = onnews;
  }

  /** The runs of a job, as they are now where somebody hears them. */
  of(job) {
    if (job.figures.runs <= job.runs.length) return job.runs;
    this.#ask(job);
    const heard = new Set(job.runs.map(({ run }) => run));
    return [...(this.#known.get(job.job)?.runs ?? []).filter(({ run }) => !heard.has(run)), ...job.runs];
  }

  async #ask({ job, figures: { runs_done: done } }) {
    const known = this.#known.get(job) ?? { asked: -Infinity, done: -1, runs: [] };
    const since = performance.now() - known.asked;
    if (since < 1000 || (since < 1000 * SECONDS && known.done === done)) return;
    this.#known.set(job, { ...known, asked: performance.now(), done });
    try {
      const answer = await fetch(`${this.api}/jobs/${encodeURIComponent(job)}/runs`);
      if (!answer.ok) return; // no recorder, or a finished one: those that are heard of are shown
      const { runs, uncounted } = await answer.json();
      Object.assign(this.#known.get(job), { runs }, uncounted ? { done: -1 } : {}); // those: soon
      this.onnews();
    } catch {
      // the link says that the monitor is away
    }
  }
}
