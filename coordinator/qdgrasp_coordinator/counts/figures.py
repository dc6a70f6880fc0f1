"""The figures of a running search: defined once, published about once a second, shown by whoever listens."""

from datetime import datetime
from typing import Annotated, TypeVar

import msgspec
from msgspec import Meta, Struct

from qdgrasp_coordinator.counts.entry import RunEntry
from qdgrasp_coordinator.counts.totals import Totals
from qdgrasp_protocol.errors import MessageError
from qdgrasp_protocol.phrases import counted

MOST = 2**63
"""The most that any number in what is shown may be."""
FOREVER = 1e10  # seconds that nobody waits for
PATIENCE = 30.0  # seconds in which a job that has no recorder yet is taken to be starting


class Figures(RunEntry, frozen=True, kw_only=True):
    """How far a run in progress is. Travels as JSON on `stat/run/<run>`."""

    workers: Annotated[int, Meta(description="Workers of the job that are there, and make progress.")]
    durable: Annotated[int, Meta(description="Rows that the recorder reports to be on disk.")]
    seconds: Annotated[float, Meta(description="Since the coordinator opened the run [s].")]
    rate: Annotated[float, Meta(description="Counted evaluations since then, replayed ones apart [1/s].")]
    trouble: Annotated[
        str, Meta(description="What keeps the run from going on, in words; empty when nothing does.")
    ] = ""

    @property
    def remaining(self) -> int:
        """Counted evaluations that it may still take; none once it is over."""
        return 0 if self.finished else max(0, self.budget - self.evaluations)

    @property
    def done(self) -> float:
        """How far it is, 0 to 1."""
        return _done(self.evaluations, self.remaining)

    @property
    def left(self) -> str:
        """The time left in words, at the speed so far."""
        return _left(self.remaining, self.rate)


class JobFigures(Totals, frozen=True, kw_only=True):
    """How far a job is with all of its runs. Travels as JSON on `stat/job`."""

    job: Annotated[str, Meta(description="Its name.")]
    runs: Annotated[int, Meta(description="Of the job, begun or not.")]
    runs_done: Annotated[int, Meta(description="Finished and recorded, also by earlier coordinators.")]
    runs_failed: Annotated[int, Meta(description="Which cannot be carried out.")]
    runs_open: Annotated[int, Meta(description="In progress.")]
    budget: Annotated[int, Meta(description="Counted evaluations after which all runs are over.")]
    remaining: Annotated[
        int,
        Meta(
            description="Counted evaluations that runs which are not over may still take; "
            "those that end early take fewer."
        ),
    ]
    waiting: Annotated[
        int,
        Meta(description="Settled rows that are not known to be on disk: how far the recorder is behind."),
    ] = 0
    requeued: Annotated[
        int,
        Meta(
            description="Batches that were queued again, as their worker was lost, "
            "in this coordinator's turn."
        ),
    ] = 0
    strays: Annotated[
        int,
        Meta(
            description="Results that were dropped in this turn: "
            "late, duplicate, unknown, or of somebody else's batch."
        ),
    ] = 0
    workers: Annotated[int, Meta(description="Workers that are there, and make progress.")]
    seconds: Annotated[float, Meta(description="Since the coordinator started [s].")]
    rate: Annotated[float, Meta(description="Counted evaluations since then, replayed ones apart [1/s].")]
    trouble: Annotated[
        str, Meta(description="What keeps the job from going on, in words; empty when nothing does.")
    ] = ""
    state: Annotated[
        str,
        Meta(
            description='"starting" (no recorder has answered yet), "running", "paused", "ending", '
            'or at last "cancelled".'
        ),
    ] = "running"
    recorders: Annotated[int, Meta(description="Recorders of this job that are there.")] = 0

    @property
    def words(self) -> str:
        """One line for a person."""
        failed = f" and {self.runs_failed} failed" if self.runs_failed else ""
        runs = f"{self.runs_done} of {self.runs} runs{failed}, " if self.runs > 1 else ""
        done = f"{runs}{self.evaluations} of {counted(self.budget, 'evaluation')}"
        if self.obstacle:
            return f"{done}, paused: {self.obstacle}"
        if self.state == "starting":
            return f"{done}, starting"
        if self.state == "paused":
            return f"{done}, paused until `qdgrasp continue {self.job}`"
        if not self.workers and not self.rate:
            return f"{done}, no worker yet"
        trials = f"{counted(self.trials, 'trial')}, " if self.trials else ""
        workers = counted(self.workers, "worker")
        return f"{done}, {self.rate:.0f}/s, {self.found}, {self.screened}, {trials}{workers}"

    @property
    def obstacle(self) -> str:
        """The trouble; none at first, while a recorder may still be on its way."""
        return "" if self.state == "starting" and self.seconds < PATIENCE else self.trouble

    @property
    def done(self) -> float:
        """How far it is, 0 to 1: runs that ended early, or failed, have nothing left."""
        return _done(self.evaluations, self.remaining)

    @property
    def left(self) -> str:
        """The time left in words, at the speed so far."""
        return _left(self.remaining, self.rate)


