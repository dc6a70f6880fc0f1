"""Published status of a job, its runs, workers and events; each struct travels as JSON.

Defined once, published about once a second (docs/bus.md), shown by every monitor.
"""

from collections.abc import Callable
from datetime import UTC, datetime
from functools import cache
from typing import Annotated, Literal, TypeVar, get_type_hints

import msgspec
from msgspec import Meta, Struct, field, structs

from qdgrasp_coordinator.metrics.run_stats import GrowthCurve, RunCounter, RunTotals
from qdgrasp_protocol.errors import MessageError
from qdgrasp_protocol.messages import shorten
from qdgrasp_protocol.text import counted, rough_time

RUNS_PER_PAGE = 256  # The most entries in one answer


class RunListing(RunTotals, frozen=True, kw_only=True):
    """Identity of a run, and what its rows add up to: in progress, or in a job's folder."""

    run: Annotated[str, "Its name in its job."]
    gripper: Annotated[str, "As the spec names it: built in, or a file."]
    object: Annotated[str, "As the spec names it: built in, on the asset path, or a file."]
    method: Annotated[str, "The search with its prior."]
    protocol: Annotated[str, "The evaluation protocol."]
    seed: Annotated[int, "Of the search."]
    scene: Annotated[str, "sha256 of the scene bundle."]
    budget: Annotated[int, "Counted evaluations after which it is over."]
    rows: Annotated[int, "Journal rows: genomes and trials."]
    outcomes: Annotated[
        dict[str, int],
        "Genomes by how their nominal evaluation ended: each `Outcome` by its name in lower case.",
    ]
    finished: Annotated[str, "Why the run is over, in words; empty while it is not."] = ""

    @classmethod
    def of(cls, run: str, scene: str, counter: RunCounter) -> "RunListing":
        """Return the listing of a run from its name, its scene and the counter of its rows."""
        spec = counter.spec
        return RunListing(
            **structs.asdict(counter.totals),
            **{name: getattr(spec, name) for name in ("gripper", "object", "method", "seed")},
            run=run,
            protocol=spec.protocol_words,
            scene=scene,
            budget=spec.evaluations,
            rows=counter.rows,
            outcomes=counter.outcomes,
            finished=counter.finished or "",
        )


class RunListings(Struct, frozen=True, kw_only=True):
    """Runs in a job's folder, also finished ones, by name. JSON, the answer on `rec/runs`."""

    runs: Annotated[list[RunListing], "Those whose rows are counted."]
    next: Annotated[int, "Ask with `from=<next>` for the runs behind these; 0: there are none."] = 0
    uncounted: Annotated[
        int, "Runs left out because their rows are still being counted: ask again in a while."
    ] = 0
    curve: Annotated[
        GrowthCurve | None,
        (
            "How the one run grew that was asked for; "
            "None where all were, or where its rows are not all there."
        ),
    ] = None


OBJECTS_PER_PAGE = 256  # The most objects in one answer
MOST_NAMES = 32  # The most runs that are named of an object
ObjectState = Literal["waiting", "building", "running", "done", "failed", "skipped"]
"""State of an object; a "skipped" one was left out before the campaign began."""


class ObjectListing(RunTotals, frozen=True, kw_only=True):
    """An object of a campaign, and what the rows of its runs add up to."""

    object: Annotated[str, "Its id in its library; elsewhere as specs name it."]
    file: Annotated[str, "As specs name it: built in, on the asset path, or a file."]
    category: Annotated[str, "As its library has it; empty: not said."] = ""
    hands: Annotated[list[str], "Grippers of its runs."] = field(default_factory=list)
    regions: Annotated[str, "Where its runs may touch it, and where not, in words; empty: anywhere."] = ""
    names: Annotated[list[str], "Its runs by name, those that have begun first; at most 32."] = field(
        default_factory=list
    )
    runs: Annotated[int, "Its runs, begun or not."] = 0
    runs_done: Annotated[int, "Those that are finished."] = 0
    runs_failed: Annotated[int, "Those that cannot be carried out."] = 0
    state: Annotated[
        ObjectState,
        (
            '"waiting", "building" (its shape), "running", "done", "failed" (all of its runs) or "skipped" '
            "(left out, as it cannot be used)."
        ),
    ] = "waiting"
    little: Annotated[
        str, "Why it got no grasp, or few beside the median object, in words; empty where it did not."
    ] = ""
    warnings: Annotated[
        list[str], "Reasons why its results are worse, or why it failed or was left out, in words."
    ] = field(default_factory=list)

    @property
    def success_share(self) -> float:
        """Successes over evaluations, 0 to 1."""
        return self.successes / self.evaluations if self.evaluations else 0.0

    @property
    def note(self) -> str:
        """All that is said about it, in words."""
        return "; ".join([self.little, *self.warnings] if self.little else self.warnings)


