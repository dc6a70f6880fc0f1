import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from tests.simulation.recorder import FOLDER, MemoryDisk, MemoryRunFolder

from qdgrasp_coordinator.recorder.run_writer import RunWriter
from qdgrasp_coordinator.storage.journal import JournalIdentity, JournalSlice
from qdgrasp_protocol.rows import RowShape
from qdgrasp_protocol.spec import RunSpec

SHAPE = RowShape(genes=1, joints=0)


def part(first: int, stop: int) -> JournalSlice:
    rows = SHAPE.empty(stop - first)
    rows["index"] = np.arange(first, stop)
    return JournalSlice(first, rows)


def make_writer(epoch: int, durable: int) -> RunWriter:
    """A writer of a run in memory with so many rows."""
    disk = MemoryDisk()
    spec = RunSpec(gripper="panda", object="mug")
    disk.begin(FOLDER / "a", JournalIdentity("a", spec, "", SHAPE))
    if durable:
        disk.files["a"].append(part(0, durable), epoch, 0.0)
    return RunWriter(MemoryRunFolder(disk, "a"), disk, epoch)  # type: ignore[arg-type]


def commit(writer: RunWriter) -> list[int]:
    """Commit the waiting rows, and return the numbers of the rows that are added."""
    before = writer.journal.count
    writer.commit({})
    return writer.journal.slice(before, 10**9).rows["index"].tolist()


def test_a_replaced_coordinator_is_refused_and_a_newer_one_adopted() -> None:
    writer = make_writer(epoch=3, durable=0)
    assert not writer.add(part(0, 1), 2, 0.0)
    assert writer.add(part(0, 1), 5, 0.0)
    assert not writer.add(part(1, 2), 3, 0.0)
    writer.commit({})
    assert writer.journal.epochs == [5]


@given(st.lists(st.tuples(st.integers(0, 40), st.integers(0, 40), st.booleans())))
def test_whatever_arrives_each_row_is_committed_once_and_in_order(offers) -> None:
    writer, committed = make_writer(epoch=1, durable=0), []
    for first, length, is_due in [*offers, (0, 0, True)]:
        writer.add(part(first, first + length), 1, 0.0)
        if is_due:
            committed += commit(writer)
    assert committed == list(range(writer.durable))
