// The page of runs in folders: a list of runs, and the grasps of the selected one in 3D.

import { ConnectionStatus } from "./connection.js";
import { element, setAttribute, setText, updateChildren } from "./dom.js";
import { GraspPanel } from "./grasp_panel.js";
import { Selection } from "./job_state.js";

const API = "api";
const POLL = 5000; // ms between queries for runs that have begun
const MANY = 12; // runs: above it they can be searched
const find = (id) => document.getElementById(id);
const narrow = matchMedia("(max-width: 760px)");
const selection = new Selection(choose);
const grasps = new GraspPanel(find, API);
const connection = new ConnectionStatus(find("link"), "connected");
let jobs = null;
let lost = null; // since when the server has not answered
let shownRun = null; // the run that was last scrolled into sight

function choose() {
  closeList();
  show();
}

/** On a narrow page the list of runs is open while one is chosen; elsewhere it always is. */
function closeList() {
  find("run-list").open = !narrow.matches;
}

/** The selected job and run; the first of all where none is selected. */
function selected() {
  const job = jobs.find((each) => each.job === selection.job) ?? jobs.find(({ runs }) => runs.length) ?? jobs[0];
  return { job, run: job?.runs.includes(selection.run) ? selection.run : job?.runs[0] };
}

function show() {
  connection.show(lost);
  if (!jobs) return;
  const { job, run } = selected();
  const title = run ? nameOf(job, run) : "";
  const count = jobs.reduce((sum, { runs }) => sum + runs.length, 0);
  setAttribute(document.body, "data-runs", count > 1 ? "many" : "one");
  find("search").hidden = count <= MANY;
  setText(find("run-words"), title ? `${title}, one of ${count}` : "");
  updateChildren(find("shelf"), jobs, (each) => each.job, jobSection, (node, each) => fill(node, each, job, run));
  reveal(job, run);
  find("empty").hidden = Boolean(run);
  find("chosen").hidden = !run;
  setText(find("name"), title);
  document.title = run ? `${title} – qdgrasp` : "qdgrasp view";
  grasps.open(job?.job, run, false);
}

/** The name of a run in the list: of a job's only run, the job's. */
function nameOf({ job, runs }, run) {
  return runs.length === 1 && run === "run" ? job : run;
}

function jobSection() {
  return element("section", {}, element("h3"), element("ul"));
}

function fill(node, each, job, run) {
  const [title, list] = node.children;
  setText(title, each.runs.length === 1 && each.runs[0] === "run" ? each.folder : `${each.job} in ${each.folder}`);
  const words = find("search").value.trim().toLowerCase().split(/\s+/);
  const found = each.runs.filter((name) => words.every((word) => nameOf(each, name).toLowerCase().includes(word)));
  node.hidden = !found.length;
  updateChildren(list, found, (name) => name, () => element("li", {}, element("a")), (item, name) => {
    setAttribute(item.firstChild, "href", Selection.address(each.job, name));
    setAttribute(item.firstChild, "aria-current", each === job && name === run ? "page" : null);
    setText(item.firstChild, nameOf(each, name));
  });
}

/** Scroll to the selected run when the selection changed. */
function reveal(job, run) {
  const name = JSON.stringify([job?.job, run]);
  if (name === shownRun) return;
  shownRun = name;
  document.querySelector("#shelf [aria-current]")?.scrollIntoView({ block: "nearest" });
}

async function poll() {
  try {
    const answer = await fetch(`${API}/jobs`);
    if (answer.ok) jobs = await answer.json();
    lost = null;
  } catch {
    lost ??= new Date();
  }
  show();
  setTimeout(poll, POLL);
}

find("scene-filters").open = true; // there is room for them here
narrow.addEventListener("change", closeList);
closeList();
find("search").addEventListener("input", () => jobs && show());
poll();
