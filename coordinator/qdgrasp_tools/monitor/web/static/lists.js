// The list of jobs, and the tables of a job's runs, workers and events.

import { element, setAttribute, setText, Table, updateChildren } from "./dom.js";
import { ago, bytes, count, percent, rate, several, span, time } from "./format.js";
import { extentOf, Selection } from "./job_state.js";
import { MANY } from "./run_queries.js";

/** The list of jobs: their names, states and progress. */
export class JobList {
  constructor(root) {
    this.root = root;
  }

  show(jobs, chosen) {
    const isNew = this.chosen !== chosen;
    this.chosen = chosen;
    updateChildren(this.root, jobs, ({ job }) => job, jobItem, (item, job) => {
      const link = item.firstElementChild;
      const [name, done, bar] = link.children;
      const { evaluations } = job.figures;
      const whole = extentOf(job.figures);
      setAttribute(link, "aria-current", job.job === chosen ? "page" : null);
      setAttribute(link, "data-state", job.state);
      setAttribute(link, "aria-label", `${job.job}, ${job.state}, ${percent(evaluations, whole)}`);
      setText(name, job.job);
      setText(done, percent(evaluations, whole));
      bar.max = whole;
      bar.value = evaluations;
    });
    if (isNew) this.root.querySelector("[aria-current]")?.scrollIntoView({ block: "nearest", inline: "nearest" });
  }
}

function jobItem(job) {
  const link = element("a", { href: Selection.address(job.job) });
  link.append(element("span", { class: "name" }), element("span", { class: "faint" }), element("progress", { "aria-hidden": "true" }));
  return element("li", {}, link);
}

const RUN_COLUMNS = [
  { name: "run", title: "Run", value: ({ run }) => run, words: ({ run }) => run, link: ({ job, run, chosenObject }) => Selection.address(job, run, chosenObject) },
  { name: "done", title: "Done", number: true, value: (run) => run.evaluations / extentOf(run), words: (run) => (run.finished ? "finished" : percent(run.evaluations, extentOf(run))) },
  { name: "evaluations", title: "Evaluations", number: true, value: ({ evaluations }) => evaluations, words: ({ evaluations }) => count(evaluations) },
  { name: "successes", title: "Successes", number: true, value: ({ successes }) => successes, words: ({ successes }) => count(successes) },
  { name: "cells", title: "Cells", number: true, value: ({ cells }) => cells, words: ({ cells }) => count(cells) },
  { name: "contact_niches", title: "Contact niches", number: true, value: ({ contact_niches: niches }) => niches, words: ({ contact_niches: niches }) => count(niches) },
  { name: "robust", title: "Robust", number: true, value: ({ robust }) => robust, words: ({ robust }) => count(robust) },
];

/** The runs of a job, each with a link that selects it. */
export class RunPanel {
  constructor(find) {
    this.panel = find("runs-panel");
    this.words = find("runs-words");
    this.all = find("all-runs");
    this.scroll = find("runs").parentElement;
    this.table = new Table(find("runs"), RUN_COLUMNS, {
      caption: "Runs of the job; the buttons in the first row sort them",
      key: ({ run }) => run,
    });
  }

  show(job, chosen) {
    const runs = job.runs.map((run) => ({ ...run, job: job.job, chosenObject: job.object }));
    this.panel.hidden = job.figures.runs < 2 && runs.length < 2;
    setAttribute(this.all, "href", Selection.address(job.job));
    setAttribute(this.all, "aria-current", chosen || job.object ? null : "true");
    setText(this.words, job.object ? `${several(runs.length, "run")} of ${job.object} ${runs.length === 1 ? "has" : "have"} begun` : allRuns(job.figures));
    this.scroll.hidden = !runs.length;
    this.table.show(runs, ({ run, finished }) => `${finished ? "ended" : ""} ${run === chosen?.run ? "chosen" : ""}`.trim());
  }
}

