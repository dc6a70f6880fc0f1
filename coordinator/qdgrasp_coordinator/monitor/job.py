"""A job as whoever watches it knows it: what was heard of it last, and how that came to be.

Nothing here knows a clock: time is passed in, in seconds since 1970.
"""

from collections.abc import Callable, Iterable

from msgspec import Struct

from qdgrasp_coordinator.counts.curve import POINTS, Curve, Point
from qdgrasp_coordinator.counts.events import KEPT, Event, Events
from qdgrasp_coordinator.counts.figures import Figures, JobFigures, JobMeta, from_json
from qdgrasp_coordinator.counts.team import TeamFigures, WorkerFigures
from qdgrasp_coordinator.monitor.series import History, Series, Thinned
from qdgrasp_protocol.errors import MessageError
from qdgrasp_protocol.keys import Keys, last_chunk

SILENCE = 5.0  # seconds after which a coordinator that says nothing is silent; it speaks twice a second
ECHO = 1.0  # seconds in which a message may come later than the news that its coordinator is gone
MOST_RUNS = 512
"""So many runs of a job are remembered, those that were heard of last."""


class JobView(Struct, frozen=True, kw_only=True):
    """A job as it is shown: on a terminal, on the page, as metrics, as JSON."""

    job: str
    state: str
    """What its coordinator says: "starting", "running", "paused" or "ending"; or, where it says nothing,
    "silent" (nobody knows why: the router may be away), "gone" (it died) or "ended" (it was done)."""
    silent: float
    """Seconds since its coordinator was heard."""
    meta: JobMeta
    figures: JobFigures
    runs: list[Figures]
    """Those in progress, and those that ended while somebody watched, in the order they were heard of."""
    workers: list[WorkerFigures]
    events: list[Event]
    """The latest, eldest first."""
    history: Series
    """How the job went while somebody watched."""
    histories: dict[str, Series]
    """How its runs did, by their names."""
    curves: dict[str, Curve]
    """How the runs grew from their beginnings on, by their names."""


class Course:
    """A run while it goes on: its figures, and how they came to be."""

    def __init__(self, figures: Figures) -> None:
        self.figures = figures
        self.history = History()
        self._points = _no_points()

    def heard(self, figures: Figures, now: float) -> None:
        """Hear how far it is."""
        self.figures = figures
        self.history.add(figures, now)
        self._points.add(
            Point(figures.evaluations, figures.proposals, figures.successes, figures.cells, figures.robust)
        )

    def answered(self, curve: Curve) -> None:
        """Hear how it got there; what was heard since is added."""
        later, self._points = self._points.points, _no_points()
        for point in [*curve.points, *later]:
            self._points.add(point)

    @property
    def curve(self) -> Curve:
        """How it grew."""
        return Curve(run=self.figures.run, points=list(self._points.points))


