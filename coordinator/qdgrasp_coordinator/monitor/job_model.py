"""Models of jobs and runs as a monitor knows them, built from the messages it heard.

Counts of a job and its runs do not fall where another coordinator goes on with them. Nothing here knows a
clock, a bus or a thread: time is passed in, in seconds since 1970, and questions that are to be asked are
handed out.
"""

from collections.abc import Callable, Iterable, Mapping
from typing import Any, TypeVar

from msgspec import Struct, structs

from qdgrasp_coordinator.metrics.job_status import (
    EVENTS_KEPT,
    JobEvent,
    JobEvents,
    JobMeta,
    JobStatus,
    RunStatus,
    WorkersPage,
    WorkerStatus,
    from_json,
)
from qdgrasp_coordinator.metrics.run_stats import CURVE_POINTS, TOTAL_NAMES, CurvePoint, GrowthCurve
from qdgrasp_coordinator.monitor.job_view import JobView, SeriesBuilder, ThinnedSamples, last_word
from qdgrasp_protocol.errors import MessageError
from qdgrasp_protocol.keys import AnyJob, Keys, job_of, last_chunk, matches

CountedStatus = TypeVar("CountedStatus", RunStatus, JobStatus)

COUNTS = frozenset({*TOTAL_NAMES, "rows", "outcomes"})
"""What only grows while a job goes on: numbers, or numbers by name. Jobs do not have all of them."""


def with_monotonic_counts(now: CountedStatus, before: CountedStatus | None) -> CountedStatus:
    """The figures now, with no count below what it was before; what is counted does not remain."""
    if before is None:
        return now
    names = COUNTS.intersection(now.__struct_fields__)
    counts = {name: _greater(getattr(before, name), getattr(now, name)) for name in names}
    if isinstance(now, JobStatus):
        counts["remaining"] = max(0, now.remaining - (counts["evaluations"] - now.evaluations))
    return structs.replace(now, **counts)


def continues_job(before: JobMeta, now: JobMeta) -> bool:
    """Whether it is the coordinator of before, or one that goes on with its work.

    Turns are counted, which is all there is to go by where a job has no identity.
    """
    if before.identity and now.identity:
        return before.identity == now.identity
    return now.since == before.since or not now.epoch or now.epoch > before.epoch


def _greater(before: Any, now: Any) -> Any:
    if isinstance(now, Mapping):
        return {name: max(before.get(name, 0), count) for name, count in now.items()}
    return max(before, now)


class RunModel:
    """A run as it was heard of; no count of it falls while it goes on."""

    def __init__(self, figures: RunStatus) -> None:
        self.figures = self._told = figures
        self.history = SeriesBuilder()
        self.heard_at = 0.0
        self._points = _empty_series()

    def heard(self, told: RunStatus, now: float, *, is_over: bool = False) -> None:
        """Hear how far it is; while it goes on, no count falls."""
        one = told if is_over or told.finished else with_monotonic_counts(told, self.figures)
        self.figures, self._told, self.heard_at = one, told, now
        self.history.add(one, now)
        self._points.add(CurvePoint(one.evaluations, one.proposals, one.successes, one.cells, one.robust))

    def release(self) -> None:
        """Show it as it was told last: nobody goes on with it."""
        self.figures = self._told

    @property
    def rank(self) -> tuple[bool, float]:
        """The greater, the sooner it is to be remembered."""
        return not self.figures.finished, self.heard_at

    def answered(self, curve: GrowthCurve) -> None:
        """Hear how it got there; what was heard since is added."""
        later, self._points = self._points.points, _empty_series()
        for point in [*curve.points, *later]:
            self._points.add(point)

    @property
    def curve(self) -> GrowthCurve:
        """How it grew."""
        return GrowthCurve(run=self.figures.run, points=list(self._points.points))


def _empty_series() -> ThinnedSamples[CurvePoint]:
    return ThinnedSamples(lambda point: point.evaluations, CURVE_POINTS)


SILENCE_SECONDS = (
    5.0  # seconds after which a coordinator that says nothing is silent; it speaks twice a second
)
LATE_MESSAGE_SECONDS = (
    1.0  # seconds in which a message may come later than the news that its coordinator is gone
)
RETRY_SECONDS = 5.0  # Seconds until a question that had no answer is asked again
MOST_RUNS = 512
"""So many runs of a job are remembered: those in progress first, then those that were heard of last."""


