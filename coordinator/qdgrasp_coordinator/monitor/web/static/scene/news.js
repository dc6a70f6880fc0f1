// News: what is found of a run, page by page, and again and again.

const LISTEN = 1000; // ms between questions for what is new
const PATIENCE = 10000; // ms at most between them while nobody answers

export class News {
  #from = 0;
  #timer = 0;
  #wait = LISTEN;
  #stopped = false;

  /** `onpage(page, isFirst)` with each page, `onother()` where what is found now is of another journal, which is
   *  waited for, `onfail(error)` where nobody answers. */
  constructor(source, { onpage, onother, onfail }) {
    Object.assign(this, { source, onpage, onother, onfail });
  }

  /** Hear all there is of the scene with this origin, and from then on what is new. */
  async begin(origin) {
    this.origin = origin;
    this.#from = 0;
    await this.#read(true);
    this.#again(LISTEN);
  }

  stop() {
    this.#stopped = true;
    clearTimeout(this.#timer);
  }

  /** Ask for what is new, and go on asking. */
  async #hear() {
    try {
      if (!document.hidden) await this.#read(false);
      this.#wait = LISTEN;
    } catch (error) {
      this.#wait = Math.min(2 * this.#wait, PATIENCE);
      this.onfail(error);
    }
    this.#again(this.#wait);
  }

  #again(wait) {
    clearTimeout(this.#timer);
    if (!this.#stopped) this.#timer = setTimeout(() => this.#hear(), wait);
  }

  /** Read all pages that there are. */
  async #read(isFirst) {
    for (;;) {
      const page = await this.source.cells(this.#from);
      if (page.origin !== this.origin) return this.onother();
      this.#from = page.next;
      this.onpage(page, isFirst);
      if (!page.more || !page.n) return;
    }
  }
}