class ObjectListings(Struct, frozen=True, kw_only=True):
    """Objects of a campaign, in the order of its runs. JSON, the answer on `rec/objects`."""

    objects: Annotated[list[ObjectListing], "At most 256 of them."]
    next: Annotated[int, "Ask with `from=<next>` for the objects behind these; 0: there are none."] = 0
    uncounted: Annotated[int, "Runs whose rows are still being counted: ask again in a while."] = 0


EVENTS_KEPT = 200  # Events that a coordinator keeps for late subscribers

EventKind = Literal["job", "run", "worker", "recorder", "warning", "trouble", "error"]


class JobEvent(Struct, frozen=True, kw_only=True):
    """Something that happened. Travels as JSON on `event/<kind>`."""

    number: Annotated[int, "Counts the events of one coordinator process, from 1."]
    at: Annotated[datetime, Meta(tz=True), "When."]
    kind: Annotated[
        EventKind,
        (
            "job, run, worker, recorder; warning makes results worse, as a coarse shape does; trouble: "
            "a job, or a worker, does not go on; error: a row, a run or an object is given up."
        ),
    ]
    words: Annotated[str, "What, in a sentence for a person."]
    run: Annotated[str, "Which run it is about; empty: none."] = ""
    worker: Annotated[str, "Which worker (its `wid`) it is about; empty: none."] = ""
    object: Annotated[str, "Which object it is about, as specs name it; empty: none."] = ""


class JobEvents(Struct, frozen=True, kw_only=True):
    """Latest events, eldest first, at most `EVENTS_KEPT`. JSON, the answer to `event/recent`."""

    events: Annotated[list[JobEvent], "At most 200, eldest first."]


WORKERS_PER_PAGE = 64  # The most workers on one page


class WorkerStatus(Struct, frozen=True, kw_only=True):
    """A worker of a job, as the coordinator sees it."""

    wid: Annotated[str, "Its id: 32 hexadecimal digits, new at every start."]
    host: Annotated[str, "Where it runs."]
    pid: Annotated[int, "Of its process."]
    state: Annotated[
        str,
        '"working", "idle", "stuck" (it let a lease pass, or does not answer), "leaving" (it is drained) or '
        '"gone".',
    ]
    batches: Annotated[int, "Batches that it holds."]
    rows: Annotated[int, "Rows that it has settled."]
    rate: Annotated[
        float, "Rows that it settled lately: a mean in which what is 10 s ago weighs 1 / e [1/s]."
    ]
    seconds: Annotated[float, "Since it joined [s]."]
    seen: Annotated[float, "Since it was heard of last, by a sign, a result or a join [s]."]
    memory: Annotated[int, "Memory of the worker and its simulator, by its last report [bytes]; 0: none yet."]
    restarts: Annotated[int, "How often it has started its simulator again."]


class WorkersPage(Struct, frozen=True, kw_only=True):
    """A page of a job's workers, in the order of their joins. JSON on `stat/team/<page>`.

    A worker that is gone stays on it for a minute.
    """

    page: Annotated[int, "Counted from 0."]
    pages: Annotated[
        int, "How many there are; those of a higher number, shown before, are not valid any more."
    ]
    workers: Annotated[
        list[WorkerStatus],
        "At most 64, in the order in which they joined; those that are gone stand last, for a minute.",
    ]


@cache
def meanings(kind: type[Struct]) -> dict[str, str]:
    """Return the docstring of each field of a struct, of its bases too, each in one line."""
    hints = get_type_hints(kind, include_extras=True)
    noted = {field: getattr(hint, "__metadata__", ()) for field, hint in hints.items()}
    words = ((field, getattr(note, "description", note)) for field, notes in noted.items() for note in notes)
    return {field: text for field, text in words if isinstance(text, str)}


GREATEST_COUNT = 2**63  # Greatest number allowed in a published struct
LONGEST_WAIT = 1e10  # seconds; longer times are not shown
SLOW_RATE = 9.5  # Evaluations a second below which a tenth of one is told
STARTUP_SECONDS = 30.0  # seconds in which a job that has no recorder yet is taken to be starting