class Job:
    """One job; `heard` takes what its coordinator says, `view` shows what is known.

    Parameters
    ----------
    name
        The job's.
    """

    def __init__(self, name: str) -> None:
        self.keys = Keys(name)
        self.name = name
        self.meta: JobMeta | None = None
        self.figures: JobFigures | None = None
        self.is_readable = True
        """False while what its coordinator says is of another version."""
        self._runs: dict[str, Course] = {}
        self._pages: dict[int, list[WorkerFigures]] = {}
        self._events: dict[tuple[float, int], Event] = {}
        self._history = History()
        self._heard_at = 0.0
        self._gone_at: float | None = None
        self._coordinators: set[str] = set()
        self._unasked: set[str] = set()  # runs that were not seen from their beginnings on

    # What comes.

    def heard(self, key: str, payload: bytes, now: float) -> bool:
        """Take a message, or an answer; False where it is none that this version can read."""
        for pattern, kind, take in self._takers(key):
            if key == pattern:
                try:
                    take(from_json(payload, kind), now)
                except MessageError:  # another version, or no coordinator of ours
                    self.is_readable = self.is_readable and key != self.keys.stat("job")
                    return False
                self._heard_at = max(self._heard_at, now)
                return True
        return False

    def token(self, key: str, alive: bool, now: float, *, is_linked: bool = True) -> None:
        """Hear that a coordinator is there, or gone; without a way to the router all seem gone."""
        (self._coordinators.add if alive else self._coordinators.discard)(key)
        if alive:
            self._gone_at, self._heard_at = None, now
        elif is_linked and not self._coordinators:
            self._gone_at = now

    def cut_off(self, now: float) -> None:
        """Hear that there is no way to the router: who seems gone since a moment ago may be there."""
        if self._gone_at is not None and now <= self._gone_at + ECHO:
            self._gone_at = None

    def _takers(self, key: str) -> Iterable[tuple[str, type[Struct], Callable[..., None]]]:
        """What is told on the key, by the pattern of that: its kind, and who takes it."""
        last, keys = last_chunk(key), self.keys
        yield keys.stat("job"), JobFigures, self._take_figures
        yield keys.stat(f"run/{last}"), Figures, self._take_run
        yield keys.stat(f"team/{last}"), TeamFigures, self._take_team
        yield keys.stat(f"curve/{last}"), Curve, self._take_curve
        yield keys.meta, JobMeta, self._take_meta
        yield keys.recent, Events, self._take_events
        yield keys.event(last), Event, self._take_event

    def _take_meta(self, meta: JobMeta, now: float) -> None:
        self.meta = meta

    def _take_figures(self, figures: JobFigures, now: float) -> None:
        self.is_readable = True
        if self._gone_at is not None and now > self._gone_at + ECHO:
            self._gone_at = None  # another one starts, that has no token yet
        self.figures = figures
        self._history.add(figures, now)

    def _take_run(self, figures: Figures, now: float) -> None:
        if figures.run not in self._runs and figures.evaluations:
            self._unasked.add(figures.run)
        self._runs.setdefault(figures.run, Course(figures)).heard(figures, now)
        while len(self._runs) > MOST_RUNS:
            del self._runs[next(iter(self._runs))]

    def _take_curve(self, curve: Curve, now: float) -> None:
        self._unasked.discard(curve.run)
        if curve.run in self._runs:
            self._runs[curve.run].answered(curve)

    def _take_team(self, page: TeamFigures, now: float) -> None:
        pages = self._pages | {page.page: page.workers}
        self._pages = {number: pages[number] for number in sorted(pages) if 0 <= number < page.pages}

    def _take_events(self, events: Events, now: float) -> None:
        for event in events.events:
            self._take_event(event, now)

    def _take_event(self, event: Event, now: float) -> None:
        self._events[event.at.timestamp(), event.number] = event
        for old in sorted(self._events)[:-KEPT]:
            del self._events[old]

    # What is to be asked.

    @property
    def is_known(self) -> bool:
        """Whether enough is known of it to show it."""
        return self.meta is not None and self.figures is not None

    def questions(self) -> list[str]:
        """The curves of runs that were not seen from their beginnings on; each is asked for once."""
        runs, self._unasked = sorted(self._unasked), set()
        return [self.keys.stat(f"curve/{run}") for run in runs]

    # What is shown.

    def state(self, now: float, *, is_linked: bool = True) -> str:
        """What the job is about, in a word; see `JobView`."""
        if self.figures and self._gone_at is None and now - self._heard_at <= SILENCE:
            return self.figures.state
        if self._is_over:
            return "ended"
        is_gone = self._gone_at is not None or (is_linked and not self._coordinators)
        return "gone" if is_gone else "silent"

    def view(self, now: float, *, is_linked: bool = True) -> JobView | None:
        """The job as it is shown; None while too little is known of it.

        Parameters
        ----------
        is_linked
            Whether there is, and has been for a while, a way to the router.
        """
        if self.meta is None or self.figures is None:
            return None
        return JobView(
            job=self.name,
            state=self.state(now, is_linked=is_linked),
            silent=max(0.0, now - self._heard_at),
            meta=self.meta,
            figures=self.figures,
            runs=[course.figures for course in self._runs.values()],
            workers=[worker for page in self._pages.values() for worker in page],
            events=[self._events[key] for key in sorted(self._events)],
            history=self._history.series,
            histories={run: course.history.series for run, course in self._runs.items()},
            curves={run: course.curve for run, course in self._runs.items()},
        )

    @property
    def _is_over(self) -> bool:
        """Whether there was nothing left to do when its coordinator was heard last."""
        last = self.figures
        return last is not None and (
            last.state == "ending" or last.runs_done + last.runs_failed >= last.runs > 0
        )


def _no_points() -> Thinned[Point]:
    return Thinned(lambda point: point.evaluations, POINTS)
