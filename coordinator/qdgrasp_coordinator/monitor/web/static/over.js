// Over: which jobs nobody carries out any more.

/** Their states. */
export const OVER = ["gone", "ended", "cancelled"];

/** A job as it is shown: ended as soon as all its runs are, though its coordinator was heard a moment ago. */
export function settled(job) {
  const { runs, runs_done: done, runs_failed: failed } = job.figures;
  return runs && done + failed >= runs ? { ...job, state: "ended" } : job;
}
