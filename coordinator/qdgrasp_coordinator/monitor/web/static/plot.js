// A plot: uPlot in the page's own colours, with a legend of words beside it that a cursor can be read from.

import { element, keyed, put, say } from "./element.js";
import { short, time } from "./words.js";

export class Plot {
  #plot = null;
  #data = [[]];
  #shape = "";
  #near = null; // the number of the line near the cursor

  /**
   * `across` and `up` say how numbers along the axes read; `timed`: across is a time in seconds since 1970;
   * `whole`: up are whole numbers.
   */
  constructor(root, legend, { timed = false, across = short, up = short, whole = true } = {}) {
    Object.assign(this, { root, legend, timed, across, up, whole });
    this.series = [];
    new ResizeObserver(() => this.#fit()).observe(root);
    document.addEventListener("themechange", () => this.#draw());
  }

  /**
   * `series`: [{ name, colour, width?, dash?, fill?, many? }], as many as columns in `data` but the first; where
   * there are `many` of one kind, the legend tells of the one near the cursor.
   */
  show(series, data) {
    this.#data = data;
    const shape = JSON.stringify(series);
    this.series = series;
    if (shape !== this.#shape) {
      this.#shape = shape;
      this.#draw();
    } else {
      this.#plot?.setData(data);
    }
    this.#tell();
  }

  #draw() {
    this.#plot?.destroy();
    this.#plot = null;
    const { width, height } = this.root.getBoundingClientRect();
    if (!width || !this.series.length) return;
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
      padding: [10, 22, 0, 0],
      legend: { show: false },
      cursor: { y: false, points: { size: 6 }, focus: { prox: 24 }, drag: { x: false, y: false } },
      focus: { alpha: 0.3 },
      scales: { x: { time: this.timed }, y: { range: (_, low, high) => [0, high > 0 ? high * 1.06 : 1] } },
      axes: [x, { ...axis, gap: 6, size: 52, space: 36, values: (_, places) => places.map((place) => (this.whole && place % 1 ? "" : this.up(place))) }],
      series: [{}, ...this.series.map((each) => this.#line(each, colour))],
      hooks: {
        setCursor: [() => this.#tell()],
        setSeries: [(_, number, { focus }) => (this.#near = focus ? number : null)],
      },
    };
  }

  #across(places) {
    const step = places.length > 1 ? places[1] - places[0] : 1;
    return places.map((place) => (this.timed ? time(new Date(1000 * place)).slice(0, step % 60 ? 8 : 5) : this.across(place)));
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

  /** What the legend says: the figures under the cursor, or else the last ones. */
  #tell() {
    const across = this.#data[0];
    const under = this.#plot?.cursor.idx;
    const place = under ?? across.length - 1;
    keyed(this.legend, this.#entries(place), ({ name }) => name, make, (node, { value }) => {
      say(node.children[2], value == null ? "–" : this.up(value));
    });
    const where = under == null ? "" : this.timed ? time(new Date(1000 * across[place])) : this.across(across[place]);
    put(this.legend, "data-at", where || null);
  }

  #entries(place) {
    const values = this.#data.slice(1).map((column) => last(column, place));
    const entries = this.series.map((one, number) => ({ ...one, value: values[number] }));
    const many = this.series[0]?.many;
    if (!many) return entries;
    const near = entries[this.#near - 1];
    return [near ?? { name: `${many}, most of ${entries.length} runs`, colour: "accent", value: Math.max(...values.map((value) => value ?? 0)) }];
  }
}

function last(column, place) {
  while (place > 0 && column[place] == null) place -= 1;
  return column[place];
}

function make({ name, colour, dash }) {
  return element("div", {}, element("i", { class: `line ${colour}${dash ? " dashed" : ""}` }), element("dt", {}, name), element("dd"));
}
