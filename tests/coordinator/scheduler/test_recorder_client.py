import itertools

import numpy as np
import pytest
from tests.coordinator.scheduler.search_plans import SHAPE
from tests.fakes.memory_bus import MemoryNetwork
from tests.fakes.messages import open_run

from qdgrasp_coordinator.scheduler.recorder_client import (
    DOUBT_SECONDS,
    MESSAGE_ROWS,
    MOST_UNCONFIRMED,
    RESEND_AFTER,
    SILENT_SECONDS,
    Outbox,
    RecorderClient,
)
from qdgrasp_coordinator.storage.journal import JournalSlice
from qdgrasp_protocol.bus import Query
from qdgrasp_protocol.errors import InputError, RecorderFellBack, Refused, TookOver
from qdgrasp_protocol.keys import Keys
from qdgrasp_protocol.messages import Failure, Recorded
from qdgrasp_protocol.rows import RowShape

NARROW_SHAPE = RowShape(genes=1, joints=0)


def journal_slice(first: int, n: int) -> JournalSlice:
    rows = NARROW_SHAPE.empty(n)
    rows["index"] = np.arange(first, first + n)
    return JournalSlice(first, rows, 0.1 * n)


def filled(*sizes: int, durable: int = 0, sent: float | None = None) -> Outbox:
    outbox = Outbox(durable)
    for first, n in zip(itertools.accumulate(sizes, initial=durable), sizes, strict=False):
        outbox.push(journal_slice(first, n))
    if sent is not None:
        outbox.take_due(sent)
    return outbox


def numbers(slices: list[JournalSlice]) -> list[int]:
    """The rows that are sent; what the slices say of themselves is checked."""
    for one in slices:
        assert len(one) <= MESSAGE_ROWS
        assert one.rows["index"].tolist() == list(range(one.first, one.stop))
    return [number for one in slices for number in range(one.first, one.stop)]


def test_what_is_not_durable_is_sent_again_after_a_while() -> None:
    outbox = filled(10, sent=5.0)
    outbox.confirm(4, 6.0)
    assert outbox.take_due(6.0 + RESEND_AFTER - 0.01) == []
    assert numbers(outbox.take_due(6.0 + RESEND_AFTER)) == [4, 5, 6, 7, 8, 9]
    assert outbox.take_due(6.0 + 2 * RESEND_AFTER - 0.01) == []


@pytest.mark.parametrize(("sizes", "durable"), [([10], 3), ([5, 5, 5], 7)])
def test_a_new_recorder_is_sent_everything_that_is_not_durable_at_once(sizes, durable) -> None:
    outbox = filled(*sizes, sent=0.0)
    outbox.confirm(durable, 0.1)
    outbox.resend(0.2)
    assert numbers(outbox.take_due(0.2)) == list(range(durable, sum(sizes)))
    assert outbox.take_due(0.2 + RESEND_AFTER / 2) == []


def test_it_is_full_when_too_much_is_unconfirmed() -> None:
    outbox = filled(MOST_UNCONFIRMED)
    assert not outbox.is_full
    outbox.push(journal_slice(MOST_UNCONFIRMED, 1))
    assert outbox.is_full
    outbox.confirm(1, 0.0)
    assert not outbox.is_full


def test_reasons_of_errors_are_sent_with_their_rows() -> None:
    outbox = Outbox(0)
    for first in (0, MESSAGE_ROWS - 2):
        n = MESSAGE_ROWS - 2 if first == 0 else 10
        one = journal_slice(first, n)
        outbox.push(JournalSlice(first, one.rows, 1.0, (Failure(row=5, reason=f"{first + 5}"),)))
    sent = [
        (part.first + failure.row, failure.reason)
        for part in outbox.take_due(0.0)
        for failure in part.failures
    ]
    assert sent == [(5, "5"), (MESSAGE_ROWS + 3, str(MESSAGE_ROWS + 3))]


def test_an_overtaken_report_is_ignored() -> None:
    outbox = filled(10, sent=0.0)
    outbox.confirm(8, 0.1)
    outbox.confirm(3, 0.2)
    assert outbox.durable == 8
    outbox.confirm(8, 1.0)
    outbox.confirm(3, 1.0 + DOUBT_SECONDS)
    assert outbox.durable == 8


@pytest.mark.parametrize("number", [3, 11])
def test_a_recorder_that_stays_at_another_number_is_believed(number: int) -> None:
    outbox = filled(10, sent=0.0)
    outbox.confirm(8, 0.1)
    outbox.confirm(number, 1.0)
    outbox.confirm(number, 0.9 + DOUBT_SECONDS)
    with pytest.raises(RecorderFellBack, match=f"reports {number} durable rows, expected 8 to 10"):
        outbox.confirm(number, 1.0 + DOUBT_SECONDS)


RUN = open_run(run="one", genes=4, joints=1)


def refuse(_query: Query) -> bytes:
    raise Refused("rows 7 to 9 are not what was recorded")


def wait() -> None:
    raise AssertionError("the recorder answered")


def test_a_recorder_that_refuses_is_quoted() -> None:
    network, keys = MemoryNetwork(), Keys("many")
    link = RecorderClient(network.session(), "many", SHAPE)
    with network.session().answer(keys.open, refuse), pytest.raises(InputError, match="rows 7 to 9"):
        link.open(RUN, 0, wait)
    with network.session().answer(keys.log, refuse), pytest.raises(InputError, match="rows 7 to 9"):
        link.recorded_rows(0, wait)


def test_a_recorder_that_reports_nothing_is_named_until_it_does() -> None:
    link = RecorderClient(MemoryNetwork().session(), "many", NARROW_SHAPE)
    link.push(journal_slice(0, 5))
    troubles = []
    for now in (0.0, 1.0, 1.0 + SILENT_SECONDS):
        link.tick(now)
        troubles.append(bool(link.trouble))
    assert troubles == [False, False, True]
    link.on_report(Recorded(epoch=0, run="", durable=2, trouble=""), 20.0)
    assert not link.trouble


def test_a_recorder_that_serves_another_coordinator_ends_this_one() -> None:
    def replaced(_query: Query) -> bytes:
        raise Refused(f"epoch 1 is over: {TookOver.BY} 2")

    network = MemoryNetwork()
    link = RecorderClient(network.session(), "many", SHAPE)
    with (
        network.session().answer(Keys("many").open, replaced),
        pytest.raises(TookOver, match=r"^Another coordinator of job 'many' took over \(epoch 2\)\.$"),
    ):
        link.open(RUN, 1, wait)
