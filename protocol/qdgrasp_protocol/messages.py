"""Messages on the bus: flat frozen structs, and how they become bytes and messages again.

Field names are the wire's names (docs/bus.md). Arrays travel as one little-endian blob each: messages that
carry rows hold them in `columns`, by the names of `rows.COLUMNS`.

Bytes are MessagePack with hard limits, then the schema; nothing looks into what has not passed both.
"""

import hashlib
import os
import zlib
from collections.abc import Mapping
from functools import cache
from typing import Annotated, Any, ClassVar, Literal, TypeVar

import msgpack
import msgspec
from msgspec import Meta, Struct

from qdgrasp_protocol.errors import MessageError
from qdgrasp_protocol.text import printable

VERSION = 2  # The version of the protocol that this package speaks

Wid = Annotated[str, Meta(pattern=r"\A[0-9a-f]{32}\Z")]
"""Id of a worker process: 128 random bits, new at every start."""
Digest = Annotated[str, Meta(pattern=r"\A[0-9a-f]{64}\Z")]
Name = Annotated[str, Meta(pattern=r"\A[a-z0-9_-]{1,64}\Z")]
WorkerKey = Annotated[bytes, Meta(min_length=32, max_length=32)]
"""Random bytes behind a worker's id (`worker_id`); only it and coordinators see them."""
BatchId = Annotated[bytes, Meta(min_length=16, max_length=16)]
ShownKey = Annotated[bytes, Meta(max_length=32)]
"""A worker's key in its answers; empty: not shown."""
Count = Annotated[int, Meta(ge=0, le=2**63 - 1)]
RowCount = Annotated[int, Meta(ge=1, le=4096)]
Width = Annotated[int, Meta(ge=0, le=256)]
Number = Annotated[float, Meta(ge=0, le=1e12)]
"""Finite and not negative."""

JobId = Annotated[str, Meta(max_length=32)]
"""Random id of a job, made with its folder, unlike its name unique; empty: unknown."""
Text = Annotated[str, Meta(max_length=200)]
"""Text for a person; made with `shorten`."""


DEFLATED_COLUMNS = frozenset({"contact_links", "contact_points"})
"""Columns of rows that are mostly zeros: they travel deflated (zlib)."""


def deflated(columns: Mapping[str, bytes]) -> dict[str, bytes]:
    """Return columns of rows by name as they travel."""
    return {
        name: zlib.compress(blob, 1) if name in DEFLATED_COLUMNS else blob for name, blob in columns.items()
    }


def inflate(blob: bytes, most: int) -> bytes:
    """Return deflated bytes as they were; a MessageError if damaged, or more than `most`."""
    inflater = zlib.decompressobj()
    try:
        found = inflater.decompress(blob, most)
    except zlib.error as error:
        raise MessageError(f"it is damaged: {error}") from None
    if not inflater.eof:
        raise MessageError(f"it is cut short, or has more than {most} bytes")
    return found


def shorten(text: str) -> str:
    """Text cut to what a message may carry: 200 bytes of UTF-8."""
    return text.encode(errors="replace")[:200].decode(errors="ignore")


