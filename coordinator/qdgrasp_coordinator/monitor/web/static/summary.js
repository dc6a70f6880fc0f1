// The summary: what the job is, how far it is, and what it has found.

import { element, keyed, put, say } from "./element.js";
import { extent } from "./extent.js";
import { OVER } from "./over.js";
import { ago, count, percent, rate, several, short, span } from "./words.js";

const STARTING = "starting: no recorder has answered yet";

export class Summary {
  constructor(find) {
    this.find = find;
  }

  show(job, run, now) {
    const subject = run ?? job.figures;
    say(this.find("name"), run ? run.run : job.job);
    this.#state(job, run);
    this.#origin(job, run, now);
    this.#progress(subject, run ? job.lefts[run.run] : job.left, isOver(job, run));
    this.#figures(job, run, subject);
    const trouble = this.find("trouble");
    const words = (run && run.trouble) || job.obstacle;
    say(trouble, words);
    trouble.hidden = !words;
  }

  #state(job, run) {
    const node = this.find("state");
    const { finished } = (run ?? (job.figures.runs < 2 && job.runs[0])) || {};
    const away = ["silent", "gone"].includes(job.state);
    const state = finished && !away ? "ended" : job.state;
    const more = away ? `, last heard ${ago(job.silent)}` : finished ? `: ${finished}` : "";
    put(node, "data-state", state);
    say(node, (state === "starting" ? STARTING : state) + more);
  }

  #origin(job, run, now) {
    const { host, epoch, since, version } = job.meta;
    const turn = `coordinator on ${host}, turn ${epoch}, up ${span(now - Date.parse(since) / 1000)}, version ${version}`;
    const what = run && `${run.method} with ${run.gripper} on ${run.object}, seed ${run.seed}, protocol ${run.protocol}`;
    say(this.find("origin"), what || turn);
  }

  #progress(subject, left, over) {
    const { evaluations, budget, runs, runs_done, runs_failed } = subject;
    const whole = extent(subject);
    const bar = this.find("progress");
    bar.max = whole;
    bar.value = evaluations;
    const all = runs > 1 ? `, ${count(runs_done)} of ${count(runs)} runs` : "";
    const failed = runs_failed ? `, ${count(runs_failed)} failed` : "";
    say(this.find("done"), `${count(evaluations)} of ${count(budget)} evaluations (${percent(evaluations, whole)})${all}${failed}`);
    say(this.find("left"), over ? "" : left);
  }

  #figures(job, run, subject) {
    const speed = isOver(job, run) || job.state === "silent" ? 0 : run ? job.speeds[run.run] : job.speed;
    const share = (number) => `${percent(number, subject.evaluations)} of all`;
    const figures = [
      ["Evaluations/s", rate(speed ?? 0), `${rate(subject.rate ?? 0)} on average`],
      ["Successes", short(subject.successes), share(subject.successes), "a finger touches the object after closing"],
      ["Grasps", short(subject.grasps), share(subject.grasps), "at least one shake survived"],
      ["Robust", short(subject.robust), share(subject.robust), "both shakes survived"],
      ["Cells", short(subject.cells), "of 1 cm", "distinct cells with a success"],
      ["Workers", ...workers(job)],
      ["Errors", short(subject.errors), `${count(job.figures.requeued)} requeued`, "rows given up, and batches queued again"],
      ["Waiting", short(job.figures.waiting), job.figures.recorders ? "rows for the disk" : "no recorder", "rows not on disk yet"],
    ];
    keyed(this.find("figures"), figures, ([name]) => name, make, (item, [name, number, note, meaning]) => {
      put(item, "title", meaning ?? null);
      const [term, value, remark] = item.children;
      say(term, name);
      say(value, number);
      say(remark, note);
    });
  }
}

function make() {
  return element("div", {}, element("dt"), element("dd"), element("dd", { class: "faint" }));
}

function isOver(job, run) {
  return Boolean(run?.finished) || OVER.includes(job.state);
}

/** How many there are, and where; of a coordinator that says nothing nobody knows. */
function workers(job) {
  if (OVER.includes(job.state)) return ["0", job.state === "gone" ? "no coordinator" : "the job is over"];
  if (job.state === "silent") return ["–", "nobody tells"];
  return [short(job.figures.workers), `on ${several(hosts(job), "host")}`];
}

function hosts({ team }) {
  return new Set(team.workers.filter(({ state }) => state !== "gone").map(({ host }) => host)).size;
}
