"""When a worker that is asked to leave goes."""

import pytest
from tests.worker.runtime.leased_batches import work

from qdgrasp_worker.runtime.batch_queue import BatchProgress
from qdgrasp_worker.runtime.batch_runner import HAND_BACK_SECONDS, GracefulShutdown
from qdgrasp_worker.runtime.simulator_messages import PartialResult

GRACE = 2.0


def task(n: int, done: int, since: float) -> BatchProgress:
    task = BatchProgress("job", work(n=n), since=since)
    if done:
        task.add(PartialResult(n=done, columns={"nu": bytes(4 * done)}))
    return task


@pytest.fixture
def leave() -> GracefulShutdown:
    return GracefulShutdown(GRACE)


def test_nobody_leaves_unasked(leave):
    assert not leave.is_over(1e9)


def test_an_idle_worker_goes_at_once(leave):
    leave.begin(None, now=10.0)
    assert leave.is_over(10.0)


def test_a_batch_that_fits_is_finished_before(leave):
    half = task(n=10, done=5, since=9.0)
    leave.begin(half, now=10.0)
    assert leave.kept is half
    assert not leave.is_over(10.5)
    leave.forget(half)
    assert leave.is_over(10.5)


@pytest.mark.parametrize(("done", "since"), [(1, 9.0), (0, 10.0 - GRACE), (0, -1000.0)])
def test_a_batch_that_does_not_fit_is_not_waited_for(leave, done, since):
    leave.begin(task(n=10, done=done, since=since), now=10.0)
    assert leave.kept is None


def test_a_batch_that_takes_longer_than_it_seemed_is_late_while_it_can_be_handed_back(leave):
    leave.begin(task(n=10, done=9, since=9.0), now=10.0)
    assert leave.deadline == 10.0 + GRACE - HAND_BACK_SECONDS
    assert not leave.is_late(10.0)
    assert leave.is_late(leave.deadline)


def test_jobs_hear_what_is_handed_back_unless_that_takes_too_long(leave):
    leave.tell("one")
    leave.begin(None, now=10.0)
    assert not leave.is_over(10.1)
    assert leave.is_over(10.0 + GRACE)
    leave.heard("one")
    assert leave.is_over(10.1)


def test_a_worker_without_grace_still_hands_back():
    leave = GracefulShutdown(0.0)
    leave.tell("one")
    leave.begin(task(n=1, done=0, since=10.0), now=10.0)
    assert leave.kept is None
    assert not leave.is_over(10.0)
    assert leave.is_over(10.0 + HAND_BACK_SECONDS)


def test_at_once_is_at_once(leave):
    leave.begin(task(n=10, done=9, since=9.0), now=10.0)
    leave.at_once()
    assert leave.is_over(10.0)
