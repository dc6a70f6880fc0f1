// The stream: what the monitor tells twice a second. It comes back by itself, whatever was away.

const FIRST = 250; // ms before the first new try; each further one waits twice as long
const LONGEST = 5000; // ms
const SILENCE = 4000; // ms after which a stream that says nothing is given up

export class Stream {
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
    this.#source.onmessage = (message) => this.#heard(JSON.parse(message.data));
    this.#source.onerror = () => this.#again();
    this.#timer = setTimeout(() => this.#again(), SILENCE);
  }

  #close() {
    clearTimeout(this.#timer);
    this.#source?.close();
    this.#source = null;
  }

  #heard(state) {
    clearTimeout(this.#timer);
    this.#timer = setTimeout(() => this.#again(), SILENCE);
    this.#pause = FIRST;
    this.lost = null;
    this.onstate(state);
    this.onlink(null);
  }

  #again() {
    this.#close();
    this.lost ??= new Date();
    this.onlink(this.lost);
    this.#timer = setTimeout(() => this.#open(), this.#pause);
    this.#pause = Math.min(2 * this.#pause, LONGEST);
  }
}
