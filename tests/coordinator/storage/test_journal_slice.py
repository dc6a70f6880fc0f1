import itertools

import numpy as np
import pytest

from qdgrasp_coordinator.storage.journal_slice import JournalSlice, join_slices
from qdgrasp_protocol.messages import Failure
from qdgrasp_protocol.rows import RowShape


def stretch() -> JournalSlice:
    rows = RowShape(genes=1, joints=0).empty(10)
    rows["index"] = np.arange(10)
    failures = tuple(Failure(row=row, reason=f"row {row}") for row in (0, 4, 9))
    return JournalSlice(100, rows, 5.0, failures)


@pytest.mark.parametrize(("first", "stop"), [(100, 110), (100, 104), (104, 110), (103, 106), (90, 200)])
def test_a_part_has_the_rows_and_failures_of_its_numbers(first: int, stop: int) -> None:
    part = stretch().part(first, stop)
    first, stop = max(first, 100), min(stop, 110)
    assert (part.first, part.stop) == (first, stop)
    assert part.rows["index"].tolist() == list(range(first - 100, stop - 100))
    assert part.cpu_seconds == pytest.approx((stop - first) / 2)
    for failure in part.failures:
        assert failure.reason == f"row {part.rows[failure.row]['index']}"
    assert len(part.failures) == sum(first <= 100 + row < stop for row in (0, 4, 9))


@pytest.mark.parametrize("cuts", [[100, 110], [100, 101, 110], [100, 103, 104, 109, 110]])
def test_parts_join_to_the_whole(cuts: list[int]) -> None:
    whole = stretch()
    parts = [whole.part(first, stop) for first, stop in itertools.pairwise(cuts)]
    again = join_slices(parts)
    assert (again.first, again.stop, again.failures) == (whole.first, whole.stop, whole.failures)
    assert again.rows.tobytes() == whole.rows.tobytes()
    assert again.cpu_seconds == pytest.approx(whole.cpu_seconds)
