import itertools

import numpy as np
import pytest

from qdgrasp_coordinator.counts.stretch import Stretch
from qdgrasp_coordinator.serving.outbox import BOUND, DOUBT, RESEND_AFTER, SLICE, Outbox
from qdgrasp_protocol.errors import RecorderFellBack
from qdgrasp_protocol.messages import Failure
from qdgrasp_protocol.rows import Shape

SHAPE = Shape(genes=1, joints=0)


def stretch(first: int, n: int) -> Stretch:
    rows = SHAPE.empty(n)
    rows["index"] = np.arange(first, first + n)
    return Stretch(first, rows, 0.1 * n)


def filled(*sizes: int, durable: int = 0) -> Outbox:
    outbox = Outbox(durable)
    for first, n in zip(itertools.accumulate(sizes, initial=durable), sizes, strict=False):
        outbox.push(stretch(first, n))
    return outbox


def numbers(stretches: list[Stretch]) -> list[int]:
    """The rows that are sent; what the slices say of themselves is checked."""
    for one in stretches:
        assert len(one) <= SLICE
        assert one.rows["index"].tolist() == list(range(one.first, one.stop))
    return [number for one in stretches for number in range(one.first, one.stop)]


def test_rows_are_sent_once_while_all_is_well() -> None:
    outbox = filled(3, 4)
    assert numbers(outbox.due(0.0)) == list(range(7))
    assert outbox.due(0.1) == []
    outbox.push(stretch(7, 2))
    assert numbers(outbox.due(0.2)) == [7, 8]
    outbox.durable(9, 0.3)
    assert outbox.is_empty
    assert outbox.due(100.0) == []


def test_many_rows_go_in_slices_and_small_stretches_together() -> None:
    outbox = filled(*[7] * 400)
    slices = outbox.due(0.0)
    assert numbers(slices) == list(range(2800))
    assert len(slices) == 3


def test_what_is_not_durable_is_sent_again_after_a_while() -> None:
    outbox = filled(10)
    outbox.due(5.0)
    outbox.durable(4, 6.0)
    assert outbox.due(6.0 + RESEND_AFTER - 0.01) == []
    assert numbers(outbox.due(6.0 + RESEND_AFTER)) == [4, 5, 6, 7, 8, 9]
    assert outbox.due(6.0 + 2 * RESEND_AFTER - 0.01) == []


def test_a_report_without_progress_puts_nothing_off() -> None:
    outbox = filled(10)
    outbox.due(0.0)
    for tenth in range(20):
        outbox.durable(0, tenth / 10)
    assert numbers(outbox.due(RESEND_AFTER)) == list(range(10))


def test_time_without_anything_to_confirm_does_not_count() -> None:
    outbox = filled(2)
    outbox.due(0.0)
    outbox.durable(2, 0.1)
    outbox.push(stretch(2, 2))
    assert numbers(outbox.due(1000.0)) == [2, 3]
    assert outbox.due(1000.0 + RESEND_AFTER / 2) == []


def test_a_new_recorder_is_sent_everything_that_is_not_durable_at_once() -> None:
    outbox = filled(10)
    outbox.due(0.0)
    outbox.durable(3, 0.1)
    outbox.recorder_up(0.2)
    assert numbers(outbox.due(0.2)) == list(range(3, 10))
    assert outbox.due(0.2 + RESEND_AFTER / 2) == []


def test_durable_rows_may_end_within_a_stretch() -> None:
    outbox = filled(5, 5, 5)
    outbox.due(0.0)
    outbox.durable(7, 0.1)
    outbox.recorder_up(0.2)
    assert numbers(outbox.due(0.2)) == list(range(7, 15))


def test_rows_may_be_durable_before_they_are_known_to_be_sent() -> None:
    outbox = filled(5)
    outbox.due(0.0)
    outbox.recorder_up(0.1)
    outbox.durable(5, 0.2)
    assert outbox.due(0.3) == []
    assert outbox.is_empty


def test_numbers_go_on_from_what_was_durable_at_the_start() -> None:
    outbox = filled(3, durable=50)
    assert numbers(outbox.due(0.0)) == [50, 51, 52]
    assert (outbox.confirmed, outbox.unconfirmed) == (50, 3)


def test_it_is_full_when_too_much_is_unconfirmed() -> None:
    outbox = filled(BOUND)
    assert not outbox.is_full
    outbox.push(stretch(BOUND, 1))
    assert outbox.is_full
    outbox.durable(1, 0.0)
    assert not outbox.is_full


def test_a_gap_is_refused() -> None:
    with pytest.raises(ValueError, match="row 3 was to be next, got 4"):
        filled(3).push(stretch(4, 1))


def test_reasons_of_errors_are_sent_with_their_rows() -> None:
    outbox = Outbox(0)
    for first in (0, SLICE - 2):
        n = SLICE - 2 if first == 0 else 10
        one = stretch(first, n)
        outbox.push(Stretch(first, one.rows, 1.0, (Failure(row=5, reason=f"{first + 5}"),)))
    sent = [
        (part.first + failure.row, failure.reason) for part in outbox.due(0.0) for failure in part.failures
    ]
    assert sent == [(5, "5"), (SLICE + 3, str(SLICE + 3))]


def test_an_overtaken_report_is_ignored() -> None:
    outbox = filled(10)
    outbox.due(0.0)
    outbox.durable(8, 0.1)
    outbox.durable(3, 0.2)
    assert outbox.confirmed == 8
    outbox.durable(8, 1.0)
    outbox.durable(3, 1.0 + DOUBT)
    assert outbox.confirmed == 8


@pytest.mark.parametrize("number", [3, 11])
def test_a_recorder_that_stays_at_another_number_is_believed(number: int) -> None:
    outbox = filled(10)
    outbox.due(0.0)
    outbox.durable(8, 0.1)
    outbox.durable(number, 1.0)
    outbox.durable(number, 0.9 + DOUBT)
    with pytest.raises(RecorderFellBack, match=f"reports {number} durable rows, expected 8 to 10"):
        outbox.durable(number, 1.0 + DOUBT)
