"""A job as whoever watches it knows it: what was heard of it last, and how that came to be.

Nothing here knows a clock: time is passed in, in seconds since 1970.
"""

from collections.abc import Callable, Iterable

from msgspec import Struct

from qdgrasp_coordinator.counts.curve import Curve
from qdgrasp_coordinator.counts.events import KEPT, Event, Events
from qdgrasp_coordinator.counts.figures import Figures, JobFigures, JobMeta, from_json
from qdgrasp_coordinator.counts.team import TeamFigures, WorkerFigures
from qdgrasp_coordinator.monitor.course import Course
from qdgrasp_coordinator.monitor.ratchet import goes_on, raised
from qdgrasp_coordinator.monitor.series import History
from qdgrasp_coordinator.monitor.view import JobView, last_word
from qdgrasp_protocol.errors import MessageError
from qdgrasp_protocol.keys import Keys, last_chunk

SILENCE = 5.0  # seconds after which a coordinator that says nothing is silent; it speaks twice a second
ECHO = 1.0  # seconds in which a message may come later than the news that its coordinator is gone
AGAIN = 5.0
"""Seconds until a question that had no answer is asked again."""
MOST_RUNS = 512
"""So many runs of a job are remembered: those in progress first, then those that were heard of last."""


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
        self.heard_at = 0.0
        """When it was heard of last."""
        self._turn: JobMeta | None = None  # the last that said whose work it goes on with
        self._told: JobFigures | None = None
        self._events: dict[tuple[float, int], Event] = {}
        self._gone_at: float | None = None
        self._coordinators: set[str] = set()
        self._begin()

    def _begin(self) -> None:
        """Know nothing of how it went."""
        self._held: JobFigures | None = None  # below which no count is to fall
        self._runs: dict[str, Course] = {}
        self._pages: dict[int, list[WorkerFigures]] = {}
        self._history = History()
        self._unasked: dict[str, float] = {}  # runs not seen from their beginnings on: when to ask for them

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
                self.heard_at = max(self.heard_at, now)
                return True
        return False

    def token(self, key: str, alive: bool, now: float, *, is_linked: bool = True) -> None:
        """Hear that a coordinator is there, or gone; without a way to the router all seem gone."""
        (self._coordinators.add if alive else self._coordinators.discard)(key)
        if alive:
            self._gone_at, self.heard_at = None, now
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
        if self._turn and not goes_on(self._turn, meta):
            self._begin_another(meta)
        self.meta = meta
        self._turn = meta if meta.epoch else self._turn or meta

    def _begin_another(self, meta: JobMeta) -> None:
        """Forget the job that had this name before."""
        self._begin()
        self.figures = self._told
        self._events = {key: event for key, event in self._events.items() if event.at >= meta.since}

    def _take_figures(self, figures: JobFigures, now: float) -> None:
        self.is_readable = True
        if self._gone_at is not None and now > self._gone_at + ECHO:
            self._gone_at = None  # another one starts, that has no token yet
        is_over = bool(last_word(figures))
        self._told = figures
        self._held = self.figures = raised(figures, None if is_over else self._held)
        self._history.add(self.figures, now)
        for course in self._runs.values() if is_over else ():
            course.release()

    def _take_run(self, figures: Figures, now: float) -> None:
        if figures.run not in self._runs and figures.evaluations:
            self._unasked[figures.run] = now
        course = self._runs.setdefault(figures.run, Course(figures))
        course.heard(figures, now, is_over=bool(last_word(self._told)))
        while len(self._runs) > MOST_RUNS:
            forgotten = min(self._runs, key=lambda run: self._runs[run].rank)
            self._unasked.pop(forgotten, None)
            del self._runs[forgotten]

    def _take_curve(self, curve: Curve, now: float) -> None:
        self._unasked.pop(curve.run, None)
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

    def questions(self, now: float) -> list[str]:
        """The curves of runs that were not seen from their beginnings on, now and then until they come.

        Of a run that is over, and of a job of which nothing is heard, nobody would answer.
        """
        if now - self.heard_at > SILENCE:
            return []
        is_over = {run for run in self._unasked if self._runs[run].figures.finished}
        self._unasked = {run: at for run, at in self._unasked.items() if run not in is_over}
        due = sorted(run for run, at in self._unasked.items() if at <= now)
        self._unasked |= dict.fromkeys(due, now + AGAIN)
        return [self.keys.stat(f"curve/{run}") for run in (due if len(due) < 2 else "*")]

    # What is shown.

    def state(self, now: float, *, is_linked: bool = True) -> str:
        """What the job is about, in a word; see `JobView`."""
        if self.figures and self._gone_at is None and now - self.heard_at <= SILENCE:
            return self.figures.state
        is_gone = self._gone_at is not None or (is_linked and not self._coordinators)
        return last_word(self.figures) or ("gone" if is_gone else "silent")

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
            silent=max(0.0, now - self.heard_at),
            meta=self.meta,
            figures=self.figures,
            runs=[course.figures for course in self._runs.values()],
            workers=list({each.wid: each for page in self._pages.values() for each in page}.values()),
            events=[self._events[key] for key in sorted(self._events)],
            history=self._history.series,
            histories={run: course.history.series for run, course in self._runs.items()},
            curves={run: course.curve for run, course in self._runs.items()},
        )
