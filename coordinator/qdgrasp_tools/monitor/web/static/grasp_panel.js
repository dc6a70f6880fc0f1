// The panel of grasps: the view in 3D of a run, and the card of the selected grasp.

import { element, setAttribute, setText } from "./dom.js";
import { several } from "./format.js";
import { Gallery } from "./gallery.js";
import { addressFilters, OVER, shortName } from "./job_state.js";
import { FilterControls, Legend } from "./scene/controls.js";

/** The view in 3D of a run with its controls; the view itself is loaded when it is first opened. */
export class GraspPanel {
  #view = null;
  #shown = "";
  #number = 0;
  #status = "";
  #unread = () => 0; // cells that were found and are not shown
  #pinned = null; // the view of the grasp that is kept beside
  #idle = NOTHING; // what is said where there is no run

  constructor(find, api) {
    this.api = api;
    this.canvas = find("scene");
    this.run = find("scene-run");
    this.words = find("scene-words");
    this.notice = find("scene-empty");
    this.beside = find("beside");
    this.card = new GraspCard(find("grasp"), {
      onclose: () => this.#close(),
      onclosing: (closed) => (this.#view.closed = closed),
      onpin: (grasp) => this.#pin(grasp),
    });
    this.gallery = new Gallery(find("scene-best"));
    this.beside.querySelector("button").addEventListener("click", () => this.#unpin());
    this.legend = new Legend(find("scene-key"));
    this.filters = new FilterControls(find("scene-filters"));
  }

  /** Show the selected run of a job, or of several the one that goes on. */
  show(job, run) {
    const one = run ?? job.runs.find(({ finished }) => !finished) ?? job.runs.at(-1);
    this.#idle = idleWords(job);
    this.open(job.job, one?.run, job.figures.runs > 1);
    if (!one) this.#notify(this.#idle);
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
    this.#unpin();
    this.#view?.stop();
    this.#view = null;
    this.#writeStatus("");
    this.card.show(null);
    this.#connect(null);
    if (!run) return this.#notify(this.#idle);
    try {
      const { SceneView } = await import("./scene/scene_view.js"); // three is large: the rest of the page does not wait for it
      if (number !== this.#number) return;
      this.#notify("");
      this.#view = new SceneView(this.canvas, this.api, job, run);
      this.#view.onselect = (grasp) => this.#selected(grasp);
      this.#view.onstatus = (words) => this.#writeStatus(words);
      this.#view.onchange = () => [this.legend, this.filters, this.gallery].forEach((part) => part.show());
      this.#view.onplace = () => this.#pinned?.place();
      this.#view.onreopen = () => this.#unpin();
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
    if (unread <= 0) return setText(this.words, words);
    const more = this.#view.cells.size ? `${words.replace(/\.$/, "")}; ${several(unread, "more is", "more are")}` : several(unread, "cell is", "cells are");
    setText(this.words, `${more} in the run's folder: qdgrasp view`);
  }

  #connect(view) {
    this.legend.connect(view);
    this.gallery.connect(view);
    this.filters.connect(view, addressFilters());
  }

  #selected(grasp) {
    this.card.show(grasp, this.#view.closed, this.#view.objects?.description);
    this.gallery.mark(grasp?.number ?? null);
  }

  /** Keep a grasp in a view of its own beside the first, in which another may be selected now. */
  async #pin(grasp) {
    const view = this.#view, { PinnedView } = await import("./scene/pinned_view.js");
    if (view !== this.#view) return;
    this.#unpin();
    this.beside.hidden = false;
    setText(this.beside.querySelector("b"), `Grasp ${grasp.number}`);
    setText(this.beside.querySelector("span"), besideWords(grasp));
    try {
      this.#pinned = new PinnedView(this.beside.querySelector("canvas"), view, grasp);
    } catch (error) {
      this.#unpin();
      this.#writeStatus(`A second view cannot be drawn here: ${error.message}.`);
    }
  }

  #unpin() {
    this.#pinned?.stop();
    this.#pinned = null;
    this.beside.hidden = true;
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

const NOTHING = "Nothing is in progress.";

/** What is said where no run of a job has begun. */
function idleWords({ state, figures: { runs, runs_done: done, runs_failed: failed, building } }) {
  const waiting = runs - done - failed;
  if (OVER.includes(state) || waiting < 1) return NOTHING;
  const shapes = building.length ? `Shapes that are being built: ${building.map(shortName).join(", ")}. ` : "";
  return `${shapes}${several(waiting, "run")} ${waiting === 1 ? "waits" : "wait"}; grasps appear here when one begins.`;
}

/** A grasp in one line, for comparison. */
function besideWords({ words, fitness, eta, penetration, finger_links: links, moved, margin }) {
  const parts = [words, `fitness ${fitness}`, eta !== null && `eta ${eta.toFixed(3)}`, margin !== null && `margin ${margin.toFixed(3)}`];
  parts.push(`penetration ${(1000 * penetration).toFixed(2)} mm`, several(links, "finger link"), moved !== null && `moved ${(1000 * moved).toFixed(1)} mm`);
  return parts.filter(Boolean).join(" · ");
}

/** The selected grasp: its numbers, a slider that closes the hand, and its poses. */
class GraspCard {
  /** `onclose()`: the card is to be closed; `onclosing(closed)`: the hand is to be so far closed, from 0 to 1; `onpin(grasp)`:
   *  the grasp is to be kept beside. */
  constructor(node, { onclose, onclosing, onpin }) {
    Object.assign(this, { node, onclose, onclosing, onpin });
  }

  /** Show the server's description of a grasp whose hand is so far closed, from 0 to 1, in a scene; null: nothing. */
  show(grasp, closed, scene) {
    this.node.hidden = !grasp;
    if (!grasp) return;
    this.node.replaceChildren(this.#header(grasp), this.#actions(grasp, scene), this.#slider(closed), figures(grasp), afterClosing(grasp), ...poses(grasp), joints(grasp), contacts(grasp));
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

  #actions(grasp, scene) {
    const pin = element("button", { type: "button", class: "quiet", title: "Keep this grasp in a view of its own, and compare it with another" }, "Keep beside");
    pin.addEventListener("click", () => this.onpin(grasp));
    const save = element("button", { type: "button", class: "quiet", title: "Its poses, joints, contacts and figures as JSON" }, "Download");
    save.addEventListener("click", () => download(grasp, scene));
    return element("div", { class: "actions" }, pin, save);
  }

  #header({ number }) {
    const close = element("button", { type: "button", class: "quiet", "aria-label": "Close" }, "×");
    close.addEventListener("click", () => this.onclose());
    return element("header", {}, element("h4", {}, `Grasp ${number}`), close);
  }
}

/** Have the browser save a grasp as JSON: lengths in m, angles in rad, quaternions xyzw. */
function download({ frames, ...grasp }, { gripper, object, com_in_mesh: com }) {
  const frame = "the object's: position from its centre of mass, position_in_mesh in its mesh file's frame; contacts from the centre of mass";
  const text = JSON.stringify({ gripper, object, com_in_mesh: com, units: "m, rad, N", frame, ...grasp }, null, 1);
  const address = URL.createObjectURL(new Blob([text], { type: "application/json" }));
  const name = `${gripper}-${object}-${grasp.number}.json`.replace(/[^\w.-]+/g, "_");
  element("a", { href: address, download: name }).click();
  setTimeout(() => URL.revokeObjectURL(address), 1000);
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
