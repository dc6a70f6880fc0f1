// The link: whether the page's server is heard, and a monitor hears its jobs; and if not, since when.

import { put, say } from "./element.js";
import { time } from "./words.js";

const WORDS = { over: "all is over", cut: "the monitor does not reach its router" };

export class Link {
  /** `live`: what is said while all is well. */
  constructor(root, live = "live") {
    this.root = root;
    this.words = { ...WORDS, live };
  }

  /** `lost`: since when the server is not heard, or null; `state`: what a monitor told last. */
  show(lost, state) {
    const link = lost ? "lost" : linkOf(state);
    put(this.root, "data-state", link);
    put(document.documentElement, "data-link", link);
    say(this.root, lost ? `not connected since ${time(lost)}` : this.words[link]);
  }
}

/** Whether there is a way to the router; a job that is over may have taken its own along. */
function linkOf(state) {
  if (state?.linked ?? true) return "live";
  const over = state.jobs.length && state.jobs.every((job) => ["ended", "cancelled"].includes(job.state));
  return over ? "over" : "cut";
}
