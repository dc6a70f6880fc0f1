"""What travels on the bus: flat frozen structs, one per kind of message.

Field names are the wire's names. Arrays travel as one little-endian blob each (`rows`): messages that
carry rows hold them in `columns`, by the names of `rows.COLUMNS`.
"""

from typing import Annotated, ClassVar, Literal

from msgspec import Meta, Struct

VERSION = 1
"""The version of the protocol that this package speaks."""

Wid = Annotated[str, Meta(pattern=r"\A[0-9a-f]{32}\Z")]
"""A worker process: 128 random bits, new at every start."""
Digest = Annotated[str, Meta(pattern=r"\A[0-9a-f]{64}\Z")]
Name = Annotated[str, Meta(pattern=r"\A[a-z0-9_-]{1,64}\Z")]
BatchId = Annotated[bytes, Meta(min_length=16, max_length=16)]
Count = Annotated[int, Meta(ge=0, le=2**63 - 1)]
RowCount = Annotated[int, Meta(ge=1, le=4096)]
Width = Annotated[int, Meta(ge=0, le=256)]
Number = Annotated[float, Meta(ge=0, le=1e12)]
"""Finite and not negative."""

JobId = Annotated[str, Meta(max_length=32)]
"""What tells a job from another one of its name: random, made with its folder; empty: not known."""
Text = Annotated[str, Meta(max_length=200)]
"""Words for a person; made with `short`."""


def short(text: str) -> str:
    """Text cut to what a message may carry: 200 bytes of UTF-8."""
    return text.encode(errors="replace")[:200].decode(errors="ignore")