function allRuns({ runs, runs_open: open, runs_done: done, runs_failed: failed }) {
  const left = runs - open - done - failed, waiting = left > 0 ? `${count(left)} waiting, ` : "";
  const others = runs > MANY ? "; those that have ended are shown with their object" : "";
  return `${count(open)} in progress, ${waiting}${count(done)} done${failed ? `, ${count(failed)} failed` : ""}${others}`;
}

const NO_WORKERS = { gone: "the job has no coordinator", ended: "the job has ended", cancelled: "the job was cancelled" };
const STATES = ["working", "idle", "stuck", "leaving", "unknown", "gone"];
const WORKER_COLUMNS = [
  { name: "host", title: "Host", value: ({ host, pid }) => `${host} ${pid}`, words: ({ host, pid }) => `${host} ${pid}` },
  { name: "state", title: "State", value: ({ state }) => STATES.indexOf(state), words: ({ state }) => state },
  { name: "rate", title: "Rows/s", number: true, value: (worker) => worker.rate, words: (worker) => rate(worker.rate) },
  { name: "batches", title: "Leases", number: true, value: ({ batches }) => batches, words: ({ batches }) => count(batches) },
  { name: "rows", title: "Rows", number: true, value: ({ rows }) => rows, words: ({ rows }) => count(rows) },
  { name: "seen", title: "Last seen", number: true, value: ({ seen }) => seen, words: ({ seen }) => ago(seen) },
  { name: "memory", title: "Memory", number: true, value: ({ memory }) => memory, words: ({ memory }) => bytes(memory) },
  { name: "restarts", title: "Restarts", number: true, value: ({ restarts }) => restarts, words: ({ restarts }) => count(restarts) },
];

/** The workers of a job: their states, speeds and vitals. */
export class WorkerPanel {
  constructor(find) {
    this.words = find("workers-words");
    this.scroll = find("workers").parentElement;
    this.table = new Table(find("workers"), WORKER_COLUMNS, {
      caption: "Workers; the buttons in the first row sort them",
      key: ({ wid }) => wid,
      sorted: "host",
    });
  }

  show({ state, silent, team }) {
    if (state in NO_WORKERS) return this.#fill(`nobody works: ${NO_WORKERS[state]}`, []);
    if (state === "silent") return this.#fill(`nobody tells of them for ${span(silent)}`, team.workers.map((worker) => asUnknown(worker, silent)));
    const states = STATES.filter((state) => team.states[state]).map((state) => `${count(team.states[state])} ${state}`);
    const total = Object.values(team.states).reduce((sum, each) => sum + each, 0), unlisted = total - team.workers.length;
    const rest = unlisted ? `; ${several(unlisted, "other")} not listed` : "";
    this.#fill(total ? states.join(", ") + rest : "none has joined: start some with qdgrasp-worker", team.workers);
  }

  #fill(words, workers) {
    setText(this.words, words);
    this.scroll.hidden = !workers.length;
    this.table.show(workers, ({ state }) => state);
  }
}

/** A worker of a coordinator that has been silent for some seconds. */
function asUnknown(worker, silent) {
  return { ...worker, state: worker.state === "gone" ? "gone" : "unknown", rate: 0, seen: worker.seen + silent };
}

/** The latest events, the newest first. */
export class EventPanel {
  constructor(find) {
    this.root = find("events");
  }

  show({ events }, run) {
    const shown = events.filter((event) => !run || !event.run || event.run === run.run).toReversed();
    updateChildren(this.root, shown, ({ at, number }) => `${at} ${number}`, eventItem, () => {});
    setAttribute(this.root, "data-none", shown.length === 0);
  }
}

function eventItem({ at, kind, words, run }) {
  const date = new Date(at);
  return element(
    "li",
    { "data-kind": kind },
    element("time", { datetime: at, title: date.toLocaleString() }, time(date)),
    element("span", { class: "kind" }, kind),
    element("span", { class: "words" }, words, run && !words.includes(run) ? element("span", { class: "faint" }, ` ${run}`) : ""),
  );
}
