"""Estimates the time that the rest of a job takes; describes its work while no rows come in.

Rows and shapes are estimated apart, each by the time that workers took for one: while shapes are built no
rows come, and a rate over that time would say nothing of the rows that are left. Pure: time is passed in.
"""

import math
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from msgspec import structs

from qdgrasp_coordinator.metrics.job_status import JobStatus
from qdgrasp_protocol.messages import Heartbeat
from qdgrasp_protocol.text import counted, first_few

SETTLING = 30.0
"""Seconds in which the time left follows a new estimate.

Objects differ in cost, and a time that jumps with each of them is of no use.
"""
QUIET_SECONDS = 10.0
"""Seconds without a row after which it is said what the job does: forty batches, which take 0.25 s each."""
OBJECTS_NAMED = 2  # Most objects that are named while their shapes are built


class WorkCounts(NamedTuple):
    """Counts of the work of a job that is done, and that is left, at one time."""

    rows: int
    """Rows that workers have answered."""
    evaluations: float
    """Counted evaluations that came in, replayed ones apart."""
    remaining: int
    """Counted evaluations that are left."""
    shapes_left: float
    """Shapes that are left to be built, those too that are only expected."""
    shape_seconds: float
    """Seconds that a worker took for a shape, on the mean; 0: none is built yet."""
    workers: int
    """Workers that are there."""
    evaluators: int
    """Of these, workers that hold rows."""
    builders: int
    """Of these, workers that build a shape."""


class TimeLeft:
    """Estimates the time that the rest of a job takes from counts that are passed in.

    Work is measured in seconds of workers: those that one evaluation took on the mean while there were rows,
    since the first came, and those that one shape took. Workers without rows count where others have some, as
    they will not have any later either. The remaining work is divided among the present workers.
    """

    def __init__(self) -> None:
        self._at: float | None = None
        self._rows: int | None = None
        self._row_at = 0.0
        self._before: float | None = None  # Evaluations with the first rows, which waited for their scene
        self._row_work = 0.0  # Seconds of workers that had rows, or could have had, since then
        self._workers = 1  # The last number that was not 0
        self._shown: float | None = None

    @property
    def has_begun(self) -> bool:
        """True if a row has come in."""
        return self._before is not None

    def quiet_seconds(self, now: float) -> float:
        """Return for how long no row has come in [s]; infinite before the first one."""
        return now - self._row_at if self.has_begun else math.inf

    def note(self, counts: WorkCounts, now: float) -> float | None:
        """Take the counts at a time [s]; return the seconds left, or None while they are not known."""
        passed = 0.0 if self._at is None else max(0.0, now - self._at)
        self._at, self._workers = now, counts.workers or self._workers
        if self.has_begun and counts.evaluators:
            self._row_work += passed * max(counts.workers - counts.builders, counts.evaluators)
        if self._rows is not None and counts.rows > self._rows:
            self._row_at = now
            self._before = counts.evaluations if self._before is None else self._before
        self._rows = counts.rows
        self._shown = follow(self._shown, self._estimate(counts), passed)
        return self._shown

    def _estimate(self, counts: WorkCounts) -> float | None:
        """Return the seconds left by the mean costs so far; None where one is not known."""
        fresh = counts.evaluations - (self._before or 0.0)
        if counts.remaining and not (self.has_begun and fresh > 0 and self._row_work):
            return None
        if counts.shapes_left and not counts.shape_seconds:
            return None
        rows = counts.remaining * self._row_work / fresh if counts.remaining else 0.0
        return (rows + counts.shapes_left * counts.shape_seconds) / self._workers


def follow(shown: float | None, estimate: float | None, passed: float) -> float | None:
    """Return the time left to show [s], between an estimate and that shown before.

    From that shown before the time that `passed` [s] is taken off. The first estimate is shown as it is; so
    are None, not known, and 0, nothing left.
    """
    if not estimate or shown is None:
        return estimate
    expected = max(0.0, shown - passed)
    return expected + (estimate - expected) * -math.expm1(-passed / SETTLING)


class WorkersAtWork(NamedTuple):
    """The workers of a job that have something to do."""

    builders: int
    """Workers that build a shape."""
    signs: Sequence[Heartbeat]
    """Latest signs of those that hold rows."""
    settled: int
    """Rows that all workers have settled."""


def with_time_left(
    figures: JobStatus, work: WorkersAtWork, shapes_left: float, left: TimeLeft, now: float
) -> JobStatus:
    """Return a job's figures with the time left, and with its work if no rows come in.

    `shapes_left` are those under way, and those that are only expected. `left` is given these figures.
    """
    ended = figures.scenes_done + figures.scenes_failed
    counts = WorkCounts(
        rows=work.settled,
        evaluations=figures.rate * figures.seconds,
        remaining=figures.remaining,
        shapes_left=shapes_left,
        shape_seconds=figures.scenes_seconds / ended if ended else 0.0,
        workers=figures.workers,
        evaluators=len(work.signs),
        builders=work.builders,
    )
    seconds = left.note(counts, now)
    is_said = figures.state in ("starting", "running") and left.quiet_seconds(now) > QUIET_SECONDS
    doing = activity(figures, work, has_begun=left.has_begun) if is_said else ""
    return structs.replace(figures, seconds_left=seconds, doing=doing)


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
    poses = f"{done} of {counted(rows, 'pose')} evaluated" if done else "candidates are screened"
    return poses if has_begun else f"first poses: {poses}"
