"""View of a job as every display shows it, and the time series of its figures."""

from collections import deque
from collections.abc import Callable
from operator import itemgetter
from typing import Any, Generic, TypeVar

from msgspec import Struct

from qdgrasp_coordinator.metrics.job_status import JobEvent, JobMeta, JobStatus, RunStatus, WorkerStatus
from qdgrasp_coordinator.metrics.run_stats import GrowthCurve

MAX_POINTS = 600  # The most points of a series
STEP = 1.0  # seconds between two points of a young series
MIN_WINDOW = 10.0  # seconds over which a rate is taken at least
WINDOW = 30.0  # seconds over which a rate is taken: results come generation by generation

Point = TypeVar("Point")


class Series(Struct, frozen=True, kw_only=True):
    """Figures of a job or a run over time, in columns of one length, at most `MAX_POINTS`."""

    at: list[float]  # Seconds since 1970
    evaluations: list[int]
    rate: list[float]  # Counted evaluations per second over the `WINDOW` before, replayed ones apart
    successes: list[int]
    cells: list[int]
    robust: list[int]
    workers: list[int]

    @property
    def latest_rate(self) -> float:
        """The newest rate; 0 for an empty series."""
        return self.rate[-1] if self.rate else 0.0


class ThinnedSamples(Generic[Point]):
    """Points in order of a growing position, thinned by halving; both ends always stay.

    `position` gives the position of a point; at first points are at least `step` apart.
    """

    def __init__(self, position: Callable[[Point], float], most: int, step: float = 0.0) -> None:
        self._position = position
        self._most = most
        self._step = step
        self.points: list[Point] = []

    def add(self, point: Point) -> None:
        """Append the newest point; one that lies before the last is left out."""
        points, position = self.points, self._position
        if points and position(point) < position(points[-1]):
            return
        is_near = len(points) > 1 and position(point) - position(points[-2]) < self._step
        if is_near or (points and position(point) == position(points[-1])):
            points.pop()
        points.append(point)
        if len(points) > self._most:
            *kept, last = points
            self.points = [*kept[::2], last]
            self._step = 2 * (position(last) - position(kept[0])) / self._most


class SeriesBuilder:
    """Builds a series from the figures of a job or a run as they are published."""

    def __init__(self) -> None:
        self._points: ThinnedSamples[tuple[Any, ...]] = ThinnedSamples(itemgetter(0), MAX_POINTS, STEP)
        self._recent: deque[tuple[float, float]] = deque(maxlen=MAX_POINTS)  # of a `WINDOW`: see `_rate`

    def add(self, figures: RunStatus | JobStatus, at: float) -> None:
        """Add the figures at a time [s since 1970]."""
        rate, one = self._rate(figures.seconds, figures.rate * figures.seconds), figures
        self._points.add((at, one.evaluations, rate, one.successes, one.cells, one.robust, one.workers))

    @property
    def series(self) -> Series:
        """The series so far; its columns have the order of a point's values."""
        names = Series.__struct_fields__
        columns = [list(column) for column in zip(*self._points.points, strict=True)]
        return Series(**dict(zip(names, columns or [[] for _ in names], strict=True)))

    def _rate(self, seconds: float, fresh: float) -> float:
        """Return the counted evaluations per second over the `WINDOW` before now.

        `seconds` is the time since the coordinator began, less than before where another one did, and `fresh`
        the counted evaluations since then, replayed ones apart. Their quotient is the rate where the count
        `MIN_WINDOW` ago is not known.
        """
        recent = self._recent
        if recent and seconds < recent[-1][0]:
            recent.clear()
        recent.append((seconds, fresh))
        while len(recent) > 1 and seconds - recent[1][0] >= WINDOW:
            recent.popleft()
        since, counted = recent[0] if seconds - recent[0][0] >= MIN_WINDOW else (0.0, 0.0)
        return max(0.0, (fresh - counted) / (seconds - since)) if seconds > since else 0.0


OVER = ("gone", "ended", "cancelled")  # The states of a job without a coordinator


class JobView(Struct, frozen=True, kw_only=True):
    """Everything known of a job now, and how it came about."""

    job: str
    state: str
    """Published: "starting", "running", "paused", "ending" or, at last, "cancelled".

    Where it publishes nothing: "silent" (for an unknown reason: the router may be away), "gone" (it died) or
    "ended" (all runs are done, or failed).
    """
    silent: float  # Seconds since the last message of its coordinator
    meta: JobMeta
    figures: JobStatus
    runs: list[RunStatus]  # Runs in progress, and those that ended during the watch; by their first messages
    workers: list[WorkerStatus]  # Each once: on its way to another page one may stand on both
    events: list[JobEvent]  # The latest, eldest first
    history: Series  # Figures of the job during the watch
    histories: dict[str, Series]  # The same of its runs, by their names
    curves: dict[str, GrowthCurve]  # Curves of the runs from their beginnings on, by their names

    def foremost(self, most: int) -> list[RunStatus]:
        """Return so many of its runs, in order; first left out are finished, then silent ones."""

        def rank(number: int) -> tuple[bool, float, int]:
            run = self.runs[number]
            latest = self.histories[run.run].at[-1:] if run.run in self.histories else []
            return not run.finished, max(latest, default=0.0), number

        return [self.runs[number] for number in sorted(sorted(range(len(self.runs)), key=rank)[-most:])]


def end_state(figures: JobStatus | None) -> str:
    """Return "ended" or "cancelled" where these are the last figures of a job; else empty."""
    if figures is None:
        return ""
    if figures.runs_done + figures.runs_failed >= figures.runs > 0:
        return "ended"
    return "cancelled" if figures.state == "cancelled" else ""