class Message(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The root of all messages. Each kind has a name on the wire, which stays when the class gets another."""

    wire_name: ClassVar[str]
    """What the encoding of this kind of message is called by."""

    v: Annotated[int, Meta(ge=1, le=VERSION)] = VERSION


class Work(Message, frozen=True, kw_only=True):
    """Coordinator to worker: a leased batch, rows of one generation of one run."""

    wire_name = "work"

    epoch: Count
    run: Name
    scene: Digest
    prior: Annotated[str, Meta(pattern=r"\A[a-z_]{1,32}\Z")]
    generation: Count
    batch: BatchId
    attempt: Count
    join: Count
    """The worker's join number that this lease belongs to (the join fence)."""
    n: RowCount
    genes: Width
    columns: dict[str, bytes]
    """`index`, `trial` and `genome`."""


class Failure(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A row of a batch on which the simulator failed."""

    row: Count
    """Its place in the batch."""
    reason: Text


class Result(Message, frozen=True, kw_only=True):
    """Worker to coordinator: what a batch found."""

    wire_name = "result"

    epoch: Count
    run: Name
    generation: Count
    batch: BatchId
    attempt: Count
    wid: Wid
    n: RowCount
    joints: Width
    descriptors: Width
    columns: dict[str, bytes]
    """All of `rows.RESULT`; rows named in `failures` hold zeros."""
    cpu_seconds: Number
    failures: list[Failure] = []


class Join(Message, frozen=True, kw_only=True):
    """Worker to coordinator, query: serve this job."""

    wire_name = "join"

    versions: list[Count]
    wid: Wid
    number: Count
    """Counts this worker's joins; the coordinator forgets what older ones were leased."""
    credit: Annotated[int, Meta(ge=0, le=64)]
    """How many batches may be outstanding; 0: nothing more is to come, as the worker is about to leave."""
    held: list[BatchId]
    """Batches still held from before."""
    host: Annotated[str, Meta(pattern=r"\A[!-~]{1,255}\Z")]
    pid: Count
    platform: dict[str, str]
    """What decides the bits of a result: versions, evaluation code, digest of the probe set."""


class Joined(Message, frozen=True, kw_only=True):
    """The answer to a join."""

    wire_name = "joined"

    epoch: Count
    drop: list[BatchId]


class Control(Message, frozen=True, kw_only=True):
    """Coordinator to worker: drop batches that another worker has settled, or leave the job."""

    wire_name = "control"

    epoch: Count
    drop: list[BatchId] = []
    drain: bool = False
    """Finish the batches that are held, and leave: nothing more is leased to this worker."""


class Order(Message, frozen=True, kw_only=True):
    """Whoever administers a job to its coordinator, query: what to do with it."""

    wire_name = "order"

    act: Literal["pause", "continue", "cancel", "drain"]
    worker: Annotated[str, Meta(pattern=r"\A[0-9a-f]{0,32}\Z")] = ""
    """Whom to drain: a worker's id, or how it begins; empty: by `host`."""
    host: Text = ""
    """Whose workers to drain."""


class Done(Message, frozen=True, kw_only=True):
    """The answer to an order."""

    wire_name = "done"

    words: Text
    """What happened, in a sentence for a person."""


class Chunk(Message, frozen=True, kw_only=True):
    """The answer to one query for a piece of a scene bundle."""

    wire_name = "chunk"

    total: Annotated[int, Meta(ge=1, le=4096)]
    """How many chunks the bundle has."""
    data: bytes


class Recordable(Message, frozen=True, kw_only=True):
    """Consecutive rows of a run in journal order, settled: to the recorder, and back at replay."""

    wire_name = "recordable"

    epoch: Count
    run: Name
    first: Count
    """The number of the first row; numbers count rows of the run, across epochs."""
    n: Annotated[int, Meta(ge=0, le=4096)]
    genes: Width
    joints: Width
    descriptors: Width
    columns: dict[str, bytes]
    """All of `rows.COLUMNS`."""
    cpu_seconds: Number = 0.0
    """What these rows cost on their workers, outside the digest."""
    failures: list[Failure] = []
    """Why rows with `Outcome.ERROR` failed."""


class Recorded(Message, frozen=True, kw_only=True):
    """Recorder to coordinator: how many rows of a run are durable."""

    wire_name = "recorded"

    epoch: Count
    run: Name
    durable: Count
    trouble: Text = ""
    """Why the recorder cannot write now, in words; empty when it can."""


class OpenRun(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """One run of a job that is opened."""

    run: Name
    spec: bytes
    """The full spec as TOML."""
    scene: Digest
    genes: Width
    joints: Width
    descriptors: Width


class Open(Message, frozen=True, kw_only=True):
    """Coordinator to recorder, query: opens runs of a job."""

    wire_name = "open"

    job: Name
    runs: list[OpenRun]
    epoch: Count = 0
    """The turn that these runs join, where the coordinator has one already; 0: it begins one."""


class Opened(Message, frozen=True, kw_only=True):
    """The answer: the coordinator's epoch and the durable number of each run, in the order asked."""

    wire_name = "opened"

    epoch: Count
    durable: list[Count]
    platform: dict[str, str]
    """The platform that the recorded rows were made on; empty when there are none."""
    identity: JobId = ""
    """Of the job."""


class Platform(Message, frozen=True, kw_only=True):
    """Coordinator to recorder: the platform of this job's rows, known once the first worker joined."""

    wire_name = "platform"

    epoch: Count
    platform: dict[str, str]


class Log(Message, frozen=True, kw_only=True):
    """Query to the recorder: recorded rows of a run from number `first` on, at most `limit`."""

    wire_name = "log"

    run: Name
    first: Count
    limit: RowCount


class Finds(Message, frozen=True, kw_only=True):
    """The answer to a query on `rec/finds`: successes of a run in journal order."""

    wire_name = "finds"

    run: Annotated[Name, Meta(description="Its name in its job.")]
    scene: Annotated[Digest, Meta(description="sha256 of the run's scene bundle.")]
    began: Annotated[
        float,
        Meta(
            description="When the journal was begun [s since 1970]: "
            "another one of the same name has other rows."
        ),
    ]
    next: Annotated[Count, Meta(description="The journal number from which to ask on.")]
    rows: Annotated[
        Count,
        Meta(
            description="How many rows the journal has; with `next` there, "
            "these are all the successes so far."
        ),
    ]
    n: Annotated[int, Meta(ge=0, le=4096, description="How many finds these are.")]
    joints: Annotated[Width, Meta(description="Finger joints of the hand.")]
    columns: Annotated[
        dict[str, bytes], Meta(description="Each of `finds.COLUMNS` by its name, little-endian.")
    ]
