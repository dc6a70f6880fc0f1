// The page of runs in folders: one of them is chosen, and its grasps are looked at.

import { Choice } from "./choice.js";
import { element, keyed, put, say } from "./element.js";
import { Grasps } from "./grasps.js";
import { Link } from "./link.js";
import "./skip.js";

const API = "api";
const LISTEN = 5000; // ms between questions for runs that have begun
const MANY = 12; // runs: of more one may be searched for
const find = (id) => document.getElementById(id);
const choice = new Choice(show);
const grasps = new Grasps(find, API);
const link = new Link(find("link"), "connected");
let jobs = null;
let lost = null; // since when nobody answers
let shownRun = null; // that was brought into sight

/** The job and the run that were chosen; the first of all where none was. */
function chosen() {
  const job = jobs.find((each) => each.job === choice.job) ?? jobs.find(({ runs }) => runs.length) ?? jobs[0];
  return { job, run: job?.runs.includes(choice.run) ? choice.run : job?.runs[0] };
}

function show() {
  link.show(lost);
  if (!jobs) return;
  const { job, run } = chosen();
  const title = run ? nameOf(job, run) : "";
  const count = jobs.reduce((sum, { runs }) => sum + runs.length, 0);
  put(document.body, "data-runs", count > 1 ? "many" : "one");
  find("search").hidden = count <= MANY;
  keyed(find("shelf"), jobs, (each) => each.job, shelf, (node, each) => fill(node, each, job, run));
  reveal(job, run);
  find("empty").hidden = Boolean(run);
  find("chosen").hidden = !run;
  say(find("name"), title);
  document.title = run ? `${title} – qdgrasp` : "qdgrasp view";
  grasps.look(job?.job, run, false);
}

/** A job of one run is called by its own name. */
function nameOf({ job, runs }, run) {
  return runs.length === 1 && run === "run" ? job : run;
}

function shelf() {
  return element("section", {}, element("h3"), element("ul"));
}

function fill(node, each, job, run) {
  const [title, list] = node.children;
  say(title, each.runs.length === 1 && each.runs[0] === "run" ? each.folder : `${each.job} in ${each.folder}`);
  const words = find("search").value.trim().toLowerCase().split(/\s+/);
  const found = each.runs.filter((name) => words.every((word) => nameOf(each, name).toLowerCase().includes(word)));
  node.hidden = !found.length;
  keyed(list, found, (name) => name, () => element("li", {}, element("a")), (item, name) => {
    put(item.firstChild, "href", Choice.address(each.job, name));
    put(item.firstChild, "aria-current", each === job && name === run ? "page" : null);
    say(item.firstChild, nameOf(each, name));
  });
}

/** Bring the chosen run into sight where it is another. */
function reveal(job, run) {
  const name = JSON.stringify([job?.job, run]);
  if (name === shownRun) return;
  shownRun = name;
  document.querySelector("#shelf [aria-current]")?.scrollIntoView({ block: "nearest" });
}

async function listen() {
  try {
    const answer = await fetch(`${API}/jobs`);
    if (answer.ok) jobs = await answer.json();
    lost = null;
  } catch {
    lost ??= new Date();
  }
  show();
  setTimeout(listen, LISTEN);
}

find("scene-filters").open = true; // there is room for them here
find("search").addEventListener("input", () => jobs && show());
listen();