class JobMeta(Struct, frozen=True, kw_only=True):
    """What a job is and who carries it out. Travels as JSON on `meta` when a coordinator begins its turn."""

    job: Annotated[str, Meta(description="Its name.")]
    epoch: Annotated[
        int, Meta(description="The coordinator's turn; 0 before it has one: no recorder has answered yet.")
    ]
    since: Annotated[datetime, Meta(tz=True, description="When this coordinator started.")]
    host: Annotated[str, Meta(description="The coordinator's.")]
    pid: Annotated[int, Meta(description="Of the coordinator's process.")]
    version: Annotated[str, Meta(description="Of qdgrasp.")]
    runs: Annotated[int, Meta(description="Of the job, begun or not.")]
    budget: Annotated[int, Meta(description="Counted evaluations after which all runs are over.")]
    identity: Annotated[
        str, Meta(description="What tells the job from another one of its name; empty: it is not known.")
    ] = ""


def _done(evaluations: int, remaining: int) -> float:
    """The share of what is behind in all that there is."""
    return evaluations / (evaluations + remaining) if evaluations else 0.0


def _left(evaluations: int, rate: float) -> str:
    """The time that so many evaluations take at so many per second, in words."""
    if rate <= 0 or evaluations / rate > FOREVER:
        return "time left unknown"
    seconds = round(evaluations / rate)
    hours, seconds = divmod(seconds, 3600)
    return (f"{hours}:" if hours else "") + f"{seconds // 60:02d}:{seconds % 60:02d} left"


Kind = TypeVar("Kind", bound=Struct)


def to_json(shown: Struct) -> bytes:
    """What is shown as JSON, readable with any zenoh tool."""
    return msgspec.json.encode(shown)


def from_json(payload: bytes, kind: type[Kind]) -> Kind:
    """What is shown in a message.

    Raises
    ------
    MessageError
        The payload is not such JSON, or holds a number that is no count.
    """
    try:
        shown = msgspec.json.decode(payload, type=kind)
    except (msgspec.MsgspecError, ValueError, RecursionError) as error:  # ValueError: text that is not UTF-8
        raise MessageError(f"not figures: {error}") from None
    if not _counts(shown):
        raise MessageError("not figures: a number is negative, or beyond all bounds")
    return shown


def _counts(value: object) -> bool:
    """Whether all numbers in what is shown are between 0 and `MOST`."""
    match value:
        case int() | float():
            return 0 <= value <= MOST
        case Struct():
            return all(_counts(getattr(value, name)) for name in value.__struct_fields__)
        case list():
            return all(map(_counts, value))
        case dict():
            return all(map(_counts, value.values()))
    return True
