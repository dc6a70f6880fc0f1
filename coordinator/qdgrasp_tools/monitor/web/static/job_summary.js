// The summary of a job or run: its state, progress and figures, and the outcomes of its evaluations.

import { element, setAttribute, setText, updateChildren } from "./dom.js";
import { ago, count, percent, rate, several, short, span } from "./format.js";
import { extentOf, OVER, shortName } from "./job_state.js";

const STARTING = "starting: no recorder has answered yet";

/** The head of the page: the job or run, how far it is, and what it has found. */
export class SummaryPanel {
  constructor(find) {
    this.find = find;
  }

  show(job, run, now) {
    const subject = run ?? job.figures;
    setText(this.find("name"), run ? run.run : job.job);
    this.#state(job, run);
    this.#origin(job, run, now);
    this.#progress(subject, run ? job.lefts[run.run] : job.left, isOver(job, run));
    this.#figures(job, run, subject);
    const trouble = this.find("trouble");
    const words = (run && run.trouble) || job.obstacle;
    setText(trouble, words);
    trouble.hidden = !words;
  }

  #state(job, run) {
    const node = this.find("state");
    const { finished } = (run ?? (job.figures.runs < 2 && job.runs[0])) || {};
    const away = ["silent", "gone"].includes(job.state);
    const state = finished && !away ? "ended" : job.state;
    const more = away ? `, last heard ${ago(job.silent)}` : finished ? `: ${finished}` : "";
    setAttribute(node, "data-state", state);
    const doing = !away && !run && job.figures.doing ? `: ${job.figures.doing}` : "";
    setText(node, (state === "starting" ? STARTING : state + doing) + more);
  }

  #origin(job, run, now) {
    const { host, epoch, since, version } = job.meta;
    const up = OVER.includes(job.state) ? "" : `, up ${span(now - Date.parse(since) / 1000)}`;
    const coordinator = `coordinator on ${host}, epoch ${epoch}${up}, version ${version}`;
    const what = run && `${run.method} with ${run.gripper} on ${run.object}, seed ${run.seed}, protocol ${run.protocol}`;
    setText(this.find("origin"), what || coordinator);
  }

  #progress(subject, left, over) {
    const { evaluations, budget, runs, runs_done, runs_failed, scenes, scenes_done, scenes_failed, building } = subject;
    const whole = extentOf(subject);
    const bar = this.find("progress");
    bar.max = whole;
    bar.value = evaluations;
    const all = runs > 1 ? `, ${count(runs_done)} of ${count(runs)} runs` : "";
    const failed = runs_failed ? `, ${count(runs_failed)} failed` : "";
    const now = building?.length ? ` (being built: ${building.map(shortName).join(", ")})` : "";
    const shapes = scenes ? `, ${count(scenes_done)} of ${several(scenes, "shape")}${scenes_failed ? `, ${count(scenes_failed)} failed` : ""}${now}` : "";
    setText(this.find("done"), `${count(evaluations)} of ${count(budget)} evaluations (${percent(evaluations, whole)})${all}${failed}${shapes}`);
    setText(this.find("left"), over ? "" : left);
  }

  #figures(job, run, subject) {
    const speed = isOver(job, run) || job.state === "silent" ? 0 : run ? run.rate : job.speed;
    const share = (number) => `${percent(number, subject.evaluations)} of all`;
    const figures = [
      ["Evaluations/s", rate(speed ?? 0), `${rate(subject.rate ?? 0)} on average`],
      ["Successes", short(subject.successes), share(subject.successes), "a finger touches the object after closing"],
      ["Grasps", short(subject.grasps), share(subject.grasps), "at least one disturbance survived"],
      ["Robust", short(subject.robust), share(subject.robust), "every disturbance survived"],
      ["Cells", short(subject.cells), "of 1 cm", "distinct cells with a success"],
      ["Contact niches", short(subject.contact_niches), "of 2 cm", "distinct places, and sides, at which robust grasps touch the object"],
      ["Workers", ...workers(job)],
      ["Errors", short(subject.errors), `${count(job.figures.requeued)} requeued`, "rows given up, and batches queued again"],
      ["Waiting", short(job.figures.waiting), job.figures.recorders ? "for the disk" : "no recorder", "rows not on disk yet"],
    ];
    updateChildren(this.find("figures"), figures, ([name]) => name, figureItem, (item, [name, number, note, meaning]) => {
      setAttribute(item, "title", meaning ?? null);
      const [term, value, remark] = item.children;
      setText(term, name);
      setText(value, number);
      setText(remark, note);
    });
  }
}

function figureItem() {
  return element("div", {}, element("dt"), element("dd"), element("dd", { class: "faint" }));
}

function isOver(job, run) {
  return Boolean(run?.finished) || OVER.includes(job.state);
}

/** The number of workers and a remark; unknown while the coordinator is silent. */
function workers(job) {
  if (OVER.includes(job.state)) return ["0", job.state === "gone" ? "no coordinator" : "the job is over"];
  if (job.state === "silent") return ["–", "nobody tells"];
  return [short(job.figures.workers), `on ${several(hosts(job), "host")}`];
}

function hosts({ team }) {
  return new Set(team.workers.filter(({ state }) => state !== "gone").map(({ host }) => host)).size;
}

const OUTCOMES = [
  ["error", "Error", "the simulator failed three times"],
  ["dead_end", "Dead end", "no pose worth a simulation"],
  ["overlap", "Overlap", "the open hand is inside the object"],
  ["missed", "Missed", "no finger touched it while closing"],
  ["brushed", "Brushed", "touched while closing, not after"],
  ["dropped", "Dropped", "touched; no disturbance survived"],
  ["shaken", "Shaken", "some disturbances survived"],
  ["held", "Held", "all survived: robust"],
];

/** The outcomes of evaluations, from worst to best, as a bar and a list. */
export class OutcomePanel {
  constructor(find) {
    this.bar = find("outcomes-bar");
    this.list = find("outcomes");
    this.words = find("outcomes-words");
  }

  show(job, run) {
    const counts = run ? run.outcomes : totalOutcomes(job.runs);
    const whole = Object.values(counts).reduce((sum, each) => sum + each, 0);
    const parts = OUTCOMES.map(([name, title, meaning]) => ({ name, title, meaning, number: counts[name] ?? 0, whole }));
    setText(this.words, run || job.runs.length < 2 ? `${count(whole)} genomes` : `${count(whole)} genomes of the runs listed`);
    updateChildren(this.bar, parts, ({ name }) => name, segment, updateSegment);
    updateChildren(this.list, parts, ({ name }) => name, entry, updateEntry);
  }
}

function totalOutcomes(runs) {
  const sums = {};
  for (const { outcomes } of runs) {
    for (const [name, number] of Object.entries(outcomes)) sums[name] = (sums[name] ?? 0) + number;
  }
  return sums;
}

function segment({ name }) {
  return element("i", { class: name });
}

function updateSegment(node, { number, whole, title }) {
  node.style.flexGrow = whole ? number / whole : 0;
  node.hidden = !number;
  setAttribute(node, "title", `${title}: ${count(number)}`);
}

function entry({ name, title, meaning }) {
  const words = element("span", { class: "what" }, element("b", {}, title), ` ${meaning}`);
  return element("li", {}, element("i", { class: `swatch ${name}` }), words, element("span", { class: "number" }), element("span", { class: "share" }));
}

function updateEntry(node, { number, whole }) {
  setAttribute(node, "data-none", number === 0);
  setText(node.children[2], count(number));
  setText(node.children[3], percent(number, whole));
}
