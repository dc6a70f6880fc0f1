// The link: whether the monitor is heard, and hears the jobs; and if not, since when.

import { put, say } from "./element.js";
import { time } from "./words.js";

export class Link {
  constructor(root) {
    this.root = root;
  }

  /** `lost`: since when the monitor is not heard, or null; `linked`: whether it hears its router. */
  show(lost, linked = true) {
    const state = lost ? "lost" : linked ? "live" : "cut";
    put(this.root, "data-state", state);
    put(document.documentElement, "data-link", state);
    say(this.root, lost ? `not connected since ${time(lost)}` : linked ? "live" : "the monitor does not reach its router");
  }
}
