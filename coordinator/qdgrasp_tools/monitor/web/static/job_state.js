// The selected job and run, and what follows from a job's figures: its extent, and whether it is over.

/** The selected job and run, kept in the address, so that it can be shared and gone back to. */
export class Selection {
  constructor(onchange) {
    addEventListener("hashchange", () => onchange());
  }

  get job() {
    return this.#read("job");
  }

  /** The run; empty: all of them. */
  get run() {
    return this.#read("run");
  }

  /** The object whose runs are shown, as specs name it; empty: those of all. */
  get object() {
    return this.#read("object");
  }

  #read(name) {
    return new URLSearchParams(location.hash.slice(1)).get(name) ?? "";
  }

  static address(job, run = "", object = "") {
    const named = Object.entries({ run, object }).filter(([, value]) => value);
    return `#${new URLSearchParams([["job", job], ...named])}`;
  }
}

const FILTERS = ["eta", "synergy", "penetration", "motion", "contacts"];

/** The filters in the address, numbers by their names: those in use. */
export function addressFilters() {
  const kept = new URLSearchParams(location.hash.slice(1));
  const found = FILTERS.map((name) => [name, Number(kept.get(name) ?? NaN)]);
  return Object.fromEntries(found.filter(([, value]) => value >= 0 && value < Infinity));
}

/** Keep filters in the address; one that is not a number there is in use no more. */
export function keepFilters(filter) {
  const kept = new URLSearchParams(location.hash.slice(1));
  for (const name of FILTERS) {
    if (Number.isFinite(filter[name])) kept.set(name, filter[name]);
    else kept.delete(name);
  }
  history.replaceState(history.state, "", kept.size ? `#${kept}` : location.pathname + location.search);
}

/** The name of an object without folder and ending, of one that a spec names by its file. */
export function shortName(object) {
  return object.replace(/^.*\//, "").replace(/\.\w+$/, "");
}

/** States of jobs that are over. */
export const OVER = ["gone", "ended", "cancelled"];

/** A job as it is shown: ended as soon as all its runs are, though its coordinator may still publish. */
export function withEndedState(job) {
  const { runs, runs_done: done, runs_failed: failed } = job.figures;
  return runs && done + failed >= runs ? { ...job, state: "ended" } : job;
}

/** The counted evaluations that a job or run will have at most; at least 1. */
export function extentOf({ evaluations, budget, remaining, finished }) {
  const left = remaining ?? (finished ? 0 : Math.max(0, budget - evaluations));
  return Math.max(1, evaluations + left);
}
