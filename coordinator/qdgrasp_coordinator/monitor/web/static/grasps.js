// Grasps: the view in 3D of what a run has found, and all that is known of the grasp that somebody chose in it.

import { say } from "./element.js";
import { OVER } from "./over.js";
import { Card } from "./scene/card.js";
import { Filters } from "./scene/filters.js";
import { Key } from "./scene/key.js";
import { several } from "./words.js";

export class Grasps {
  #view = null;
  #shown = "";
  #number = 0;
  #said = "";
  #unread = () => 0; // cells that were found and are not shown

  constructor(find, api) {
    this.api = api;
    this.canvas = find("scene");
    this.run = find("scene-run");
    this.words = find("scene-words");
    this.veil = find("scene-empty");
    this.card = new Card(find("grasp"), () => this.#close());
    this.key = new Key(find("scene-key"));
    this.filters = new Filters(find("scene-filters"));
  }

  /** Shows the chosen run of a job, or of several the one that goes on. */
  show(job, run) {
    const one = run ?? job.runs.find(({ finished }) => !finished) ?? job.runs.at(-1);
    this.look(job.job, one?.run, job.figures.runs > 1);
    this.#unread = () => (OVER.includes(job.state) ? one.cells - this.#view.cells.size : 0);
    this.#say();
  }

  /** Show a run, and its name where `named`; without one: none. */
  look(job, run, named) {
    say(this.run, named && run ? run : "");
    const shown = run ? JSON.stringify([job, run]) : "";
    if (shown === this.#shown) return;
    this.#shown = shown;
    this.#open(job, run);
  }

  async #open(job, run) {
    const number = ++this.#number;
    this.#view?.stop();
    this.#view = null;
    this.card.show(null);
    this.#steer(null);
    if (!run) return this.#veil("Nothing is in progress.");
    try {
      const { SceneView } = await import("./scene.js"); // three is large: the rest of the page does not wait for it
      if (number !== this.#number) return;
      this.#veil("");
      this.#view = new SceneView(this.canvas, this.api, job, run);
      this.#view.onselect = (grasp) => this.card.show(grasp);
      this.#view.onstatus = (words) => this.#say(words);
      this.#view.onchange = () => [this.key, this.filters].forEach((part) => part.show());
      this.#steer(this.#view);
      this.#view.start();
    } catch (error) {
      this.#veil(`The view in 3D cannot be drawn here: ${error.message}. The rest of the page does without it.`);
    }
  }

  /** Say what is shown, and what is not: a recorder may have left before it was asked for the last finds. */
  #say(words = this.#said) {
    this.#said = words;
    const unread = this.#view?.cast ? this.#unread() : 0;
    say(this.words, unread > 0 ? `${words.replace(/\.$/, "")}; ${several(unread, "more is", "more are")} in the run's folder: qdgrasp view` : words);
  }

  #steer(view) {
    this.key.steer(view);
    this.filters.steer(view);
  }

  #close() {
    this.#view?.select(null);
    this.canvas.focus();
  }

  #veil(words) {
    say(this.veil, words);
    this.veil.hidden = !words;
  }
}
