// Grasps: the view in 3D of what a run has found, and all that is known of the grasp that somebody chose in it.

import { element, put, say } from "./element.js";

export class Grasps {
  #view = null;
  #shown = "";
  #number = 0;

  constructor(find, api) {
    this.api = api;
    this.canvas = find("scene");
    this.words = find("scene-words");
    this.veil = find("scene-empty");
    this.card = find("grasp");
    this.SceneView = import("./scene.js").then(({ SceneView }) => SceneView);
  }

  /** Shows the chosen run, or of several the one that goes on. */
  show(job, run) {
    const one = run ?? job.runs.find(({ finished }) => !finished) ?? job.runs.at(-1);
    const shown = one ? `${job.job}/${one.run}` : "";
    if (shown === this.#shown) return;
    this.#shown = shown;
    this.#open(job.job, one?.run);
  }

  async #open(job, run) {
    const number = ++this.#number;
    this.#view?.stop();
    this.#view = null;
    this.#card(null);
    if (!run) return this.#veil("Nothing is in progress.");
    try {
      const SceneView = await this.SceneView;
      if (number !== this.#number) return;
      this.#veil("");
      this.#view = new SceneView(this.canvas, this.api, job, run);
      this.#view.onselect = (grasp) => this.#card(grasp);
      this.#view.onstatus = (words) => say(this.words, words);
      this.#view.start();
    } catch (error) {
      this.#veil(`The view in 3D cannot be drawn here: ${error.message}`);
    }
  }

  #veil(words) {
    say(this.veil, words);
    this.veil.hidden = !words;
  }

  #card(grasp) {
    this.card.hidden = !grasp;
    if (!grasp) return;
    this.card.replaceChildren(...lines(grasp, () => this.#view?.select(null)));
  }
}

function lines(grasp, close) {
  const button = element("button", { type: "button", class: "quiet", "aria-label": "Close" }, "×");
  button.addEventListener("click", close);
  return [element("header", {}, element("h4", {}, `Grasp ${grasp.number}`), button)];
}
