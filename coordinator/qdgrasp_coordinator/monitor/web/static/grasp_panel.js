// The panel of grasps: the view in 3D of a run, and the card of the selected grasp.

import { element, setAttribute, setText } from "./dom.js";
import { several } from "./format.js";
import { addressFilters, OVER } from "./job_state.js";
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
    this.card = new GraspCard(find("grasp"), () => this.#close(), (closed) => (this.#view.closed = closed));
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
      this.#view.onselect = (grasp) => this.card.show(grasp, this.#view.closed);
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
    this.filters.connect(view, addressFilters());
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

/** The selected grasp: its numbers, a slider that closes the hand, its poses, and the commands that show and draw it. */
class GraspCard {
  /** `onclose()`: the card is to be closed; `onclosing(closed)`: the hand is to be so far closed, from 0 to 1. */
  constructor(node, onclose, onclosing) {
    this.node = node;
    this.onclose = onclose;
    this.onclosing = onclosing;
  }

  /** Show the server's description of a grasp whose hand is so far closed, from 0 to 1; null: nothing. */
  show(grasp, closed) {
    this.node.hidden = !grasp;
    if (!grasp) return;
    const parts = [this.#header(grasp), this.#slider(closed), figures(grasp), afterClosing(grasp), ...poses(grasp), joints(grasp), contacts(grasp)];
    this.node.replaceChildren(...parts, ...grasp.commands.map(command));
  }

  #slider(closed) {
    const input = element("input", { type: "range", min: 0, max: 1, step: 0.01, value: closed, "aria-label": "Closing of the hand" });
    const words = element("output", {}, closedWords(closed));
    input.addEventListener("input", () => {
      setText(words, closedWords(Number(input.value)));
      setAttribute(input, "aria-valuetext", words.textContent);
      this.onclosing(Number(input.value));
    });
    setAttribute(input, "aria-valuetext", words.textContent);
    return element("div", { class: "closing", "aria-live": "off" }, element("span", {}, "Hand"), input, words);
  }

  #header({ number }) {
    const close = element("button", { type: "button", class: "quiet", "aria-label": "Close" }, "×");
    close.addEventListener("click", () => this.onclose());
    return element("header", {}, element("h4", {}, `Grasp ${number}`), close);
  }
}

function figures({ words, fitness, eta, trials, synergy, cell }) {
  const lines = [["Outcome", words], ["Fitness", String(fitness)]];
  if (eta !== null) lines.push(["eta", `${eta.toFixed(3)} of ${several(trials, "trial")}`]);
  if (synergy) lines.push(["Synergy", synergy]);
  return list([...lines, ["Cell [cm]", cell.join(", ")]]);
}

function closedWords(closed) {
  return closed === 1 ? "closed" : closed ? `${Math.round(100 * closed)} % closed` : "open";
}

function afterClosing({ penetration, moved, turned, finger_links: links, margin }) {
  const lines = [["Penetration", `${(1000 * penetration).toFixed(2)} mm`], ["Finger links in contact", String(links)]];
  if (moved !== null) lines.push(["Object moved", `${(1000 * moved).toFixed(1)} mm, ${((180 / Math.PI) * turned).toFixed(1)}°`]);
  if (margin !== null) lines.push(["Margin", margin.toFixed(3)]);
  return element("section", {}, element("h5", {}, "After closing"), list(lines));
}

function poses({ base, commanded, settled }) {
  if (settled) return [pose("Settled pose of ", base, settled, true), pose("Commanded pose of ", base, commanded)];
  const words = "Where the hand settled is not recorded: drawn is the commanded pose, though the object moved while the hand closed.";
  return [element("p", { class: "notes" }, words), pose("Commanded pose of ", base, commanded, true)];
}

function pose(title, base, { position, position_in_mesh: inMesh, quaternion }, open = false) {
  return element("details", { class: "pose", open }, element("summary", {}, title, element("code", {}, base)), list([
    ["From the centre of mass [mm]", millimetres(position)],
    ["In the mesh file's frame [mm]", millimetres(inMesh)],
    ["Quaternion x, y, z, w, in both", quaternion.map((part) => part.toFixed(4)).join(", ")],
  ]));
}

function joints({ joints: positions, pregrasp }) {
  const lines = Object.entries(positions).map(([name, value]) => [name, `${pregrasp[name].toFixed(4)} → ${value.toFixed(4)}`]);
  return element("details", {}, element("summary", {}, `${lines.length} joints, open → closed [rad or m]`), list(lines));
}

function contacts({ contacts: found }) {
  const lines = found.map(({ link, force }) => [link, force.toPrecision(3)]);
  const swatches = element("p", { class: "notes" }, element("i", { class: "dot finger" }), " finger ", element("i", { class: "dot other" }), " another link");
  return element("details", {}, element("summary", {}, `${several(lines.length, "contact")} [N]`), list(lines), swatches);
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
