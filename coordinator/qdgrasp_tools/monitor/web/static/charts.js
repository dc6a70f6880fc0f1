// Curves of a job: cells, contact niches and successes over evaluations, and evaluations per second over time.

import { darkMode, element, setAttribute, setText, updateChildren } from "./dom.js";
import { count, rate, short, time } from "./format.js";
import { RecordedCurves } from "./run_queries.js";

/** A uPlot in the page's colours, with a legend in words that shows the values under the cursor. */
class Plot {
  #plot = null;
  #data = [[]];
  #shape = "";
  #isLine = false; // one point is no line
  #near = null; // the number of the line near the cursor

  /**
   * `across` and `up` say how numbers along the axes read; `timed`: across is a time in seconds since 1970;
   * `whole`: up are whole numbers.
   */
  constructor(root, legend, { timed = false, across = short, up = short, whole = true } = {}) {
    Object.assign(this, { root, legend, timed, across, up, whole });
    this.series = [];
    new ResizeObserver(() => this.#fit()).observe(root);
    darkMode.addEventListener("change", () => this.#draw());
  }

  /**
   * `series`: [{ name, colour, width?, dash?, fill?, many?, of? }], as many as columns in `data` but the first;
   * where there are `many` of one kind, the legend shows the one near the cursor; `of` is what all of them are of.
   */
  show(series, data) {
    this.#data = data;
    this.#isLine = data[0].at(-1) > data[0][0];
    const shape = JSON.stringify([this.#isLine, series]);
    this.series = series;
    setAttribute(this.root, "data-none", !this.#isLine);
    if (shape !== this.#shape) {
      this.#shape = shape;
      this.#draw();
    } else {
      this.#plot?.setData(data);
    }
    this.#writeLegend();
  }

  #draw() {
    this.#plot?.destroy();
    this.#plot = null;
    const { width, height } = this.root.getBoundingClientRect();
    if (!width || !this.#isLine) return;
    this.#plot = new uPlot(this.#options(width, height), this.#data, this.root);
  }

  #fit() {
    const { width, height } = this.root.getBoundingClientRect();
    if (this.#plot) this.#plot.setSize({ width, height });
    else this.#draw();
  }

  #options(width, height) {
    const style = getComputedStyle(document.documentElement);
    const colour = (name) => style.getPropertyValue(`--${name}`).trim();
    const axis = {
      stroke: colour("faint"),
      font: `12px ${style.fontFamily}`,
      grid: { stroke: colour("rule"), width: 1 },
      ticks: { show: false },
    };
    const x = { ...axis, gap: 6, size: 28, space: 72, grid: { show: false } };
    x.values = (_, places) => this.#across(places);
    return {
      width,
      height,
      padding: [10, 30, 0, 0],
      legend: { show: false },
      cursor: { y: false, points: { size: 6 }, focus: { prox: 24 }, drag: { x: false, y: false } },
      focus: { alpha: 0.3 },
      scales: { x: { time: this.timed }, y: { range: (_, low, high) => [0, high > 0 ? high * 1.06 : 1] } },
      axes: [x, { ...axis, gap: 6, size: 52, space: 36, values: (_, places) => places.map((place) => (this.whole && place % 1 ? "" : this.up(place))) }],
      series: [{}, ...this.series.map((each) => this.#line(each, colour))],
      hooks: {
        setCursor: [() => this.#writeLegend()],
        setSeries: [(_, number, { focus }) => (this.#near = focus ? number : null)],
      },
    };
  }

  #across(places) {
    const step = places.length > 1 ? places[1] - places[0] : places[0]; // of whole minutes seconds are left out
    return places.map((place) => {
      if (!this.timed) return this.across(place);
      return place % 1 ? "" : time(new Date(1000 * place)).slice(0, step % 60 ? 8 : 5);
    });
  }

  #line({ colour: name, width = 1.5, dash, fill }, colour) {
    return {
      stroke: colour(name),
      width,
      dash,
      fill: fill ? colour(fill) : undefined,
      points: { show: false },
      spanGaps: true,
    };
  }

  /** Write the legend: the figures under the cursor, or else the last ones. */
  #writeLegend() {
    const across = this.#data[0];
    const under = this.#plot?.cursor.idx;
    const place = under ?? across.length - 1;
    updateChildren(this.legend, this.#entries(place), ({ name }) => name, legendEntry, (node, { value }) => {
      setText(node.children[2], value == null ? "–" : this.up(value));
    });
    setAttribute(this.legend, "data-of", this.series[0]?.of ?? null);
    const where = under == null ? "" : this.timed ? time(new Date(1000 * across[place])) : this.across(across[place]);
    setAttribute(this.legend, "data-at", where || null);
  }

  #entries(place) {
    const values = this.#data.slice(1).map((column) => lastKnown(column, place));
    const entries = this.series.map((one, number) => ({ ...one, value: values[number] }));
    const many = this.series[0]?.many;
    if (!many) return entries;
    const near = entries[this.#near - 1];
    return [near ?? { name: `${many}, most of ${entries.length} runs`, colour: "accent", value: Math.max(...values.map((value) => value ?? 0)) }];
  }
}

function lastKnown(column, place) {
  while (place > 0 && column[place] == null) place -= 1;
  return column[place];
}

function legendEntry({ name, colour, dash }) {
  return element("div", {}, element("i", { class: `line ${colour}${dash ? " dashed" : ""}` }), element("dt", {}, name), element("dd"));
}

const MOST_LINES = 32; // runs that are drawn side by side
const MOST_NAMED = 6; // of these with a colour each, as the style sheet has them
const CELLS = [
  { name: "Cells", colour: "accent", width: 2, fill: "wash" },
  { name: "Contact niches", colour: "ink", dash: [5, 4] },
];
const SUCCESSES = [
  { name: "Successes", colour: "faint" },
  { name: "Robust", colour: "ink", dash: [5, 4] },
];
const SPEED = [{ name: "Evaluations/s", colour: "accent", fill: "wash" }];

/** The panels of curves. Earlier points are queried now and then; the newest one is in the state. */
export class CurvePanels {
  constructor(find, api) {
    const plot = (name, looks) => new Plot(find(name), find(`${name}-legend`), looks);
    this.cells = plot("cells");
    this.successes = plot("successes");
    this.speed = plot("speed", { timed: true, up: speed, whole: false });
    this.recorded = new RecordedCurves(api);
  }

  show(job, run, now) {
    const one = run ?? (job.figures.runs < 2 ? job.runs[0] : null);
    const runs = one ? [one] : job.runs.slice(-MOST_LINES);
    const tables = runs.map((each) => runColumns(this.recorded.of(job.job, each)?.points ?? [], each));
    const [done, cells, successes, robust, niches] = one ? tables[0] : [];
    this.cells.show(...(one ? [CELLS, [done, cells, niches]] : manyLines("Cells", runs, tables, 1)));
    this.successes.show(...(one ? [SUCCESSES, [done, successes, robust]] : manyLines("Successes", runs, tables, 2)));
    this.#drawSpeed(job, now);
  }

  #drawSpeed(job, now) {
    const { at, rate: speeds } = this.recorded.history(job.job) ?? { at: [], rate: [] };
    const runsOn = job.state === "running" && now > (at.at(-1) ?? 0);
    this.speed.show(SPEED, runsOn ? [[...at, now], [...speeds, job.speed]] : [at, speeds]);
  }
}

function speed(number) {
  if (Number.isInteger(number)) return count(number);
  return number < 1 ? number.toFixed(2) : rate(number);
}

/** Columns of a run from its beginning until now: evaluations, cells, successes, robust ones, contact niches. */
function runColumns(points, { evaluations, successes, cells, robust, contact_niches: niches }) {
  const known = points.filter(([done]) => done < evaluations);
  const rows = [[0, 0, 0, 0, 0, 0], ...known, [evaluations, 0, successes, cells, robust, niches]];
  return [0, 3, 2, 4, 5].map((column) => rows.map((row) => row[column]));
}

/** Series and data of one quantity of several runs: few each have a colour and stand in the legend, of more the line
 *  near the cursor is named. */
function manyLines(what, runs, tables, column) {
  const named = ({ run }, place) => ({ name: run, of: what, colour: `line-${place + 1}`, dash: place % 2 ? [6, 3] : undefined });
  const unnamed = ({ run }) => ({ name: `${what} of ${run}`, colour: "accent", width: 1, many: what });
  const series = runs.map(runs.length > MOST_NAMED ? unnamed : named);
  return [series, tables.length ? uPlot.join(tables.map((each) => [each[0], each[column]])) : [[]]];
}
