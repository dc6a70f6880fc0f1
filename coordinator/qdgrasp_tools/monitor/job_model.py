"""Models of jobs and runs, built by a monitor from messages, and the views of them.

Counts of a job and its runs do not fall where another coordinator goes on with them. The models use no
clock, bus or thread: time is passed in, in seconds since 1970, and queries that are due are returned.
"""

from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import suppress
from typing import Any, TypeVar

from msgspec import Struct, structs

from qdgrasp_coordinator.metrics import job_status
from qdgrasp_coordinator.metrics.job_status import JobEvent, JobMeta, JobStatus, RunStatus, WorkerStatus
from qdgrasp_coordinator.metrics.run_stats import TOTAL_NAMES
from qdgrasp_protocol.errors import MessageError
from qdgrasp_protocol.keys import AnyJob, Keys, job_of, last_chunk, matches

MAX_POINTS = 600  # The most points of a series
STEP = 1.0  # seconds between two points of a young series
MIN_WINDOW = 10.0  # seconds over which a rate is taken at least
WINDOW = 30.0  # seconds over which a rate is taken: results come generation by generation


class Series(Struct, frozen=True, kw_only=True):
    """Figures of a job over time, in columns of one length, at most `MAX_POINTS`."""

    at: list[float]  # Seconds since 1970
    rate: list[float]  # Counted evaluations per second over the `WINDOW` before, replayed ones apart
    evaluations: list[int]
    successes: list[int]
    cells: list[int]

    @property
    def latest_rate(self) -> float:
        """The newest rate; 0 for an empty series."""
        return self.rate[-1] if self.rate else 0.0


class SeriesBuilder:
    """Builds a series from the figures of a job as they are published.

    Points are thinned by halving; both ends always stay.
    """

    def __init__(self) -> None:
        self._points: list[tuple[Any, ...]] = []
        self._step = STEP
        self._recent: deque[tuple[float, float]] = deque(maxlen=MAX_POINTS)  # of a `WINDOW`: see `_rate`

    def add(self, figures: JobStatus, at: float) -> None:
        """Add the figures at a time [s since 1970]; a time before the last one's is left out."""
        rate, points = self._rate(figures.seconds, figures.rate * figures.seconds), self._points
        if points and at < points[-1][0]:
            return
        if len(points) > 1 and at - points[-2][0] < self._step:
            points.pop()
        points.append((at, rate, figures.evaluations, figures.successes, figures.cells))
        if len(points) > MAX_POINTS:
            *kept, last = points
            self._points, self._step = [*kept[::2], last], 2 * (last[0] - kept[0][0]) / MAX_POINTS

    @property
    def series(self) -> Series:
        """The series so far; its columns have the order of a point's values."""
        names = Series.__struct_fields__
        columns = [list(column) for column in zip(*self._points, strict=True)]
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


WORKER_STATES = ("gone", "stuck", "leaving", "working", "idle")  # Those in trouble first


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
    workers: list[WorkerStatus]  # Each once, those in trouble first: see `WORKER_STATES`
    events: list[JobEvent]  # The latest, eldest first
    history: Series  # Figures of the job during the watch


def end_state(figures: JobStatus | None) -> str:
    """Return "ended" or "cancelled" where these are the last figures of a job; else empty."""
    if figures is None:
        return ""
    if figures.runs_done + figures.runs_failed >= figures.runs > 0:
        return "ended"
    return "cancelled" if figures.state == "cancelled" else ""


CountedStatus = TypeVar("CountedStatus", RunStatus, JobStatus)

COUNTS = frozenset({*TOTAL_NAMES, "rows", "outcomes"})
"""Fields that only grow while a job goes on: numbers, or numbers by name; jobs lack some."""
SILENCE_SECONDS = 5.0  # seconds without a message until a coordinator is silent; it publishes twice a second
LATE_MESSAGE_SECONDS = 1.0  # seconds by which a message may come after the end of its coordinator's token
RETRY_SECONDS = 5.0  # seconds until a query without an answer is repeated
MOST_RUNS = 256  # The most runs kept of a job: those in progress first, then those with the latest messages
MOST_WORKERS = 512  # The most workers of a job that are shown, those in trouble first; all are counted
MAX_JOBS = 64  # The most jobs that are kept: those with the latest messages
ALL_KEYS = ""  # Stands for all jobs


def with_monotonic_counts(now: CountedStatus, before: CountedStatus | None) -> CountedStatus:
    """Return the figures now, with no count below that of before; `remaining` falls with them."""
    if before is None:
        return now
    names = COUNTS.intersection(now.__struct_fields__)
    counts = {name: _greater(getattr(before, name), getattr(now, name)) for name in names}
    if isinstance(now, JobStatus):
        counts["remaining"] = max(0, now.remaining - (counts["evaluations"] - now.evaluations))
    return structs.replace(now, **counts)


