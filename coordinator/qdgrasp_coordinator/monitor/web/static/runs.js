// Runs: those of a job, each with a way to look at it alone.

import { Choice } from "./choice.js";
import { put, say } from "./element.js";
import { extent } from "./extent.js";
import { Table } from "./table.js";
import { count, percent } from "./words.js";

const COLUMNS = [
  { name: "run", title: "Run", value: ({ run }) => run, words: ({ run }) => run, link: ({ job, run }) => Choice.address(job, run) },
  { name: "done", title: "Done", number: true, value: (run) => run.evaluations / extent(run), words: (run) => (run.finished ? "finished" : percent(run.evaluations, extent(run))) },
  { name: "evaluations", title: "Evaluations", number: true, value: ({ evaluations }) => evaluations, words: ({ evaluations }) => count(evaluations) },
  { name: "successes", title: "Successes", number: true, value: ({ successes }) => successes, words: ({ successes }) => count(successes) },
  { name: "cells", title: "Cells", number: true, value: ({ cells }) => cells, words: ({ cells }) => count(cells) },
  { name: "robust", title: "Robust", number: true, value: ({ robust }) => robust, words: ({ robust }) => count(robust) },
];

export class Runs {
  constructor(find) {
    this.panel = find("runs-panel");
    this.words = find("runs-words");
    this.all = find("all-runs");
    this.table = new Table(find("runs"), COLUMNS, {
      caption: "Runs of the job; the buttons in the first row sort them",
      key: ({ run }) => run,
    });
  }

  show(job, chosen) {
    const runs = job.runs.map((run) => ({ ...run, job: job.job }));
    this.panel.hidden = job.figures.runs < 2 && runs.length < 2;
    put(this.all, "href", Choice.address(job.job));
    put(this.all, "aria-current", chosen ? null : "true");
    const { runs_open: open, runs_done: done, runs_failed: failed } = job.figures;
    say(this.words, `${count(open)} in progress, ${count(done)} done${failed ? `, ${count(failed)} failed` : ""}`);
    this.table.show(runs, ({ run, finished }) => `${finished ? "ended" : ""} ${run === chosen?.run ? "chosen" : ""}`.trim());
  }
}