class Message(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The root of all messages."""

    wire_name: ClassVar[str]
    """Name of this kind of message in its encoding."""

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
    """Its position in the batch."""
    reason: Text


class Result(Message, frozen=True, kw_only=True):
    """Worker to coordinator: the results of a batch."""

    wire_name = "result"

    epoch: Count
    run: Name
    generation: Count
    batch: BatchId
    attempt: Count
    wid: Wid
    key: ShownKey = b""
    n: RowCount
    joints: Width
    contact_slots: Width = 0
    columns: dict[str, bytes]
    """All of `rows.RESULT`; rows named in `failures` hold zeros."""
    cpu_seconds: Number
    failures: list[Failure] = []


TRUST_VARIABLE = "QDGRASP_TRUST"  # A job's secret, which its trusted workers show to its coordinator


def worker_key(salt: bytes) -> bytes:
    """Return a worker's key from 16 random bytes; who knows the same secret recognises it."""
    return salt + hashlib.sha256(os.environ.get(TRUST_VARIABLE, "").encode() + salt).digest()[:16]


def worker_id(key: bytes) -> str:
    """Return the id of the worker that has a key; it shows in a join that the id is its own."""
    return hashlib.sha256(key).hexdigest()[:32]


class Join(Message, frozen=True, kw_only=True, omit_defaults=True):
    """Worker to coordinator, query: serve this job."""

    wire_name = "join"

    versions: list[Count]
    wid: Wid
    key: WorkerKey
    """The secret from which `wid` is derived: it shows that the id is the asking worker's own."""
    number: Count
    """Counter of this worker's joins; the coordinator drops leases of older ones."""
    credit: Annotated[int, Meta(ge=0, le=64)]
    """Most batches that may be outstanding; 0: no more, as the worker is about to leave."""
    rows: Annotated[int, Meta(ge=0, le=4096)] = 0
    """Rows that its device evaluates at once: so many a batch of such an engine has; 0: it has no device."""
    builds: Annotated[str, Meta(pattern=r"\A([0-9a-f]{64})?\Z")] = ""
    """Digest of the code with which it builds shapes; empty: it builds none."""
    held: list[BatchId]
    """Batches still held from before."""
    host: Annotated[str, Meta(pattern=r"\A[!-~]{1,255}\Z")]
    pid: Count
    platform: dict[str, str]
    """All that decides the bits of a result: versions, evaluation code, probe digest."""


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
    """Administrator to coordinator, query: an order for the job."""

    wire_name = "order"

    act: Literal["pause", "continue", "cancel", "drain"]
    worker: Annotated[str, Meta(pattern=r"\A[0-9a-f]{0,32}\Z")] = ""
    """Worker to drain, by its id or a prefix of it; empty: by `host`."""
    host: Text = ""
    """Host whose workers are drained."""


class OrderReply(Message, frozen=True, kw_only=True):
    """The answer to an order."""

    wire_name = "done"

    words: Text
    """Result in a sentence for a person."""


class Chunk(Message, frozen=True, kw_only=True):
    """The answer to one query for a piece of a scene bundle."""

    wire_name = "chunk"

    total: Annotated[int, Meta(ge=1, le=4096)]
    """Number of chunks of the bundle."""
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
    contact_slots: Width = 0
    columns: dict[str, bytes]
    """All of `rows.COLUMNS`."""
    cpu_seconds: Number = 0.0
    """CPU time of these rows on their workers [s], outside the digest."""
    failures: list[Failure] = []
    """Reasons of the failures in rows with `Outcome.ERROR`."""
    platform: dict[str, str] = {}
    """The platform of the job's rows; empty at replay."""
    makers: list[tuple[RowCount, Text]] = []
    """Numbers of rows that follow each other, and who made them: a worker's id and host; empty: unknown."""


class Recorded(Message, frozen=True, kw_only=True):
    """Recorder to coordinator: how many rows of a run are durable."""

    wire_name = "recorded"

    epoch: Count
    run: Name
    durable: Count
    trouble: Text = ""
    """Reason why the recorder cannot write now, in words; empty when it can."""


class OpenRun(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """One run of a job that is opened."""

    run: Name
    spec: bytes
    """The full spec as TOML."""
    scene: Digest
    genes: Width
    joints: Width
    contact_slots: Width = 0
    excluded: list[Wid] = []
    """Workers that were found wrong: their rows, and all behind the first of them, are taken back."""


class Open(Message, frozen=True, kw_only=True):
    """Coordinator to recorder, query: opens runs of a job."""

    wire_name = "open"

    job: Name
    runs: list[OpenRun]
    epoch: Count = 0
    """Epoch that these runs join; 0: a new one begins."""


class Opened(Message, frozen=True, kw_only=True):
    """The answer to `Open`: epoch, and the durable number of each run in the order asked."""

    wire_name = "opened"

    epoch: Count
    durable: list[Count]
    platform: dict[str, str]
    """Platform of the recorded rows; empty without rows."""
    identity: JobId = ""
    """Id of the job."""


class Log(Message, frozen=True, kw_only=True):
    """Query to the recorder: recorded rows of a run from number `first` on, at most `limit`."""

    wire_name = "log"

    run: Name
    first: Count
    limit: RowCount


class SuccessPage(Message, frozen=True, kw_only=True):
    """The answer to a query on `rec/finds`: successes of a run in journal order."""

    wire_name = "finds"

    run: Name
    scene: Digest
    began: float
    """When the journal was begun [s since 1970]: another one of the same name has other rows."""
    next: Count
    """The journal number from which to ask on."""
    rows: Count
    """Rows of the journal; with `next` there, these are all the successes so far."""
    n: Annotated[int, Meta(ge=0, le=4096)]
    joints: Width
    contact_slots: Width = 0
    columns: dict[str, bytes]
    """Each column of `success_pages` by its name, little-endian."""


class Heartbeat(Struct, frozen=True, kw_only=True):
    """State of a worker, sent about once a second."""

    wid: Wid
    host: Text
    run: Text = ""
    """Run of the batch in work; empty: there is none."""
    rows: Count = 0
    """Rows of that batch."""
    done: Count = 0
    """Of these, rows that are evaluated."""
    loading: bool = False
    """True while its simulator loads the scene of that batch."""
    progressed: bool = True
    """True if its simulator did anything since the last heartbeat."""
    memory: Count = 0
    """Memory of the worker and its simulator [bytes]; 0: unknown."""
    restarts: Count = 0
    """How often it has started its simulator again."""


M = TypeVar("M", bound=Message)

MAX_PAYLOAD = 16 << 20  # The largest payload that is looked at [bytes]
MAX_CONTAINERS = 8192  # The most lists and maps in one message: a result with 4096 failures has half of them
MAX_REASON = 200  # The most characters that a refusal repeats of what came
MESSAGE_LIMITS = {
    "max_array_len": 4096,
    "max_map_len": 32,
    "max_str_len": 256,
    "max_bin_len": 1 << 20,
    "max_ext_len": 0,
    "strict_map_key": True,
    "raw": False,
}
MAX_BUNDLE = 128 << 20
"""Largest scene bundle that is fetched [bytes]; the built-in ones have 0.2 MB."""
MAX_BUNDLE_CONTAINERS = 1 << 16  # The most lists and maps in one; those have 50
BUNDLE_LIMITS = {
    "max_array_len": 1 << 16,
    "max_map_len": 256,
    "max_str_len": MAX_PAYLOAD,
    "max_bin_len": MAX_BUNDLE,
    "max_ext_len": 0,
}


@cache
def encoding(kind: type[Message]) -> str:
    """Return the encoding that a message of this kind travels with."""
    return f"application/msgpack;qdgrasp.{kind.wire_name}.v1"


def encode(message: Message) -> bytes:
    """Return a message as MessagePack."""
    return msgspec.msgpack.encode(message)


def decode(payload: bytes, kind: type[M]) -> M:
    """The message of `kind` in `payload`; a MessageError if it is not MessagePack of the schema."""
    if len(payload) > MAX_PAYLOAD:
        raise MessageError(f"{len(payload)} bytes are more than a message may have ({MAX_PAYLOAD})")
    values = unpack_values(payload, MAX_CONTAINERS, MESSAGE_LIMITS)
    version = values.get("v") if isinstance(values, dict) else None
    if isinstance(version, int) and version > VERSION:
        raise MessageError(
            f"it is of version {version} of the protocol, and this package speaks {VERSION}: update it"
        )
    try:
        return msgspec.convert(values, kind, builtin_types=(bytes,))  # not base64 text in place of bytes
    except msgspec.ValidationError as error:
        if isinstance(version, int) and 0 < version < VERSION:
            words = f"it is of version {version} of the protocol, and this package speaks {VERSION}"
            raise MessageError(f"{words}: update the one that sent it") from None
        raise MessageError(f"not a {kind.wire_name}: {printable(str(error), MAX_REASON)}") from None


def check_bundle(payload: bytes) -> None:
    """Check that the bytes of a scene are MessagePack of limited size, or raise a MessageError."""
    unpack_values(payload, MAX_BUNDLE_CONTAINERS, BUNDLE_LIMITS)


def unpack_values(payload: bytes, containers: int, limits: Mapping[str, Any]) -> Any:
    """Unpack a payload of at most so many lists and maps; a MessageError past any of the limits."""
    left = containers

    def count(container: Any) -> Any:
        nonlocal left
        left -= 1
        if left < 0:
            raise ValueError("too many lists and maps")
        return container

    try:
        return msgpack.unpackb(payload, list_hook=count, object_hook=count, **limits)
    except (ValueError, msgpack.UnpackException) as error:
        raise MessageError(f"not MessagePack within the limits: {type(error).__name__}") from None
