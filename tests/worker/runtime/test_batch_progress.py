"""The progress of a batch while simulators come and go."""

import numpy as np
import pytest
from tests.worker.runtime.scripted_simulator import GENES, work

from qdgrasp_protocol import messages
from qdgrasp_protocol.messages import Failure, Result
from qdgrasp_worker.runtime.batch_progress import BatchProgress
from qdgrasp_worker.runtime.simulator_messages import EvaluateRows, PartialResult


def part(n: int, first: int = 0, failures: tuple[int, ...] = ()) -> PartialResult:
    """The results of n rows: their numbers, counted from `first`."""
    numbers = np.arange(first, first + n, dtype="<f4")
    named = [Failure(row=row, reason="no") for row in failures]
    return PartialResult(
        n=n,
        joints=2,
        descriptors=3,
        columns={"fitness": numbers.tobytes()},
        failures=named,
        cpu_seconds=0.1 * n,
    )


def fitness(task: BatchProgress) -> list[float]:
    return np.frombuffer(task.result("a" * 32).columns["fitness"], "<f4").tolist()


def first_genes(request: EvaluateRows) -> list[float]:
    return np.frombuffer(request.columns["genome"], "<f4").reshape(-1, GENES)[:, 0].tolist()


@pytest.fixture
def task() -> BatchProgress:
    return BatchProgress("job", work(n=5))


def test_parts_become_one_result_in_the_order_of_the_rows(task):
    task.add(part(2))
    assert not task.is_done
    task.add(part(3, first=2, failures=(1,)))
    assert task.is_done
    result = task.result("a" * 32)
    assert fitness(task) == [0, 1, 2, 3, 4]
    assert [failure.row for failure in result.failures] == [3]
    assert (result.joints, result.descriptors) == (2, 3)
    assert result.cpu_seconds == pytest.approx(0.5)
    assert messages.decode(messages.encode(result), Result) == result


def test_what_is_known_already_is_not_asked_for_again(task):
    assert first_genes(task.request(None)) == [0, 1, 2, 3, 4]
    task.add(part(2))
    request = task.request(None)
    assert request.n == 3
    assert first_genes(request) == [2, 3, 4]
    assert len(request.columns["trial"]) == 3 * 2


def test_the_first_end_of_a_simulator_blames_nobody_and_makes_careful(task):
    task.add(part(2))
    task.on_crash("the simulator was ended by SIGSEGV")
    assert not task.is_done
    assert task.request(None).is_careful
    assert first_genes(task.request(None)) == [2, 3, 4]


def test_row_by_row_the_first_that_is_not_known_is_to_blame(task):
    task.on_crash("first")
    task.add(part(1))
    task.on_crash("the simulator was ended by SIGABRT")
    assert first_genes(task.request(None)) == [2, 3, 4]
    for row in (2, 3, 4):
        task.add(part(1, first=row))
    result = task.result("a" * 32)
    assert [(failure.row, failure.reason) for failure in result.failures] == [
        (1, "the simulator was ended by SIGABRT")
    ]
    assert fitness(task) == [0, 0, 2, 3, 4]


def test_a_batch_whose_only_row_ends_every_simulator_is_answered_without_columns():
    task = BatchProgress("job", work(n=1))
    task.on_crash("one")
    assert task.is_done
    result = task.result("a" * 32)
    assert [failure.reason for failure in result.failures] == ["one"]
    assert result.columns == {}


def test_an_end_while_the_scene_is_loaded_speaks_against_all_rows(task):
    task.request(b"a scene")
    task.on_crash("the simulator was ended by SIGSEGV")
    assert task.is_done
    reasons = {failure.reason for failure in task.result("a" * 32).failures}
    assert reasons == {"the simulator was ended by SIGSEGV while it loaded the scene"}


def test_a_batch_that_cannot_be_evaluated_is_answered_with_every_row_failed(task):
    task.add(part(2))
    task.fail_all("not a scene: " + "é" * 500)
    result = task.result("a" * 32)
    assert [failure.row for failure in result.failures] == [0, 1, 2, 3, 4]
    assert messages.decode(messages.encode(result), Result) == result
