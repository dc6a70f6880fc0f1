"""A job as it is shown: on a terminal, on the page, as metrics, as JSON.

Time series say how its figures grew while it was watched, in points few enough to be drawn at once.
"""

from collections import deque
from collections.abc import Callable
from typing import Generic, NamedTuple, TypeVar

from msgspec import Struct

from qdgrasp_coordinator.metrics.job_status import JobEvent, JobMeta, JobStatus, RunStatus, WorkerStatus
from qdgrasp_coordinator.metrics.run_stats import GrowthCurve

MAX_POINTS = 600  # The most points of a series
STEP = 1.0  # seconds between two points of a young one
MIN_POINTS = 10.0  # seconds of which a rate is to be at least
WINDOW = 30.0  # seconds over which a rate is taken: results are told generation by generation

Kind = TypeVar("Kind")


class Series(Struct, frozen=True, kw_only=True):
    """How the figures of a job or a run grew, in columns of one length, at most `MOST`."""

    at: list[float]
    """When, in seconds since 1970."""
    evaluations: list[int]
    rate: list[float]
    """Counted evaluations per second over the half minute before, replayed ones apart."""
    successes: list[int]
    cells: list[int]
    robust: list[int]
    workers: list[int]


class StatusSample(NamedTuple):
    """One look at the figures of a job or a run: what a series shows, in its order."""

    at: float
    evaluations: int
    rate: float
    successes: int
    cells: int
    robust: int
    workers: int


class RecentSamples:
    """What a coordinator counted lately: the looks of a `WINDOW`, none of them left out."""

    def __init__(self) -> None:
        self._looks: deque[tuple[float, float]] = deque(maxlen=MAX_POINTS)

    def rate(self, seconds: float, fresh: float) -> float:
        """Counted evaluations per second over the `WINDOW` before now.

        Over all the time since the coordinator began, where it is not known how far it was `LEAST` ago.

        Parameters
        ----------
        seconds
            Since the coordinator began; less than before: another one did.
        fresh
            Counted evaluations since then, replayed ones apart.
        """
        looks = self._looks
        if looks and seconds < looks[-1][0]:
            looks.clear()
        looks.append((seconds, fresh))
        while len(looks) > 1 and seconds - looks[1][0] >= WINDOW:
            looks.popleft()
        since, counted = looks[0] if seconds - looks[0][0] >= MIN_POINTS else (0.0, 0.0)
        return max(0.0, (fresh - counted) / (seconds - since)) if seconds > since else 0.0


class ThinnedSamples(Generic[Kind]):
    """Points in order of a place that only grows, thinned by halving; the first and the newest always stay.

    Parameters
    ----------
    place
        Where a point lies.
    most
        The most points.
    step
        How far apart they lie at least, at first.
    """

    def __init__(self, place: Callable[[Kind], float], most: int, step: float = 0.0) -> None:
        self._place = place
        self._most = most
        self._step = step
        self.points: list[Kind] = []

    def add(self, point: Kind) -> None:
        """Take the newest point; one that lies before the last is left out."""
        points, place = self.points, self._place
        if points and place(point) < place(points[-1]):
            return
        is_near = len(points) > 1 and place(point) - place(points[-2]) < self._step
        if is_near or (points and place(point) == place(points[-1])):
            points.pop()
        points.append(point)
        if len(points) > self._most:
            self._halve()

    def _halve(self) -> None:
        *kept, last = self.points
        self.points = [*kept[::2], last]
        self._step = 2 * (self._place(last) - self._place(kept[0])) / self._most


class SeriesBuilder:
    """The looks at a job or a run, of which a series is made."""

    def __init__(self) -> None:
        self._looks: ThinnedSamples[StatusSample] = ThinnedSamples(lambda look: look.at, MAX_POINTS, STEP)
        self._lately = RecentSamples()

    def add(self, figures: RunStatus | JobStatus, at: float) -> None:
        """Note how far it is."""
        one, rate = figures, self._lately.rate(figures.seconds, figures.rate * figures.seconds)
        self._looks.add(
            StatusSample(at, one.evaluations, rate, one.successes, one.cells, one.robust, one.workers)
        )

    @property
    def series(self) -> Series:
        """The series so far."""
        columns = [list(column) for column in zip(*self._looks.points, strict=True)]
        names = Series.__struct_fields__
        return Series(**dict(zip(names, columns or [[] for _ in names], strict=True)))


OVER = ("gone", "ended", "cancelled")  # The states of a job that nobody carries out


class JobView(Struct, frozen=True, kw_only=True):
    """What is known of a job now, and how that came to be."""

    job: str
    state: str
    """What its coordinator says: "starting", "running", "paused", "ending" or, at last, "cancelled".

    Where it says nothing: "silent" (nobody knows why: the router may be away), "gone" (it died) or "ended"
    (all runs are done, or failed).
    """
    silent: float
    """Seconds since its coordinator was heard."""
    meta: JobMeta
    figures: JobStatus
    runs: list[RunStatus]
    """Those in progress, and those that ended while somebody watched, in the order they were heard of."""
    workers: list[WorkerStatus]
    """Each once: on its way to another page one may stand on both."""
    events: list[JobEvent]
    """The latest, eldest first."""
    history: Series
    """How the job went while somebody watched."""
    histories: dict[str, Series]
    """How its runs did, by their names."""
    curves: dict[str, GrowthCurve]
    """How the runs grew from their beginnings on, by their names."""

    def foremost(self, most: int) -> list[RunStatus]:
        """So many of its runs, in their order; left out are those that are over, then the silent ones."""

        def rank(number: int) -> tuple[bool, float, int]:
            run = self.runs[number]
            heard = self.histories[run.run].at[-1:] if run.run in self.histories else []
            return not run.finished, max(heard, default=0.0), number

        return [self.runs[number] for number in sorted(sorted(range(len(self.runs)), key=rank)[-most:])]


def last_word(figures: JobStatus | None) -> str:
    """How a job ended, where these figures are its last; empty where they are not."""
    if figures is None:
        return ""
    if figures.runs_done + figures.runs_failed >= figures.runs > 0:
        return "ended"
    return "cancelled" if figures.state == "cancelled" else ""