def _greater(before: Any, now: Any) -> Any:
    if isinstance(now, Mapping):
        return {name: max(before.get(name, 0), count) for name, count in now.items()}
    return max(before, now)


def continues_job(before: JobMeta, now: JobMeta) -> bool:
    """Return whether it is the same coordinator, or one that goes on with the same job.

    Where a job has no identity, the epochs decide: they are counted.
    """
    if before.identity and now.identity:
        return before.identity == now.identity
    return now.since == before.since or not now.epoch or now.epoch > before.epoch


class JobModel:
    """One job; `receive` takes the messages of its coordinator, `view` shows the result."""

    def __init__(self, name: str) -> None:
        self.keys = Keys(name)
        self.name = name
        self.meta: JobMeta | None = None
        self.figures: JobStatus | None = None
        self.received_at = 0.0  # Time of its latest message [s since 1970]
        self._epoch_meta: JobMeta | None = None  # the latest that says which job it goes on with
        self._published: JobStatus | None = None
        self._events: dict[tuple[float, int], JobEvent] = {}
        self._gone_at: float | None = None
        self._coordinators: set[str] = set()  # keys of their tokens
        self._reset()

    def _reset(self) -> None:
        self._floor: JobStatus | None = None  # counts do not fall below these
        self._runs: dict[str, RunStatus] = {}
        self._runs_heard: dict[str, float] = {}  # times of their latest messages
        self._pages: dict[int, list[job_status.WorkerStatus]] = {}
        self._history = SeriesBuilder()

    # Messages

    def receive(self, key: str, payload: bytes, now: float) -> None:
        """Take a message, or an answer; one that cannot be read is no coordinator's of this version."""
        for pattern, kind, take in self._handlers(last_chunk(key)):
            if key == pattern:
                with suppress(MessageError):
                    take(job_status.from_json(payload, kind), now)
                    self.received_at = max(self.received_at, now)
                return

    def coordinator_changed(self, key: str, alive: bool, now: float, *, is_linked: bool = True) -> None:
        """Take that a coordinator's token appeared or ended; without a link all seem to end."""
        (self._coordinators.add if alive else self._coordinators.discard)(key)
        if alive:
            self._gone_at, self.received_at = None, now
        elif is_linked and not self._coordinators:
            self._gone_at = now

    def link_lost(self, now: float) -> None:
        """Take the news that the router is away: tokens that ended just before may be alive."""
        if self._gone_at is not None and now <= self._gone_at + LATE_MESSAGE_SECONDS:
            self._gone_at = None

    def _handlers(self, last: str) -> Iterator[tuple[str, type[Struct], Callable[..., None]]]:
        """Yield each key that ends in `last`, with the kind of its messages and their handler."""
        keys = self.keys
        yield keys.stat("job"), JobStatus, self._take_figures
        yield keys.stat(f"run/{last}"), RunStatus, self._take_run
        yield keys.stat(f"team/{last}"), job_status.WorkersPage, self._take_workers
        yield keys.meta, JobMeta, self._take_meta
        yield keys.recent, job_status.JobEvents, self._take_events
        yield keys.event(last), JobEvent, self._take_event

    def _take_meta(self, meta: JobMeta, now: float) -> None:
        if self._epoch_meta and not continues_job(self._epoch_meta, meta):  # another job of the same name
            self._reset()
            self.figures = self._published
            self._events = {key: event for key, event in self._events.items() if event.at >= meta.since}
        self.meta = meta
        self._epoch_meta = meta if meta.epoch else self._epoch_meta or meta

    def _take_figures(self, figures: JobStatus, now: float) -> None:
        if self._gone_at is not None and now > self._gone_at + LATE_MESSAGE_SECONDS:
            self._gone_at = None  # another coordinator starts, and has no token yet
        self._published = figures
        self._floor = self.figures = with_monotonic_counts(
            figures, None if end_state(figures) else self._floor
        )
        self._history.add(self.figures, now)

    def _take_run(self, figures: RunStatus, now: float) -> None:
        is_last = figures.finished or end_state(self._published)
        before = None if is_last else self._runs.get(figures.run)
        self._runs[figures.run], self._runs_heard[figures.run] = with_monotonic_counts(figures, before), now
        while len(self._runs) > MOST_RUNS:
            dropped = min(self._runs, key=lambda run: (not self._runs[run].finished, self._runs_heard[run]))
            del self._runs[dropped], self._runs_heard[dropped]

    def _take_workers(self, page: job_status.WorkersPage, now: float) -> None:
        pages = self._pages | {page.page: page.workers}
        self._pages = {number: pages[number] for number in sorted(pages) if 0 <= number < page.pages}

    def _take_events(self, events: job_status.JobEvents, now: float) -> None:
        for event in events.events:
            self._take_event(event, now)

    def _take_event(self, event: JobEvent, now: float) -> None:
        self._events[event.at.timestamp(), event.number] = event
        for old in sorted(self._events)[: -job_status.EVENTS_KEPT]:
            del self._events[old]

    # Queries and views

    @property
    def is_known(self) -> bool:
        """True once enough is known to show it."""
        return self.meta is not None and self.figures is not None

    @property
    def _workers(self) -> Iterable[WorkerStatus]:
        """Each worker once: on its way to another page one may stand on both."""
        return {each.wid: each for page in self._pages.values() for each in page}.values()

    def state(self, now: float, *, is_linked: bool = True) -> str:
        """Return the state of the job as `JobView` names it."""
        if self.figures and self._gone_at is None and now - self.received_at <= SILENCE_SECONDS:
            return self.figures.state
        is_gone = self._gone_at is not None or (is_linked and not self._coordinators)
        return end_state(self.figures) or ("gone" if is_gone else "silent")

    def view(self, now: float, *, is_linked: bool = True) -> JobView | None:
        """Return the job as it is shown; None while too little is known.

        `is_linked` is True where the router can be reached, and could for a while.
        """
        if self.meta is None or self.figures is None:
            return None
        ranks = {state: rank for rank, state in enumerate(WORKER_STATES)}
        return JobView(
            job=self.name,
            state=self.state(now, is_linked=is_linked),
            silent=max(0.0, now - self.received_at),
            meta=self.meta,
            figures=self.figures,
            runs=list(self._runs.values()),
            workers=sorted(self._workers, key=lambda each: (ranks.get(each.state, 0), each.host, each.pid)),
            events=[self._events[key] for key in sorted(self._events)],
            history=self._history.series,
        )


