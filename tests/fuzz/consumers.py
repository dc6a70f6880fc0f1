"""Decoding of received bytes in each process, and messages to begin with."""

from collections.abc import Callable
from typing import Any

import numpy as np
from msgspec.structs import replace
from tests.fakes.messages import KINDS, example, open_run

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
from qdgrasp_coordinator.scheduler.auditor import read_result
from qdgrasp_coordinator.storage import success_pages as found
from qdgrasp_coordinator.storage.journal import JournalIdentity, slice_from_message
from qdgrasp_protocol import messages
from qdgrasp_protocol.build_messages import Build, MeshFile, MeshPreparation, ShapeTask
from qdgrasp_protocol.messages import Heartbeat, Message, deflated
from qdgrasp_protocol.rows import COLUMNS, GENOME, KEY, RESULT, RowShape, pack, unpack
from qdgrasp_protocol.spec import RunSpec, to_toml

SHAPE = RowShape(genes=7, joints=2, contact_slots=2)
ROWS = 5
BATCH = bytes(range(16))
LEASED = [column for column in KEY + GENOME if column.name != "generation"]
SPEC = to_toml(RunSpec(gripper="panda", object="mug")).encode()

Consumer = Callable[[bytes], object]
"""Takes bytes as they arrive; refuses them with an error of ours."""


def work(payload: bytes) -> object:
    """A worker's part."""
    leased = messages.decode(payload, messages.Work)
    return unpack(SHAPE.empty(leased.n), LEASED, leased.columns)


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
    return [JournalIdentity.of(run) for run in messages.decode(payload, messages.Open).runs]


def shown(kind: Any) -> Consumer:
    """A monitor's part: JSON."""
    return lambda payload: from_json(payload, kind)


def plain(kind: type[Message]) -> Consumer:
    """The codec alone."""
    return lambda payload: messages.decode(payload, kind)


OWN: dict[type[Message], Consumer] = {
    messages.Work: work,
    messages.Result: result,
    messages.Recordable: recordable,
    messages.Open: opening,
    messages.SuccessPage: finds,
}
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
"""Kinds that travel as JSON, by the names of the files in corpus/."""
CONSUMERS: dict[str, Consumer] = {
    **{kind.wire_name: OWN.get(kind, plain(kind)) for kind in KINDS},
    **{name: shown(kind) for name, kind in SHOWN.items()},
}
"""By the kind of message."""


SHAPE_TASK = ShapeTask(
    files=(MeshFile(name="mesh.stl", sha256="0" * 64, size=84),),
    mesh=MeshPreparation(simplify=100),
    code="1" * 64,
)


def seeds() -> dict[str, bytes]:
    """One good message of each kind."""
    rows = SHAPE.empty(ROWS)
    for column in COLUMNS:
        rows[column.name] = np.arange(rows[column.name].size).reshape(rows[column.name].shape) % 3
    number = np.arange(ROWS)
    known_of = {"pregrasp": rows["joints"], "synergy": number - 1, "eta": number / ROWS, "trials": number}
    drawn = found.success_table(rows, SHAPE, number=number, **known_of)
    widths = {"joints": SHAPE.joints, "contact_slots": SHAPE.contact_slots}
    sizes = {"n": ROWS} | widths
    genes, failed = {"genes": SHAPE.genes}, {"failures": [messages.Failure(row=1, reason="it fell")]}
    known: dict[type[Message], dict[str, Any]] = {
        messages.Work: {"n": ROWS, "columns": pack(rows, LEASED)} | genes,
        messages.Result: {"columns": deflated(pack(rows, RESULT))} | sizes | failed,
        messages.Recordable: {"columns": deflated(pack(rows, COLUMNS)), "makers": [(ROWS, "a here")]}
        | sizes
        | genes
        | failed,
        messages.SuccessPage: {"n": ROWS, "columns": deflated(pack(drawn, found.SUCCESS_COLUMNS))} | widths,
        messages.Open: {"runs": [open_run(spec=SPEC)]},
        Build: {"task": SHAPE_TASK},
    }
    batch = {"batch": BATCH, "held": [BATCH], "drop": [BATCH], "key": bytes(32)}
    made = {}
    for kind in KINDS:
        values = {name: value for name, value in batch.items() if name in kind.__struct_fields__}
        made[kind.wire_name] = messages.encode(replace(example(kind), **values, **known.get(kind, {})))
    return made | {name: to_json(example(kind)) for name, kind in SHOWN.items()}
