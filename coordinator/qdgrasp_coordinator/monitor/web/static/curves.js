// Curves: what was found over evaluations, and how fast. Asked for now and then; the newest point is in the state.

import { Plot } from "./plot.js";
import { rate } from "./words.js";

const SECONDS = 5; // between two questions for curves
const MOST_LINES = 32; // runs that are drawn side by side
const FOUND = [
  { name: "Successes", colour: "faint" },
  { name: "Cells", colour: "accent", width: 2, fill: "wash" },
  { name: "Robust", colour: "ink", dash: [5, 4] },
];
const SPEED = [{ name: "Evaluations/s", colour: "accent", width: 1.5, fill: "wash" }];

export class Curves {
  constructor(find, api) {
    this.api = api;
    this.found = new Plot(find("found"), find("found-legend"));
    this.speed = new Plot(find("speed"), find("speed-legend"), { timed: true, up: (number) => (number < 10 ? rate(number) : rate(Math.round(number))) });
    this.title = find("found-title");
    this.job = "";
    this.asked = -Infinity;
    this.curves = null;
  }

  show(job, run, now) {
    this.#ask(job.job);
    const curves = this.job === job.job && this.curves;
    if (!curves) return;
    this.#found(job, run ?? (job.figures.runs < 2 ? job.runs[0] : null), curves);
    this.#speed(job, run, curves, now);
  }

  async #ask(job) {
    const changed = this.job !== job;
    if (!changed && performance.now() < this.asked + 1000 * SECONDS) return;
    if (changed) this.curves = null;
    this.job = job;
    this.asked = performance.now();
    try {
      const answer = await fetch(`${this.api}/jobs/${encodeURIComponent(job)}/curves`);
      if (answer.ok && this.job === job) this.curves = await answer.json();
    } catch {
      // the link says that the monitor is away; it is asked again
    }
  }

  #found(job, run, { curves }) {
    if (run) this.found.show(FOUND, oneRun(curves[run.run]?.points ?? [], run));
    else this.found.show(...allRuns(job.runs.slice(-MOST_LINES), curves));
  }

  #speed(job, run, { history, histories }, now) {
    const { at, rate: speeds } = run ? (histories[run.run] ?? { at: [], rate: [] }) : history;
    const latest = run ? job.speeds[run.run] : job.speed;
    const goes = job.state === "running" && !run?.finished;
    this.speed.show(SPEED, goes ? [[...at, Math.max(now, at.at(-1) ?? 0)], [...speeds, latest]] : [at, speeds]);
  }
}

function oneRun(points, { evaluations, successes, cells, robust }) {
  const known = points.filter(([done]) => done < evaluations);
  const rows = [[0, 0, 0, 0, 0], ...known, [evaluations, 0, successes, cells, robust]];
  return [0, 2, 3, 4].map((column) => rows.map((row) => row[column]));
}

/** The cells of each run as a line of its own. */
function allRuns(runs, curves) {
  const series = runs.map(({ run }) => ({ name: run, colour: "accent", width: 1, quiet: true }));
  const tables = runs.map((run) => {
    const [done, , cells] = oneRun(curves[run.run]?.points ?? [], run);
    return [done, cells];
  });
  return [series, tables.length ? uPlot.join(tables) : [[]]];
}