class JobModels:
    """All jobs from which messages came; with keys, only the job of these is queried."""

    def __init__(self, keys: Keys | None = None) -> None:
        self._keys = keys or AnyJob()
        self.is_linked = True  # False while the router cannot be reached
        self._linked_at = 0.0
        self._jobs: dict[str, JobModel] = {}
        self._due: dict[str, float] = {ALL_KEYS: 0.0}  # when to query a job

    def receive(self, key: str, payload: bytes, now: float) -> None:
        """Take a message; keys of other programs are ignored."""
        if job := self._job(key):
            job.receive(key, payload, now)
            if not job.is_known:
                self._due.setdefault(job.name, now)

    def receive_answers(self, values: Mapping[str, bytes], now: float) -> None:
        """Take answers by their keys, identities of jobs first."""
        for key in sorted(values, key=lambda key: not matches(AnyJob().meta, key)):
            if job := self._job(key):
                job.receive(key, values[key], now)
        known = {job.name for job in self._jobs.values() if job.is_known}
        self._due = {name: at for name, at in self._due.items() if at <= now or name not in known}

    def coordinator_changed(self, key: str, alive: bool, now: float) -> None:
        """Take the news that a coordinator's token appeared or ended."""
        if matches(AnyJob().coordinator_token(), key) and (job := self._job(key)):
            if alive:
                self._due[job.name] = now
            job.coordinator_changed(key, alive, now, is_linked=self.is_linked)

    def link_changed(self, is_linked: bool, now: float) -> None:
        """Take the news that the router can be reached, or cannot."""
        self.is_linked = is_linked
        if is_linked:
            self._linked_at = self._due[ALL_KEYS] = now
            return
        for job in self._jobs.values():
            job.link_lost(now)

    def due_queries(self, now: float) -> list[str]:
        """Return patterns to query: all at first and with a new link, a job when it begins."""
        if not self.is_linked:
            return []
        due = {name for name, at in self._due.items() if at <= now}
        unknown = {name for name, job in self._jobs.items() if not job.is_known and due & {name, ALL_KEYS}}
        self._due = {name: at for name, at in self._due.items() if name not in due}
        self._due |= dict.fromkeys(unknown, now + RETRY_SECONDS)
        queried: list[Keys] = [self._keys] if ALL_KEYS in due else [Keys(name) for name in sorted(due)]
        return [key for one in queried for key in (one.stat(), one.meta, one.recent)]

    def views(self, now: float) -> list[JobView]:
        """Return the jobs of which enough is known, by their names."""
        is_linked = self.is_linked and now > self._linked_at + SILENCE_SECONDS
        views = [self._jobs[name].view(now, is_linked=is_linked) for name in sorted(self._jobs)]
        return [view for view in views if view is not None]

    def _job(self, key: str) -> JobModel | None:
        """Return the model of a key's job; a new one replaces the longest silent at `MAX_JOBS`."""
        name = job_of(key)
        if name is None:
            return None
        if name not in self._jobs:
            if len(self._jobs) >= MAX_JOBS:
                del self._jobs[min(self._jobs, key=lambda name: self._jobs[name].received_at)]
            self._jobs[name] = JobModel(name)
        return self._jobs[name]
