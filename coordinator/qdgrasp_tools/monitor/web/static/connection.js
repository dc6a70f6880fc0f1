// The connection to the page's server: the stream of states, and the sign that shows whether it is live.

import { setAttribute, setText } from "./dom.js";
import { time } from "./format.js";

const FIRST = 250; // ms before the first reconnection; each further one waits twice as long
const LONGEST = 5000; // ms
const SILENCE = 4000; // ms after which a stream without a message is closed and opened anew

/** The stream of the monitor's state, twice a second; it reconnects by itself. */
export class StateStream {
  #source = null;
  #timer = 0;
  #pause = FIRST;

  /** `onstate(state)` with each state; `onlink(since)`: null while connected, else the time it was lost. */
  constructor(address, onstate, onlink) {
    this.address = address;
    this.onstate = onstate;
    this.onlink = onlink;
    this.lost = null;
    addEventListener("online", () => this.#open());
    addEventListener("pagehide", () => this.#close());
    document.addEventListener("visibilitychange", () => (document.hidden ? this.#close() : this.#open()));
    this.#open();
  }

  #open() {
    this.#close();
    this.#source = new EventSource(this.address);
    this.#source.onmessage = (message) => this.#received(JSON.parse(message.data));
    this.#source.onerror = () => this.#reconnect();
    this.#timer = setTimeout(() => this.#reconnect(), SILENCE);
  }

  #close() {
    clearTimeout(this.#timer);
    this.#source?.close();
    this.#source = null;
  }

  #received(state) {
    clearTimeout(this.#timer);
    this.#timer = setTimeout(() => this.#reconnect(), SILENCE);
    this.#pause = FIRST;
    this.lost = null;
    this.onstate(state);
    this.onlink(null);
  }

  #reconnect() {
    this.#close();
    this.lost ??= new Date();
    this.onlink(this.lost);
    this.#timer = setTimeout(() => this.#open(), this.#pause);
    this.#pause = Math.min(2 * this.#pause, LONGEST);
  }
}

const WORDS = { over: "all is over", cut: "the monitor does not reach its router" };

/** The sign of the connection to the page's server, and of the monitor's to its router. */
export class ConnectionStatus {
  /** `live`: the words while all is well. */
  constructor(root, live = "live") {
    this.root = root;
    this.words = { ...WORDS, live };
  }

  /** `lost`: when the server was lost, or null; `state`: the monitor's last state. */
  show(lost, state) {
    const link = lost ? "lost" : routerLink(state);
    setAttribute(this.root, "data-state", link);
    setAttribute(document.documentElement, "data-link", link);
    setText(this.root, lost ? `not connected since ${time(lost)}` : this.words[link]);
  }
}

/** The link to the router; when all jobs are over their router may have ended with them. */
function routerLink(state) {
  if (state?.linked ?? true) return "live";
  const over = state.jobs.length && state.jobs.every((job) => ["ended", "cancelled"].includes(job.state));
  return over ? "over" : "cut";
}
