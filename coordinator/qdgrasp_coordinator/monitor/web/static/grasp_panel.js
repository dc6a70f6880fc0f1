// The panel of grasps: the view in 3D of a run, and the card of the selected grasp.

import { element, setText } from "./dom.js";
import { several } from "./format.js";
import { OVER } from "./job_state.js";
import { FilterControls, Legend } from "./scene/controls.js";

/** The view in 3D of a run with its controls; the view itself is loaded when it is first opened. */
export class GraspPanel {
  #view = null;
  #shown = "";
  #number = 0;
  #status = "";
  #unread = () => 0; // cells that were found and are not shown

  constructor(find, api) {
    this.api = api;
    this.canvas = find("scene");
    this.run = find("scene-run");
    this.words = find("scene-words");
    this.notice = find("scene-empty");
    this.card = new GraspCard(find("grasp"), () => this.#close());
    this.legend = new Legend(find("scene-key"));
    this.filters = new FilterControls(find("scene-filters"));
  }

  /** Show the selected run of a job, or of several the one that goes on. */
  show(job, run) {
    const one = run ?? job.runs.find(({ finished }) => !finished) ?? job.runs.at(-1);
    this.open(job.job, one?.run, job.figures.runs > 1);
    this.#unread = () => (OVER.includes(job.state) ? one.cells - this.#view.cells.size : 0);
    this.#writeStatus();
  }

  /** Show a run, and its name where `named`; without a run: nothing. */
  open(job, run, named) {
    setText(this.run, named && run ? run : "");
    const shown = run ? JSON.stringify([job, run]) : "";
    if (shown === this.#shown) return;
    this.#shown = shown;
    this.#load(job, run);
  }

  async #load(job, run) {
    const number = ++this.#number;
    this.#view?.stop();
    this.#view = null;
    this.card.show(null);
    this.#connect(null);
    if (!run) return this.#notify("Nothing is in progress.");
    try {
      const { SceneView } = await import("./scene/scene_view.js"); // three is large: the rest of the page does not wait for it
      if (number !== this.#number) return;
      this.#notify("");
      this.#view = new SceneView(this.canvas, this.api, job, run);
      this.#view.onselect = (grasp) => this.card.show(grasp);
      this.#view.onstatus = (words) => this.#writeStatus(words);
      this.#view.onchange = () => [this.legend, this.filters].forEach((part) => part.show());
      this.#connect(this.#view);
      this.#view.start();
    } catch (error) {
      this.#notify(`The view in 3D cannot be drawn here: ${error.message}. The rest of the page does without it.`);
    }
  }

  /** Write what is shown, and what is not: a recorder may have ended before its last successes were read. */
  #writeStatus(words = this.#status) {
    this.#status = words;
    const unread = this.#view?.objects ? this.#unread() : 0;
    setText(this.words, unread > 0 ? `${words.replace(/\.$/, "")}; ${several(unread, "more is", "more are")} in the run's folder: qdgrasp view` : words);
  }

  #connect(view) {
    this.legend.connect(view);
    this.filters.connect(view);
  }

  #close() {
    this.#view?.select(null);
    this.canvas.focus();
  }

  #notify(words) {
    setText(this.notice, words);
    this.notice.hidden = !words;
  }
}

/** The numbers of the selected grasp, the frames of its pose, and the commands that show and draw it. */
class GraspCard {
  constructor(node, onclose) {
    this.node = node;
    this.onclose = onclose;
  }

  /** Show the server's description of a grasp; null: nothing. */
  show(grasp) {
    this.node.hidden = !grasp;
    if (grasp) this.node.replaceChildren(this.#header(grasp), figures(grasp), pose(grasp), joints(grasp), ...grasp.commands.map(command));
  }

  #header({ number }) {
    const close = element("button", { type: "button", class: "quiet", "aria-label": "Close" }, "×");
    close.addEventListener("click", () => this.onclose());
    return element("header", {}, element("h4", {}, `Grasp ${number}`), close);
  }
}

function figures({ words, fitness, eta, synergy, cell }) {
  const lines = [["Outcome", words], ["Fitness", String(fitness)]];
  if (eta !== null) lines.push(["eta", eta.toFixed(3)]);
  if (synergy) lines.push(["Synergy", synergy]);
  return list([...lines, ["Cell [cm]", cell.join(", ")]]);
}

function pose({ base, position, position_in_mesh: inMesh, quaternion }) {
  const title = element("h5", {}, "Pose of ", element("code", {}, base));
  return element("section", {}, title, list([
    ["From the centre of mass [mm]", millimetres(position)],
    ["In the mesh file's frame [mm]", millimetres(inMesh)],
    ["Quaternion x, y, z, w, in both", quaternion.map((part) => part.toFixed(4)).join(", ")],
  ]));
}

function joints({ joints: positions }) {
  const lines = Object.entries(positions).map(([name, value]) => [name, value.toFixed(4)]);
  return element("details", {}, element("summary", {}, `${lines.length} joints [rad or m]`), list(lines));
}

function list(lines) {
  return element("dl", {}, ...lines.map(([name, value]) => element("div", {}, element("dt", {}, name), element("dd", {}, value))));
}

function millimetres(values) {
  return values.map((value) => (1000 * value).toFixed(1)).join(", ");
}

function command(words) {
  const copy = element("button", { type: "button", class: "quiet", "aria-label": `Copy ${words}` }, "Copy");
  copy.addEventListener("click", async () => {
    try {
      await navigator.clipboard.writeText(words);
      copy.textContent = "Copied";
    } catch {
      copy.textContent = "Select it"; // a page that is not served over TLS may not copy
    }
  });
  return element("div", { class: "replay" }, element("code", { tabindex: "0" }, ...words.split(/(?<= )/).map(unbroken)), copy);
}

/** A word of a command; a flag is not broken at its hyphens. */
function unbroken(word) {
  return word.startsWith("-") ? element("span", { class: "flag" }, word) : word;
}