class TimedProgress:
    """Share and time of a run or job."""

    __slots__ = ()
    evaluations: int
    trials: int
    trials_left: int
    rate: float

    @property
    def remaining(self) -> int:
        """Counted evaluations that it may still take."""
        raise NotImplementedError

    @property
    def seconds_left(self) -> float | None:
        """Time that it still takes at the speed so far [s]; None: not known."""
        return self.remaining / self.rate if self.rate > 0 and not self.trials_left else None

    @property
    def done(self) -> float:
        """Share of it that is done, 0 to 1, with trials; what ended early has nothing left."""
        done = self.evaluations + self.trials
        return done / (done + self.remaining + self.trials_left) if done else 0.0

    @property
    def left(self) -> str:
        """The time left in words."""
        if not self.remaining + self.trials_left:
            return "nothing left"
        seconds = self.seconds_left
        if seconds is None or seconds > LONGEST_WAIT:
            return "time left not known yet"
        return f"about {rough_time(seconds)} left"


class RunStatus(RunListing, TimedProgress, frozen=True, kw_only=True):
    """Progress of a run. Travels as JSON on `stat/run/<run>`."""

    workers: Annotated[int, "Workers of the job that are there, and make progress."]
    durable: Annotated[int, "Rows that the recorder reports to be on disk."]
    seconds: Annotated[float, "Since the coordinator opened the run [s]."]
    rate: Annotated[float, "Counted evaluations since then, replayed ones apart [1/s]."]
    trials_left: Annotated[int, "Trials of its successes so far that are to come."] = 0
    trouble: Annotated[str, "The reason why the run does not go on, in words; empty while it does."] = ""

    @property
    def remaining(self) -> int:
        """Counted evaluations that it may still take; 0 once it is over."""
        return 0 if self.finished else max(0, self.budget - self.evaluations)


class JobStatus(RunTotals, TimedProgress, frozen=True, kw_only=True):
    """Progress of a job with all of its runs. Travels as JSON on `stat/job`."""

    job: Annotated[str, "Its name."]
    runs: Annotated[int, "Of the job, begun or not."]
    runs_done: Annotated[int, "Finished and recorded, also by earlier coordinators."]
    runs_failed: Annotated[int, "Which cannot be carried out."]
    runs_open: Annotated[int, "In progress."]
    budget: Annotated[int, "Counted evaluations after which all runs are over."]
    remaining: Annotated[
        int,
        ("Counted evaluations that runs which are not over may still take; those that end early take fewer."),
    ]
    trials_left: Annotated[int, "Trials of the successes so far that are to come."] = 0
    waiting: Annotated[
        int, "Settled rows that are not known to be on disk: how far the recorder is behind."
    ] = 0
    requeued: Annotated[
        int, "Batches that were queued again, as their worker was lost, in this epoch of the coordinator."
    ] = 0
    doubled: Annotated[
        int,
        "Batches that were leased to a second worker, as the first has held them for long, in this epoch.",
    ] = 0
    strays: Annotated[
        int,
        "Results that were dropped in this epoch: late, duplicate, unknown, or of another worker's batch.",
    ] = 0
    workers: Annotated[int, "Workers that are there, and make progress."]
    wanted_workers: Annotated[
        int,
        "Workers that the rows and builds which are queued or leased now could keep busy, one for each "
        "batch of a quarter of a second; 0 when none is. Those queued do not count while paused.",
    ] = 0
    seconds: Annotated[float, "Since the coordinator started [s]."]
    rate: Annotated[float, "Counted evaluations since then, replayed ones apart [1/s]."]
    trouble: Annotated[str, "The reason why the job does not go on, in words; empty while it does."] = ""
    state: Annotated[
        str,
        ('"starting" (no recorder has answered yet), "running", "paused", "ending", or at last "cancelled".'),
    ] = "running"
    recorders: Annotated[int, "Recorders of this job that are there."] = 0
    scenes: Annotated[int, "Shapes of objects that the job needs and that must be built."] = 0
    scenes_done: Annotated[int, "Of these, shapes that are built."] = 0
    scenes_failed: Annotated[int, "Of these, shapes that cannot be built; their runs fail."] = 0
    scenes_seconds: Annotated[float, "CPU time spent on building them [s]."] = 0.0
    building: Annotated[
        list[str], "Objects whose shapes are being built, as specs name them; at most 8 of them."
    ] = field(default_factory=list)
    seconds_left: Annotated[
        float | None, "About how long the rest takes, rows and shapes [s]; None: not known."
    ] = None
    doing: Annotated[str, "The job's present work while no rows come in, in words; empty while they do."] = ""

    @property
    def words(self) -> str:
        """One line for a person."""
        failed = f" and {self.runs_failed} failed" if self.runs_failed else ""
        runs = f"{self.runs_done} of {self.runs} runs{failed}, " if self.runs > 1 else ""
        shapes = f"{self.shapes}, " if self.scenes else ""
        done = f"{shapes}{runs}{self.evaluations} of {counted(self.budget, 'evaluation')}"
        if self.obstacle:
            return f"{done}, paused: {self.obstacle}"
        if self.state == "starting":
            return f"{done}, starting" + (f", {self.doing}" if self.doing else "")
        if self.state == "paused":
            return f"{done}, paused until `qdgrasp continue {self.job}`"
        if not self.rate and (self.doing or not self.workers):
            return f"{done}, {self.doing or 'no worker yet'}"
        doing = f"{self.doing}, " if self.doing else ""
        of = f"{self.trials} of " if self.trials_left else ""
        all_trials = self.trials + self.trials_left
        trials = f"{of}{counted(all_trials, 'trial')}, " if all_trials else ""
        workers = counted(self.workers, "worker")
        speed = f"{self.rate:.{0 if self.rate >= SLOW_RATE else 1}f}/s"
        return f"{done}, {doing}{speed}, {self.found}, {self.screened}, {trials}{workers}"

    @property
    def shapes(self) -> str:
        """Number of the shapes that are built, in words."""
        failed = f" and {self.scenes_failed} failed" if self.scenes_failed else ""
        return f"{self.scenes_done} of {counted(self.scenes, 'shape')}{failed}"

    @property
    def obstacle(self) -> str:
        """The trouble; empty at first, while a recorder may still be starting."""
        return "" if self.state == "starting" and self.seconds < STARTUP_SECONDS else self.trouble


