// The source: what the server says of a run in 3D.

import { readPage } from "./page.js";

export class Source {
  #ended = new AbortController();

  constructor(api, job, run) {
    this.root = `${api}/jobs/${encodeURIComponent(job)}/runs/${encodeURIComponent(run)}`;
  }

  async scene() {
    return (await this.#get("scene")).json();
  }

  async cells(from) {
    return readPage(await (await this.#get(`cells?from=${from}`)).arrayBuffer());
  }

  async grasp(number) {
    return (await this.#get(`grasps/${number}`)).json();
  }

  /** Ask for nothing more; what is under way ends with an `AbortError`. */
  end() {
    this.#ended.abort();
  }

  async #get(path) {
    const answer = await fetch(`${this.root}/${path}`, { signal: this.#ended.signal }).catch(away);
    if (answer.ok) return answer;
    const said = await answer.json().catch(() => ({}));
    throw new Error(said.error ?? `The server answered with ${answer.status}.`);
  }
}

/** Nothing is at the other end any more. */
function away(error) {
  throw error.name === "AbortError" ? error : new Error("Nobody answers: the page's server has ended, or cannot be reached.");
}
