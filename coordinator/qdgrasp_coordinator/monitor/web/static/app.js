// The page: what the stream tells is shown by panels, each of which knows one thing about the chosen job.

import { Choice } from "./choice.js";
import { Curves } from "./curves.js";
import { say } from "./element.js";
import { Entries } from "./entries.js";
import { Events } from "./events.js";
import { Grasps } from "./grasps.js";
import { JobList } from "./joblist.js";
import { Link } from "./link.js";
import { Outcomes } from "./outcomes.js";
import { OVER, settled } from "./over.js";
import { Runs } from "./runs.js";
import "./skip.js";
import { Stream } from "./stream.js";
import { Summary } from "./summary.js";
import { Workers } from "./workers.js";

const API = "api";
const find = (id) => document.getElementById(id);
const choice = new Choice(show);
const entries = new Entries(API, show);
const list = new JobList(find("jobs"));
const panels = [Summary, Runs, Curves, Outcomes, Workers, Events, Grasps].map((Panel) => new Panel(find, API));
const link = new Link(find("link"));
let state = null;

/** The chosen job; the first that goes on where none is chosen. */
function chosen(jobs) {
  if (choice.job) return jobs.find(({ job }) => job === choice.job);
  return jobs.find((each) => !OVER.includes(each.state)) ?? jobs[0];
}

function show() {
  if (!state) return;
  const told = chosen(state.jobs);
  const job = told && { ...told, runs: entries.of(told) };
  const run = job?.runs.find((each) => each.run === choice.run) ?? null;
  list.show(state.jobs, job?.job);
  say(find("strangers"), state.strangers.length ? `Of another version, and not shown: ${state.strangers.join(", ")}` : "");
  find("empty").hidden = Boolean(job);
  find("chosen").hidden = !job;
  say(find("empty").querySelector("h2"), choice.job ? `Nothing is heard of the job ${choice.job}` : "No job yet");
  document.title = job ? `${job.job}, ${job.state} – qdgrasp` : "qdgrasp monitor";
  if (job) for (const panel of panels) panel.show(job, run, state.at);
}

function heard(told) {
  state = { ...told, jobs: told.jobs.map(settled) };
  show();
}

new Stream(`${API}/stream`, heard, (lost) => link.show(lost, state));
