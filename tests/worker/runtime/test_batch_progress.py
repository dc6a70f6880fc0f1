"""The progress of a batch while simulators come and go."""

import numpy as np
import pytest
from tests.worker.runtime.scripted_simulator import work

from qdgrasp_protocol import messages
from qdgrasp_protocol.messages import Failure, Result
from qdgrasp_worker.runtime.batch_progress import BatchProgress
from qdgrasp_worker.runtime.simulator_messages import PartialResult


def part(n: int, first: int = 0, failures: tuple[int, ...] = ()) -> PartialResult:
    """The results of n rows: their numbers, counted from `first`."""
    columns = {"fitness": np.arange(first, first + n, dtype="<f4").tobytes()}
    named = [Failure(row=row, reason="no") for row in failures]
    return PartialResult(n=n, joints=2, descriptors=3, columns=columns, failures=named, cpu_seconds=0.1 * n)


@pytest.fixture
def task() -> BatchProgress:
    return BatchProgress("job", work(n=5))


def test_parts_become_one_result_in_the_order_of_the_rows(task):
    task.add(part(2))
    assert not task.is_done
    task.add(part(3, first=2, failures=(1,)))
    assert task.is_done
    result = task.result("a" * 32, bytes(32))
    assert np.frombuffer(result.columns["fitness"], "<f4").tolist() == [0, 1, 2, 3, 4]
    assert [failure.row for failure in result.failures] == [3]
    assert (result.joints, result.descriptors) == (2, 3)
    assert result.cpu_seconds == pytest.approx(0.5)
    assert messages.decode(messages.encode(result), Result) == result


def test_a_batch_whose_only_row_ends_every_simulator_is_answered_without_columns():
    task = BatchProgress("job", work(n=1))
    task.on_crash("one")
    assert task.is_done
    result = task.result("a" * 32, bytes(32))
    assert [failure.reason for failure in result.failures] == ["one"]
    assert result.columns == {}
