// The link: whether the monitor is heard, and if not, since when.

import { put, say } from "./element.js";
import { time } from "./words.js";

export class Link {
  constructor(root) {
    this.root = root;
  }

  show(lost) {
    put(this.root, "data-state", lost ? "lost" : "live");
    put(document.documentElement, "data-link", lost ? "lost" : "live");
    say(this.root, lost ? `not connected since ${time(lost)}` : "live");
  }
}
