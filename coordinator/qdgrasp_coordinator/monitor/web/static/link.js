// The link: whether the monitor is heard, and hears the jobs; and if not, since when.

import { put, say } from "./element.js";
import { time } from "./words.js";

const WORDS = { live: "live", over: "all is over", cut: "the monitor does not reach its router" };

export class Link {
  constructor(root) {
    this.root = root;
  }

  /** `lost`: since when the monitor is not heard, or null; `state`: what it told last. */
  show(lost, state) {
    const link = lost ? "lost" : linkOf(state);
    put(this.root, "data-state", link);
    put(document.documentElement, "data-link", link);
    say(this.root, lost ? `not connected since ${time(lost)}` : WORDS[link]);
  }
}

/** Whether there is a way to the router; a job that is over may have taken its own along. */
function linkOf(state) {
  if (state?.linked ?? true) return "live";
  const over = state.jobs.length && state.jobs.every((job) => ["ended", "cancelled"].includes(job.state));
  return over ? "over" : "cut";
}
