// The list of jobs: their names, how far they are, and whether they go on.

import { Choice } from "./choice.js";
import { element, keyed, put, say } from "./element.js";
import { extent } from "./extent.js";
import { percent } from "./words.js";

export class JobList {
  constructor(root) {
    this.root = root;
  }

  show(jobs, chosen) {
    keyed(this.root, jobs, ({ job }) => job, make, (item, job) => {
      const link = item.firstElementChild;
      const [name, done, bar] = link.children;
      const { evaluations } = job.figures;
      const whole = extent(job.figures);
      put(link, "aria-current", job.job === chosen ? "page" : null);
      put(link, "data-state", job.state);
      put(link, "aria-label", `${job.job}, ${job.state}, ${percent(evaluations, whole)}`);
      say(name, job.job);
      say(done, percent(evaluations, whole));
      bar.max = whole;
      bar.value = evaluations;
    });
  }
}

function make(job) {
  const link = element("a", { href: Choice.address(job.job) });
  link.append(element("span", { class: "name" }), element("span", { class: "faint" }), element("progress", { "aria-hidden": "true" }));
  return element("li", {}, link);
}