class JobMeta(Struct, frozen=True, kw_only=True):
    """Identity of a job and its coordinator. JSON on `meta` when a coordinator's epoch begins."""

    job: Annotated[str, "Its name."]
    epoch: Annotated[
        int, "The number of the coordinator in the life of its job; 0: no recorder has answered yet."
    ]
    since: Annotated[datetime, Meta(tz=True), "When this coordinator started."]
    host: Annotated[str, "The coordinator's."]
    pid: Annotated[int, "Of the coordinator's process."]
    version: Annotated[str, "Of qdgrasp."]
    runs: Annotated[int, "Of the job, begun or not."]
    budget: Annotated[int, "Counted evaluations after which all runs are over."]
    identity: Annotated[
        str, "Identity that tells the job from another one of its name; empty: not known."
    ] = ""


Kind = TypeVar("Kind", bound=Struct)


def to_json(shown: Struct) -> bytes:
    """Encode a published struct as JSON, readable with any zenoh tool."""
    return msgspec.json.encode(shown)


def from_json(payload: bytes, kind: type[Kind]) -> Kind:
    """Decode a published struct; raise `MessageError` for other JSON, or numbers beyond bounds."""
    try:
        shown = msgspec.json.decode(payload, type=kind)
    except (msgspec.MsgspecError, ValueError, RecursionError) as error:  # ValueError: text that is not UTF-8
        raise MessageError(f"not figures: {error}") from None
    if not _are_counts(shown):
        raise MessageError("not figures: a number is negative, or beyond all bounds")
    return shown


def _are_counts(value: object) -> bool:
    """Return whether all numbers in a published value are between 0 and `GREATEST_COUNT`."""
    match value:
        case int() | float():
            return 0 <= value <= GREATEST_COUNT
        case Struct():
            return all(_are_counts(getattr(value, name)) for name in value.__struct_fields__)
        case list():
            return all(map(_are_counts, value))
        case dict():
            return all(map(_are_counts, value.values()))
    return True


class EventLog:
    """Numbers events, keeps the latest, and shows each as it happens."""

    def __init__(self, show: Callable[[JobEvent], None] = lambda _event: None) -> None:
        self._show = show
        self._latest: tuple[JobEvent, ...] = ()
        self._count = 0

    def note(
        self, kind: EventKind, words: str, *, run: str = "", worker: str = "", object_: str = ""
    ) -> None:
        """Add an event: a sentence, and the run, worker or object that it is about, if any."""
        self._count += 1
        subject = {"run": run, "worker": worker, "object": object_}
        event = JobEvent(number=self._count, at=datetime.now(UTC), kind=kind, words=shorten(words), **subject)
        self._latest = (*self._latest[1 - EVENTS_KEPT :], event)
        self._show(event)

    @property
    def latest(self) -> JobEvents:
        """The latest events."""
        return JobEvents(events=list(self._latest))
