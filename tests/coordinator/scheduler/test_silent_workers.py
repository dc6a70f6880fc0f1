"""Workers that show progress and never answer are found out, and their batches go to those that do answer."""

from tests.coordinator.scheduler.leases import EPOCH, Dispatch, settle, submit, with_work
from tests.fakes.messages import ANN, BOB, join_message

from qdgrasp_coordinator.scheduler.worker import ANSWER_SECONDS

LEASE = 10.0


def sign(dispatch: Dispatch, wid: str, until: float, since: float = 0.0) -> list[str]:
    """Have a worker show progress once a second; returns why workers were given up."""
    reasons, now = [], since
    while now < until:
        now += 1.0
        dispatch.workers.progressed(wid, now)
        reasons += [lost.reason for lost in dispatch.give_up(now)]
    return reasons


def test_a_worker_that_signs_and_never_answers_loses_its_leases() -> None:
    dispatch = with_work(n=4)
    assert [lease.wid for lease in dispatch.leases(0.0)] == [ANN, ANN]
    assert sign(dispatch, ANN, ANSWER_SECONDS - 1) == []
    assert sign(dispatch, ANN, ANSWER_SECONDS + 5, ANSWER_SECONDS - 1) == ["no answer for 600 seconds"]


def test_it_gets_nothing_until_it_answers_while_another_worker_is_well() -> None:
    dispatch = with_work(n=8)
    first, _ = dispatch.leases(0.0)
    sign(dispatch, ANN, ANSWER_SECONDS + 1)
    now = ANSWER_SECONDS + 2
    dispatch.admit(BOB, 1, 2, [], now)
    assert {lease.wid for lease in dispatch.leases(now)} == {BOB}
    dispatch.workers.progressed(ANN, now)
    assert not dispatch.leases(now)
    settle(dispatch, first, now)
    assert {lease.wid for lease in dispatch.leases(now)} == {ANN}


def test_it_is_tried_again_where_no_worker_is_well() -> None:
    dispatch = with_work(n=4)
    dispatch.leases(0.0)
    sign(dispatch, ANN, ANSWER_SECONDS + 1)
    assert {lease.wid for lease in dispatch.leases(ANSWER_SECONDS + 2)} == {ANN}


def test_an_answer_now_and_then_keeps_leases_however_long_there_is_work() -> None:
    dispatch = with_work(n=100)
    now = 0.0
    for _ in range(6):
        lease, *_ = dispatch.leases(now)
        assert sign(dispatch, ANN, now + 200, now) == []
        now += 200
        settle(dispatch, lease, now)
    assert now > ANSWER_SECONDS


def test_a_batch_of_a_silent_worker_goes_to_one_that_answers_and_not_to_the_next_silent_one() -> None:
    dispatch = Dispatch(EPOCH, 1)
    submit(dispatch, 2)
    silent = [f"{number:032x}" for number in range(60)]
    for wid in (BOB, *silent):
        dispatch.workers.on_token(wid, True, 0.0)
        dispatch.join(join_message(wid, credit=1), 0.0)
    answered, lost = dispatch.leases(0.0)
    assert (answered.wid, lost.wid) == (BOB, silent[0])
    settle(dispatch, answered, 1.0)
    dispatch.give_up(LEASE + 1)
    (again,) = dispatch.leases(LEASE + 1)
    assert (again.wid, again.batch.id) == (BOB, lost.batch.id)