class JobModel:
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
        self.figures: JobStatus | None = None
        self.is_readable = True
        """False while what its coordinator says is of another version."""
        self.heard_at = 0.0
        """When it was heard of last."""
        self._turn: JobMeta | None = None  # the last that said whose work it goes on with
        self._told: JobStatus | None = None
        self._events: dict[tuple[float, int], JobEvent] = {}
        self._gone_at: float | None = None
        self._coordinators: set[str] = set()
        self._begin()

    def _begin(self) -> None:
        """Know nothing of how it went."""
        self._held: JobStatus | None = None  # below which no count is to fall
        self._runs: dict[str, RunModel] = {}
        self._pages: dict[int, list[WorkerStatus]] = {}
        self._history = SeriesBuilder()
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
        if self._gone_at is not None and now <= self._gone_at + LATE_MESSAGE_SECONDS:
            self._gone_at = None

    def _takers(self, key: str) -> Iterable[tuple[str, type[Struct], Callable[..., None]]]:
        """What is told on the key, by the pattern of that: its kind, and who takes it."""
        last, keys = last_chunk(key), self.keys
        yield keys.stat("job"), JobStatus, self._take_figures
        yield keys.stat(f"run/{last}"), RunStatus, self._take_run
        yield keys.stat(f"team/{last}"), WorkersPage, self._take_team
        yield keys.stat(f"curve/{last}"), GrowthCurve, self._take_curve
        yield keys.meta, JobMeta, self._take_meta
        yield keys.recent, JobEvents, self._take_events
        yield keys.event(last), JobEvent, self._take_event

    def _take_meta(self, meta: JobMeta, now: float) -> None:
        if self._turn and not continues_job(self._turn, meta):
            self._begin_another(meta)
        self.meta = meta
        self._turn = meta if meta.epoch else self._turn or meta

    def _begin_another(self, meta: JobMeta) -> None:
        """Forget the job that had this name before."""
        self._begin()
        self.figures = self._told
        self._events = {key: event for key, event in self._events.items() if event.at >= meta.since}

    def _take_figures(self, figures: JobStatus, now: float) -> None:
        self.is_readable = True
        if self._gone_at is not None and now > self._gone_at + LATE_MESSAGE_SECONDS:
            self._gone_at = None  # another one starts, that has no token yet
        is_over = bool(last_word(figures))
        self._told = figures
        self._held = self.figures = with_monotonic_counts(figures, None if is_over else self._held)
        self._history.add(self.figures, now)
        for course in self._runs.values() if is_over else ():
            course.release()

    def _take_run(self, figures: RunStatus, now: float) -> None:
        if figures.run not in self._runs and figures.evaluations:
            self._unasked[figures.run] = now
        course = self._runs.setdefault(figures.run, RunModel(figures))
        course.heard(figures, now, is_over=bool(last_word(self._told)))
        while len(self._runs) > MOST_RUNS:
            forgotten = min(self._runs, key=lambda run: self._runs[run].rank)
            self._unasked.pop(forgotten, None)
            del self._runs[forgotten]

    def _take_curve(self, curve: GrowthCurve, now: float) -> None:
        self._unasked.pop(curve.run, None)
        if curve.run in self._runs:
            self._runs[curve.run].answered(curve)

    def _take_team(self, page: WorkersPage, now: float) -> None:
        pages = self._pages | {page.page: page.workers}
        self._pages = {number: pages[number] for number in sorted(pages) if 0 <= number < page.pages}

    def _take_events(self, events: JobEvents, now: float) -> None:
        for event in events.events:
            self._take_event(event, now)

    def _take_event(self, event: JobEvent, now: float) -> None:
        self._events[event.at.timestamp(), event.number] = event
        for old in sorted(self._events)[:-EVENTS_KEPT]:
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
        if now - self.heard_at > SILENCE_SECONDS:
            return []
        is_over = {run for run in self._unasked if self._runs[run].figures.finished}
        self._unasked = {run: at for run, at in self._unasked.items() if run not in is_over}
        due = sorted(run for run, at in self._unasked.items() if at <= now)
        self._unasked |= dict.fromkeys(due, now + RETRY_SECONDS)
        return [self.keys.stat(f"curve/{run}") for run in (due if len(due) < 2 else "*")]

    # What is shown.

    def state(self, now: float, *, is_linked: bool = True) -> str:
        """What the job is about, in a word; see `JobView`."""
        if self.figures and self._gone_at is None and now - self.heard_at <= SILENCE_SECONDS:
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


