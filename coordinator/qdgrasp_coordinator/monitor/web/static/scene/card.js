// The card: the numbers of a chosen grasp, in which frames they are, and the commands that show and draw it.

import { element } from "../element.js";

export class Card {
  constructor(node, onclose) {
    this.node = node;
    this.onclose = onclose;
  }

  /** Show what the server says of a grasp; null: nothing. */
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
