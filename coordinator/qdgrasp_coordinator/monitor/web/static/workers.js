// Workers: who works, how fast, and who is gone.

import { say } from "./element.js";
import { Table } from "./table.js";
import { ago, bytes, count, rate, several, span } from "./words.js";

const NOBODY = { gone: "the job has no coordinator", ended: "the job has ended", cancelled: "the job was cancelled" };
const STATES = ["working", "idle", "stuck", "leaving", "unknown", "gone"];
const COLUMNS = [
  { name: "host", title: "Host", value: ({ host, pid }) => `${host} ${pid}`, words: ({ host, pid }) => `${host} ${pid}` },
  { name: "state", title: "State", value: ({ state }) => STATES.indexOf(state), words: ({ state }) => state },
  { name: "rate", title: "Rows/s", number: true, value: (worker) => worker.rate, words: (worker) => rate(worker.rate) },
  { name: "batches", title: "Leases", number: true, value: ({ batches }) => batches, words: ({ batches }) => count(batches) },
  { name: "rows", title: "Rows", number: true, value: ({ rows }) => rows, words: ({ rows }) => count(rows) },
  { name: "seen", title: "Last seen", number: true, value: ({ seen }) => seen, words: ({ seen }) => ago(seen) },
  { name: "memory", title: "Memory", number: true, value: ({ memory }) => memory, words: ({ memory }) => bytes(memory) },
  { name: "restarts", title: "Restarts", number: true, value: ({ restarts }) => restarts, words: ({ restarts }) => count(restarts) },
];

export class Workers {
  constructor(find) {
    this.words = find("workers-words");
    this.table = new Table(find("workers"), COLUMNS, {
      caption: "Workers; the buttons in the first row sort them",
      key: ({ wid }) => wid,
      sorted: "host",
    });
  }

  show({ state, silent, team }) {
    if (state in NOBODY) return this.#say(`nobody works: ${NOBODY[state]}`, []);
    if (state === "silent") return this.#say(`nobody tells of them for ${span(silent)}`, team.workers.map((worker) => unheard(worker, silent)));
    const states = STATES.filter((state) => team.states[state]).map((state) => `${count(team.states[state])} ${state}`);
    const unlisted = team.total - team.workers.length;
    const rest = unlisted ? `; ${several(unlisted, "other")} not listed` : "";
    this.#say(team.total ? states.join(", ") + rest : "none has joined: start some with qdgrasp-worker", team.workers);
  }

  #say(words, workers) {
    say(this.words, words);
    this.table.show(workers, ({ state }) => state);
  }
}

/** A worker as it was when it was told of last. */
function unheard(worker, silent) {
  return { ...worker, state: worker.state === "gone" ? "gone" : "unknown", rate: 0, seen: worker.seen + silent };
}