MAX_JOBS = 64  # So many jobs are known at most; those that were heard of last
ALL_KEYS = ""  # Stands for all jobs there are


class JobModels:
    """All jobs that were heard of.

    Parameters
    ----------
    keys
        Which are watched; of others nothing is to be told.
    """

    def __init__(self, keys: Keys | None = None) -> None:
        self._keys = keys or AnyJob()
        self.is_linked = True
        """False while there is no way to the router."""
        self._linked_at = 0.0
        self._jobs: dict[str, JobModel] = {}
        self._due: dict[str, float] = {ALL_KEYS: 0.0}  # when to ask about a job

    # What comes.

    def heard(self, key: str, payload: bytes, now: float) -> None:
        """Take a message; what is no message of ours is left alone."""
        if job := self._job(key):
            job.heard(key, payload, now)
            if not job.is_known:
                self._due.setdefault(job.name, now)

    def answered(self, values: Mapping[str, bytes], now: float) -> None:
        """Take the answers to a question, by their keys: whose they are first, curves behind their runs."""
        curve, meta = AnyJob().stat("curve/*"), AnyJob().meta
        for key in sorted(values, key=lambda key: (not matches(meta, key), matches(curve, key))):
            if job := self._job(key):
                job.heard(key, values[key], now)
        known = {job.name for job in self._jobs.values() if job.is_known}
        self._due = {name: at for name, at in self._due.items() if at <= now or name not in known}

    def token(self, key: str, alive: bool, now: float) -> None:
        """Hear of a coordinator that it is there, or gone."""
        if matches(AnyJob().coordinator_token(), key) and (job := self._job(key)):
            if alive:
                self._due[job.name] = now
            job.token(key, alive, now, is_linked=self.is_linked)

    def linked(self, is_linked: bool, now: float) -> None:
        """Hear whether there is a way to the router."""
        self.is_linked = is_linked
        if is_linked:
            self._linked_at = self._due[ALL_KEYS] = now
        for job in self._jobs.values():
            if not is_linked:
                job.cut_off(now)

    # What is to be asked.

    def questions(self, now: float) -> list[str]:
        """Patterns to ask now: everything at first and when the router is back, a job when it begins."""
        if not self.is_linked:
            return []
        due = {name for name, at in self._due.items() if at <= now}
        unknown = {name for name, job in self._jobs.items() if not job.is_known and due & {name, ALL_KEYS}}
        self._due = {name: at for name, at in self._due.items() if name not in due}
        self._due |= dict.fromkeys(unknown, now + RETRY_SECONDS)
        whose: list[Keys] = [self._keys] if ALL_KEYS in due else [Keys(name) for name in sorted(due)]
        asked = [pattern for keys in whose for pattern in query_keys(keys)]
        curves = [key for job in self._jobs.values() for key in job.questions(now)]
        return asked + [key for key in curves if not any(matches(pattern, key) for pattern in asked)]

    # What is shown.

    def views(self, now: float) -> list[JobView]:
        """The jobs of which enough is known, by their names."""
        is_linked = self.is_linked and now > self._linked_at + SILENCE_SECONDS
        views = [self._jobs[name].view(now, is_linked=is_linked) for name in sorted(self._jobs)]
        return [view for view in views if view is not None]

    @property
    def strangers(self) -> list[str]:
        """Jobs that are there, and whose coordinators speak as another version of qdgrasp does."""
        return sorted(job.name for job in self._jobs.values() if not job.is_readable)

    def _job(self, key: str) -> JobModel | None:
        name = job_of(key)
        if name is None:
            return None
        if name not in self._jobs:
            self._make_room()
            self._jobs[name] = JobModel(name)
        return self._jobs[name]

    def _make_room(self) -> None:
        """Forget the job of which nothing was heard for longest, where there is no room for another."""
        if len(self._jobs) >= MAX_JOBS:
            del self._jobs[min(self._jobs, key=lambda name: self._jobs[name].heard_at)]


def query_keys(keys: Keys) -> list[str]:
    """All that is asked about a job."""
    return [keys.stat(), keys.stat("curve/*"), keys.meta, keys.recent]
