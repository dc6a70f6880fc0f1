// The monitor's page: each state of the stream is shown by panels, one for each part of the selected job.

import { CurvePanels } from "./charts.js";
import { ConnectionStatus, StateStream } from "./connection.js";
import { setText } from "./dom.js";
import { GraspPanel } from "./grasp_panel.js";
import { OVER, Selection, withEndedState } from "./job_state.js";
import { OutcomePanel, SummaryPanel } from "./job_summary.js";
import { EventPanel, JobList, RunPanel, WorkerPanel } from "./lists.js";
import { ObjectPanel } from "./objects.js";
import { RecordedRuns } from "./run_queries.js";

const API = "api";
const find = (id) => document.getElementById(id);
const selection = new Selection(show);
const recorded = new RecordedRuns(API, show);
const list = new JobList(find("jobs"));
const panels = [SummaryPanel, ObjectPanel, RunPanel, CurvePanels, OutcomePanel, WorkerPanel, EventPanel, GraspPanel].map(
  (Panel) => new Panel(find, API),
);
const connection = new ConnectionStatus(find("link"));
let state = null;

/** The selected job; the first that goes on where none is selected. */
function selected(jobs) {
  if (selection.job) return jobs.find(({ job }) => job === selection.job);
  return jobs.find((each) => !OVER.includes(each.state)) ?? jobs[0];
}

function show() {
  if (!state) return;
  const shown = selected(state.jobs);
  const job = shown && { ...shown, object: selection.object, runs: recorded.of(shown, selection.object) };
  const run = job?.runs.find((each) => each.run === selection.run) ?? null;
  list.show(state.jobs, job?.job);
  find("empty").hidden = Boolean(job);
  find("chosen").hidden = !job;
  explain(find("empty"), selection.job);
  document.title = job ? `${job.job}, ${job.state} – qdgrasp` : "qdgrasp monitor";
  if (job) for (const panel of panels) panel.show(job, run, state.at);
}

/** Say why nothing is shown, and what to do. */
function explain(node, job) {
  const [title, words, command] = node.children;
  setText(title, job ? `Nothing is heard of the job ${job}` : "No job yet");
  setText(words, job ? "It will appear here by itself when its coordinator is heard." : "The monitor is there, and hears no coordinator. Start one, and it will appear here by itself:");
  command.hidden = Boolean(job);
}

function receive(news) {
  state = { ...news, jobs: news.jobs.map(withEndedState) };
  show();
}

new StateStream(`${API}/stream`, receive, (lost) => connection.show(lost, state));
