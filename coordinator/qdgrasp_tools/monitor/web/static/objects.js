// The table of a campaign's objects: searched, sorted and divided into pages by the server.

import { element, setAttribute, setText, Table } from "./dom.js";
import { count, percent, several } from "./format.js";
import { OVER, Selection } from "./job_state.js";
import { fetchJson, MANY } from "./run_queries.js";

const SECONDS = 5; // between two queries for the same page
const PAGE = 50; // objects on a page, as the server divides them
const PAUSE = 200; // ms after the last letter of a search before it is asked for
const STATES = ["done", "running", "building", "waiting", "failed", "skipped"];

/** All that is said about an object. */
function words({ little, warnings }) {
  return [little, ...warnings].filter(Boolean).join("; ");
}

const ABOUT = {
  make() {
    return element("span", { class: "about" }, element("small", { class: "faint" }), element("small", { class: "note" }));
  },
  update(node, row) {
    const { category, hands, regions, file, object } = row;
    const [about, note] = node.children;
    setText(about, [category, hands.join(", "), regions].filter(Boolean).join(" · "));
    setText(note, words(row)); // where there is no room for the column of notes
    setAttribute(node.parentElement, "title", file === object ? null : file);
  },
};

const COLUMNS = [
  { name: "object", title: "Object", words: ({ object }) => object, link: ({ job, file }) => Selection.address(job, "", file), more: ABOUT },
  { name: "state", title: "State", words: ({ state }) => state },
  { name: "runs", title: "Runs", number: true, words: ({ runs, runs_done: done }) => (runs ? `${count(done)} of ${count(runs)}` : "–") },
  { name: "evaluations", title: "Evaluations", number: true, words: ({ evaluations }) => count(evaluations) },
  { name: "share", title: "Success", number: true, words: ({ successes, evaluations }) => percent(successes, evaluations) },
  { name: "cells", title: "Cells", number: true, words: ({ cells }) => count(cells) },
  { name: "contact_niches", title: "Contact niches", number: true, words: ({ contact_niches: niches }) => count(niches) },
  { name: "grasps", title: "Grasps", number: true, words: ({ grasps }) => count(grasps) },
  { name: "errors", title: "Errors", number: true, words: ({ errors }) => count(errors) },
  { name: "note", title: "Note", words },
];

/** The objects of a job of many, each with a link that shows its runs. */
export class ObjectPanel {
  #job = null; // the job as it was shown last
  #page = null; // the server's last answer, of `#name`
  #name = "";
  #first = 0; // the number of the first object on the page
  #asked = -Infinity;
  #number = 0; // of the last query: answers to earlier ones are dropped
  #timer = 0;

  constructor(find, api) {
    this.find = find;
    this.api = api;
    this.table = new Table(find("objects"), COLUMNS, {
      caption: "Objects of the job; the buttons in the first row sort them",
      key: ({ file }) => file,
      onsort: () => this.#query(0),
    });
    find("objects-search").addEventListener("input", () => {
      clearTimeout(this.#timer);
      this.#timer = setTimeout(() => this.#query(0), PAUSE);
    });
    find("objects-before").addEventListener("click", () => this.#query(this.#first - PAGE));
    find("objects-behind").addEventListener("click", () => this.#query(this.#first + PAGE));
    find("objects").addEventListener("click", ({ target }) => {
      if (target.closest("a")) find("runs-panel").scrollIntoView({ block: "nearest" });
    });
  }

  show(job) {
    this.#job = job;
    if (this.#name !== job.job) this.#begin(job.job);
    const isDue = performance.now() > this.#asked + 1000 * (this.#page?.uncounted ? 1 : SECONDS);
    if (job.figures.runs > 1 && isDue && !(OVER.includes(job.state) && this.#page && !this.#page.uncounted)) this.#query(this.#first);
    this.#draw();
  }

  #begin(name) {
    this.#name = name;
    this.#page = null;
    this.#first = 0;
    this.#asked = -Infinity;
    this.find("objects-search").value = "";
  }

  async #query(first) {
    const number = ++this.#number;
    this.#asked = performance.now();
    const { by, down } = this.table;
    const asked = { search: this.find("objects-search").value.trim(), sort: by ?? "", from: Math.max(0, first) };
    const address = new URLSearchParams(down ? { ...asked, down: 1 } : asked);
    const page = await fetchJson(`${this.api}/jobs/${encodeURIComponent(this.#name)}/objects?${address}`);
    if (number !== this.#number || !page) return; // without an answer the last one stays
    if (this.#page && page.first !== this.#first) this.find("objects").parentElement.scrollTop = 0;
    this.#page = page;
    this.#first = page.first;
    this.#draw();
  }

  #draw() {
    const { job, object, figures } = this.#job;
    const panel = this.find("objects-panel");
    panel.hidden = !this.#page || (this.#page.total < 2 && figures.runs <= MANY);
    if (panel.hidden) return;
    const { objects, first, found, total, states, little, uncounted } = this.#page;
    const parts = STATES.filter((state) => states[state]).map((state) => `${count(states[state])} ${state}`);
    const few = little ? `; ${count(little)} got little` : "";
    const rest = uncounted ? `; ${several(uncounted, "run")} still being counted` : "";
    setText(this.find("objects-words"), `${count(total)}: ${parts.join(", ")}${few}${rest}`);
    setText(this.find("objects-range"), objects.length ? `${count(first + 1)} to ${count(first + objects.length)} of ${count(found)}` : "none found");
    this.find("objects-before").disabled = first === 0;
    this.find("objects-behind").disabled = first + objects.length >= found;
    const rows = objects.map((each) => ({ ...each, job }));
    this.table.show(rows, (row) => `${row.state}${words(row) ? " noted" : ""}${row.file === object ? " chosen" : ""}`);
  }
}
