// The choice: which job and run are looked at. It is kept in the address, so that it can be shared and gone back to.

export class Choice {
  constructor(onchange) {
    addEventListener("hashchange", () => onchange());
  }

  get job() {
    return this.#read("job");
  }

  /** The run; empty: all of them. */
  get run() {
    return this.#read("run");
  }

  #read(name) {
    return new URLSearchParams(location.hash.slice(1)).get(name) ?? "";
  }

  static address(job, run = "") {
    return `#${new URLSearchParams(run ? { job, run } : { job })}`;
  }
}
