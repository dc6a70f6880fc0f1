"""What each process does with the bytes that reach it, as far as these decide; and messages to begin with."""

from collections.abc import Callable
from datetime import UTC, datetime
from typing import Any

import msgspec
import numpy as np

from qdgrasp_coordinator.metrics.job_status import (
    JobEvent,
    JobEvents,
    JobMeta,
    JobStatus,
    RunListings,
    RunStatus,
    WorkersPage,
    from_json,
    to_json,
)
from qdgrasp_coordinator.metrics.run_stats import GrowthCurve
from qdgrasp_coordinator.recorder.recorded_job import RunIdentity
from qdgrasp_coordinator.scheduler.batch_queue import read_result
from qdgrasp_coordinator.storage import success_pages as found
from qdgrasp_coordinator.storage.journal_slice import slice_from_message
from qdgrasp_protocol import messages
from qdgrasp_protocol.messages import Heartbeat, Message
from qdgrasp_protocol.rows import COLUMNS, GENOME, KEY, RESULT, RowShape, pack, unpack
from qdgrasp_protocol.spec import RunSpec, to_toml

SHAPE = RowShape(genes=7, joints=2)
ROWS = 5
LEASED = [column for column in KEY + GENOME if column.name != "generation"]
WID, DIGEST, BATCH = "0123456789abcdef" * 2, "ab" * 32, bytes(range(16))
PLATFORM = {"qdgrasp": "0.1.0", "machine": "x86_64", "probes": DIGEST}
SPEC = to_toml(RunSpec(gripper="panda", object="mug")).encode()

Consumer = Callable[[bytes], object]
"""Takes bytes as they arrive; refuses them with an error of ours."""


def work(payload: bytes) -> object:
    """A worker's part."""
    leased = messages.decode(payload, messages.Work)
    return unpack(SHAPE.empty(leased.n), LEASED, leased.columns, SHAPE)


def result(payload: bytes) -> object:
    """A coordinator's part."""
    return read_result(messages.decode(payload, messages.Result), SHAPE)


def recordable(payload: bytes) -> object:
    """A recorder's part, and that of a coordinator that replays."""
    return slice_from_message(messages.decode(payload, messages.Recordable), SHAPE)


def finds(payload: bytes) -> object:
    """The part of a monitor that draws."""
    return found.page_from_message(messages.decode(payload, messages.SuccessPage))


def opening(payload: bytes) -> object:
    """A recorder's part; specs are TOML."""
    return [RunIdentity.of(run) for run in messages.decode(payload, messages.Open).runs]


def shown(kind: Any) -> Consumer:
    """A monitor's part: JSON."""
    return lambda payload: from_json(payload, kind)


def plain(kind: type[Message]) -> Consumer:
    """Nothing but the codec."""
    return lambda payload: messages.decode(payload, kind)


OWN: dict[type[Message], Consumer] = {
    messages.Work: work,
    messages.Result: result,
    messages.Recordable: recordable,
    messages.Open: opening,
    messages.SuccessPage: finds,
}
KINDS = [
    kind
    for kind in vars(messages).values()
    if isinstance(kind, type) and issubclass(kind, Message) and kind is not Message
]
NOON = datetime(2026, 1, 1, 12, tzinfo=UTC)
SHOWN = {
    "figures": RunStatus,
    "jobfigures": JobStatus,
    "teamfigures": WorkersPage,
    "jobmeta": JobMeta,
    "event": JobEvent,
    "events": JobEvents,
    "curve": GrowthCurve,
    "runentries": RunListings,
    "sign": Heartbeat,
}
"""What travels as JSON, by the names of the files in corpus/."""
CONSUMERS: dict[str, Consumer] = {
    **{kind.wire_name: OWN.get(kind, plain(kind)) for kind in KINDS},
    **{name: shown(kind) for name, kind in SHOWN.items()},
}
"""By the kind of message."""


def seeds() -> dict[str, bytes]:
    """One good message of each kind."""
    rows = SHAPE.empty(ROWS)
    for column in COLUMNS:
        rows[column.name] = np.arange(rows[column.name].size).reshape(rows[column.name].shape) % 3
    number = np.arange(ROWS)
    drawn = found.success_table(rows, SHAPE.joints, number=number, synergy=number - 1, eta=number / ROWS)
    known = {
        messages.Work: {"columns": pack(rows, LEASED)},
        messages.Result: {
            "columns": pack(rows, RESULT),
            "failures": [messages.Failure(row=1, reason="it fell")],
        },
        messages.Recordable: {
            "columns": pack(rows, COLUMNS),
            "failures": [messages.Failure(row=0, reason="x")],
        },
        messages.SuccessPage: {"columns": found.success_columns(drawn)},
        messages.Open: {
            "runs": [messages.OpenRun(run="run", spec=SPEC, scene=DIGEST, genes=7, joints=2, descriptors=3)]
        },
    }
    made = {kind.wire_name: messages.encode(_made(kind, known.get(kind, {}))) for kind in KINDS}
    return made | {name: to_json(_shown(kind)) for name, kind in SHOWN.items()}


def _shown(kind: Any) -> Any:
    """What is shown, where numbers are 1, words are x, and there is one of whatever there may be many."""
    return _value(msgspec.inspect.type_info(kind))


def _value(kind: Any) -> Any:
    match kind:
        case msgspec.inspect.Metadata(type=inner):
            return _value(inner)
        case msgspec.inspect.StructType(cls=cls, fields=fields):
            return cls(**{field.name: _value(field.type) for field in fields})
        case msgspec.inspect.UnionType(types=types):
            return _value(next(each for each in types if not isinstance(each, msgspec.inspect.NoneType)))
        case msgspec.inspect.ListType(item_type=item):
            return [_value(item)]
        case msgspec.inspect.DictType(value_type=value):
            return {"x": _value(value)}
        case msgspec.inspect.StrType(pattern=pattern):
            return WID if pattern else "x"
        case msgspec.inspect.LiteralType(values=values):
            return values[0]
        case msgspec.inspect.DateTimeType():
            return NOON
        case msgspec.inspect.BoolType():
            return True
    return 1


def _made(kind: type[Message], given: dict[str, Any]) -> Message:
    """A message whose fields are what their names say, besides those given."""
    common: dict[str, Any] = {
        "epoch": 3, "run": "run", "scene": DIGEST, "prior": "contact", "generation": 7, "batch": BATCH,
        "attempt": 1, "join": 2, "n": ROWS, "genes": 7, "joints": 2, "descriptors": 3, "wid": WID,
        "cpu_seconds": 0.5, "versions": [1], "number": 1, "credit": 2, "held": [BATCH], "host": "node7",
        "pid": 77, "platform": PLATFORM, "drop": [BATCH], "act": "drain", "words": "done", "total": 3,
        "data": b"chunk" * 20, "first": 10, "durable": 15, "job": "mugs", "limit": 100, "runs": [],
        "next": 20, "rows": 20, "began": 1.7e9,
    }  # fmt: skip
    names = {field.name for field in msgspec.structs.fields(kind)}
    values = {name: value for name, value in (common | given).items() if name in names}
    if kind is messages.Opened:
        values["durable"] = [15]
    return kind(**values)
