import numpy as np
import pytest

from qdgrasp_coordinator.dispatching.batch import readable
from qdgrasp_protocol.messages import Result
from qdgrasp_protocol.outcome import Outcome
from qdgrasp_protocol.rows import RESULT, Shape, pack

SHAPE = Shape(genes=2, joints=1)


def result(outcomes: list[int]) -> Result:
    rows = SHAPE.empty(len(outcomes))
    rows["outcome"] = outcomes
    return Result(
        epoch=1,
        run="run",
        generation=0,
        batch=bytes(16),
        attempt=1,
        wid="0" * 32,
        n=len(outcomes),
        joints=1,
        descriptors=3,
        columns=pack(rows, RESULT),
        cpu_seconds=0.0,
    )


def test_the_rows_of_a_result_are_read() -> None:
    read, rows = readable(result([Outcome.ERROR, Outcome.HELD]), SHAPE)
    assert read.failures == []
    np.testing.assert_array_equal(rows["outcome"], [Outcome.ERROR, Outcome.HELD])


@pytest.mark.parametrize("number", [Outcome.HELD + 1, 255])
def test_an_outcome_that_is_none_fails_all_rows_of_its_result(number: int) -> None:
    read, rows = readable(result([Outcome.MISSED, number]), SHAPE)
    assert [failure.row for failure in read.failures] == [0, 1]
    assert f"holds {number}" in read.failures[0].reason
    assert not rows["outcome"].any()
