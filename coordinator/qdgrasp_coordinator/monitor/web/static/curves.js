// Curves: what was found over evaluations, and how fast. Asked for now and then; the newest point is in the state.

import { Growth } from "./growth.js";
import { Plot } from "./plot.js";
import { count, rate } from "./words.js";

const SECONDS = 5; // between two questions for curves
const MOST_LINES = 32; // runs that are drawn side by side
const CELLS = [{ name: "Cells", colour: "accent", width: 2, fill: "wash" }];
const SUCCESSES = [
  { name: "Successes", colour: "faint" },
  { name: "Robust", colour: "ink", dash: [5, 4] },
];
const SPEED = [{ name: "Evaluations/s", colour: "accent", fill: "wash" }];

export class Curves {
  constructor(find, api) {
    this.api = api;
    const plot = (name, looks) => new Plot(find(name), find(`${name}-legend`), looks);
    this.cells = plot("cells");
    this.successes = plot("successes");
    this.speed = plot("speed", { timed: true, up: speed, whole: false });
    this.growth = new Growth(api);
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
    const runs = run ? [run] : job.runs.slice(-MOST_LINES);
    const courses = runs.map((one) => course(this.#points(job, one, curves), one));
    const [done, cells, successes, robust] = run ? courses[0] : [];
    this.cells.show(...(run ? [CELLS, [done, cells]] : beside("Cells", runs, courses, 1)));
    this.successes.show(...(run ? [SUCCESSES, [done, successes, robust]] : beside("Successes", runs, courses, 2)));
  }

  /** Those that were heard; or of a run that was not, and is over, those that were recorded. */
  #points(job, { run, finished }, curves) {
    const heard = curves[run]?.points ?? [];
    return finished && heard.length < 2 ? this.growth.of(job.job, run) : heard;
  }

  #speed(job, run, { history, histories }, now) {
    const { at, rate: speeds } = run ? (histories[run.run] ?? { at: [], rate: [] }) : history;
    const latest = run ? job.speeds[run.run] : job.speed;
    const goes = job.state === "running" && !run?.finished && now > (at.at(-1) ?? 0);
    this.speed.show(SPEED, goes ? [[...at, now], [...speeds, latest]] : [at, speeds]);
  }
}

function speed(number) {
  return Number.isInteger(number) ? count(number) : rate(number);
}

/** Evaluations, cells, successes and robust ones of a run from its beginning until now. */
function course(points, { evaluations, successes, cells, robust }) {
  const known = points.filter(([done]) => done < evaluations);
  const rows = [[0, 0, 0, 0, 0], ...known, [evaluations, 0, successes, cells, robust]];
  return [0, 3, 2, 4].map((column) => rows.map((row) => row[column]));
}

/** One column of several courses, each as a line that is named when a cursor is near. */
function beside(what, runs, courses, column) {
  const series = runs.map(({ run }) => ({ name: `${what} of ${run}`, colour: "accent", width: 1, many: what }));
  return [series, courses.length ? uPlot.join(courses.map((each) => [each[0], each[column]])) : [[]]];
}
