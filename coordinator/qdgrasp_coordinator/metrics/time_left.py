"""Estimates the time that the rest of a job takes; describes its work while no rows come in.

Rows and shapes are estimated apart, each by the time that workers took for one: while shapes are built no
rows come, and a rate over that time would say nothing of the rows that are left. Pure: time is passed in.
"""

from collections.abc import Sequence
from math import inf
from pathlib import Path
from typing import NamedTuple

from msgspec import structs

from qdgrasp_coordinator.metrics.job_status import JobStatus
from qdgrasp_protocol.messages import Heartbeat
from qdgrasp_protocol.text import counted, first_few

QUIET_SECONDS = 10.0
"""Seconds without a row after which it is said what the job does: forty batches, which take 0.25 s each."""
OBJECTS_NAMED = 2  # Most objects that are named while their shapes are built


class WorkersAtWork(NamedTuple):
    """The workers of a job that have something to do."""

    builders: int
    """Workers that build a shape."""
    signs: Sequence[Heartbeat]
    """Latest signs of those that hold rows."""
    settled: int
    """Rows that all workers have settled."""


class TimeLeft:
    """Estimates the time that the rest of a job takes from its figures, which are passed in.

    Work is measured in seconds of workers: those that one evaluation took on the mean while there were rows,
    since the first came, and those that one shape took. Workers without rows count where others have some, as
    they will not have any later either. The remaining work is divided among the present workers.
    """

    def __init__(self) -> None:
        self._at: float | None = None
        self._settled = 0
        self._row_at = -inf
        self._before: float | None = None  # Evaluations with the first rows, which waited for their scene
        self._settled_before = 0  # Rows with them
        self._row_work = 0.0  # Seconds of workers that had rows, or could have had, since then
        self._workers = 1  # The last number that was not 0

    def note(self, figures: JobStatus, work: WorkersAtWork, shapes_left: int, now: float) -> JobStatus:
        """Return a job's figures with the time left, and with its work if no rows come in.

        `shapes_left` are those under way; shapes of runs that are not next are not counted.
        """
        passed = 0.0 if self._at is None else max(0.0, now - self._at)
        evaluations = figures.rate * figures.seconds  # Those that came in, replayed ones apart
        self._workers = figures.workers or self._workers
        if self._before is not None and work.signs:
            self._row_work += passed * max(figures.workers - work.builders, len(work.signs))
        if self._at is not None and work.settled > self._settled:
            self._row_at = now
            if self._before is None:
                self._before, self._settled_before = evaluations, work.settled
        self._at, self._settled = now, work.settled
        is_quiet = now - self._row_at > QUIET_SECONDS and figures.state in ("starting", "running")
        doing = activity(figures, work, has_begun=self._before is not None) if is_quiet else ""
        left = self._estimate(figures, evaluations, shapes_left)
        return structs.replace(figures, seconds_left=left, doing=doing)

    def _estimate(self, figures: JobStatus, evaluations: float, shapes_left: int) -> float | None:
        """Return the seconds left by the mean costs so far; None where one is not known."""
        rows = shapes = 0.0
        if figures.remaining:
            fresh = 0.0 if self._before is None else evaluations - self._before
            if fresh <= 0 or not self._row_work:
                return None
            rows = figures.remaining * self._row_work / fresh
        if figures.trials_left:
            settled = self._settled - self._settled_before
            if settled <= 0 or not self._row_work:
                return None
            rows += figures.trials_left * self._row_work / settled
        if shapes_left:
            if not figures.scenes_seconds:
                return None
            shapes = shapes_left * figures.scenes_seconds / (figures.scenes_done + figures.scenes_failed)
        return (rows + shapes) / self._workers


def activity(figures: JobStatus, work: WorkersAtWork, *, has_begun: bool) -> str:
    """Describe the work of a job in words; `has_begun`: rows have come in before."""
    loading = sum(sign.loading for sign in work.signs)
    rows, done = sum(sign.rows for sign in work.signs), sum(sign.done for sign in work.signs)
    names = [Path(mesh).name for mesh in figures.building]
    if figures.state == "starting":
        return "waiting for the recorder"
    if work.builders:
        shape = "the shape" if work.builders == 1 else "the shapes"
        return f"building {shape} of {first_few(names[: work.builders], OBJECTS_NAMED)}"
    if not figures.workers:
        return "waiting for workers"
    if not figures.runs_open:
        return "waiting for a worker that builds shapes" if names else "making the scene of the next run"
    if loading and not done:
        return f"{counted(loading, 'worker')} loading the scene"
    if not rows:
        return "handing out poses"
    poses = f"{done} of {counted(rows, 'pose')} evaluated"
    return poses if has_begun else f"first poses: {poses}"
