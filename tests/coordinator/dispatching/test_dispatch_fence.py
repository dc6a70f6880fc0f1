"""Workers join again, vanish and fall silent: rules 3 and 4."""

from math import inf

import pytest
from tests.coordinator.dispatching.leases import (
    ANN,
    BOB,
    EPOCH,
    EVE,
    settle,
    submit,
    with_work,
)

from qdgrasp_coordinator.dispatching.batch import Settlement
from qdgrasp_coordinator.dispatching.dispatch import Dispatch
from qdgrasp_coordinator.dispatching.member import GRACE
from qdgrasp_coordinator.dispatching.pace import LEASE_SECONDS

# 3. The join fence.


def test_what_a_worker_does_not_hold_when_it_rejoins_is_leased_again_under_the_new_join() -> None:
    dispatch = with_work(n=4)
    held, dropped = dispatch.leases(0.0)
    assert dispatch.join(ANN, 2, 2, [held.batch.id], 0.1) == []
    (again,) = dispatch.leases(0.2)
    assert (again.batch.id, again.attempt, again.join) == (dropped.batch.id, 2, 2)
    assert settle(dispatch, held, 0.3).kind is Settlement.FRESH


def test_nothing_is_evaluated_twice_for_a_rejoin_with_everything_in_hand() -> None:
    dispatch = with_work(n=4)
    leases = dispatch.leases(0.0)
    dispatch.join(ANN, 2, 2, [lease.batch.id for lease in leases], 0.1)
    assert (dispatch.leases(0.2), dispatch.counters["requeued"]) == ([], 0)


def test_a_worker_is_told_to_drop_what_others_have_or_nobody_wants() -> None:
    dispatch = with_work(n=8)
    settled, moved, open_ = *dispatch.leases(0.0), b"\0" * 16
    settle(dispatch, settled, 0.1)
    dispatch.gone(ANN, 0.1)
    dispatch.tick(0.1 + GRACE)
    dispatch.join(BOB, 1, 1, [], 1.2)
    (lease,) = dispatch.leases(1.2)
    assert lease.batch.id == moved.batch.id
    held = [settled.batch.id, moved.batch.id, open_]
    assert dispatch.join(ANN, 2, 2, held, 1.3) == held


def test_a_worker_may_go_on_with_what_was_queued_again_meanwhile() -> None:
    dispatch = with_work(n=4)
    leases = dispatch.leases(0.0)
    dispatch.gone(ANN, 0.1)
    dispatch.tick(0.1 + GRACE)
    assert dispatch.queued_seconds > 0
    assert dispatch.join(ANN, 2, 2, [lease.batch.id for lease in leases], 1.5) == []
    assert (dispatch.queued_seconds, dispatch.leases(1.6)) == (0, [])


def test_nobody_may_go_on_with_what_it_was_never_leased() -> None:
    dispatch = with_work(n=2)
    (lease,) = dispatch.leases(0.0)
    assert dispatch.join(EVE, 1, 2, [lease.batch.id], 0.1) == [lease.batch.id]
    dispatch.gone(ANN, 0.1)
    dispatch.tick(0.1 + GRACE)
    assert dispatch.join(EVE, 2, 2, [lease.batch.id], 1.2) == [lease.batch.id]


@pytest.mark.parametrize("number", [1, 2])
def test_an_overtaken_join_changes_nothing(number: int) -> None:
    dispatch = with_work(n=4)
    dispatch.join(ANN, 2, 2, [], 0.0)
    dispatch.leases(0.1)
    requeued = dispatch.counters["requeued"]
    assert dispatch.join(ANN, number, 2, [], 0.2) == []
    assert (dispatch.queued_seconds, dispatch.counters["requeued"]) == (0, requeued)


# 4. Leases end.


def test_a_vanished_worker_is_given_up_after_a_second() -> None:
    dispatch = with_work(n=4, workers=(ANN, BOB))
    dispatch.leases(0.0)
    dispatch.gone(ANN, 3.0)
    assert dispatch.next_deadline() == 3.0 + GRACE
    assert dispatch.tick(3.0 + GRACE - 0.01) == []
    (lost,) = dispatch.tick(3.0 + GRACE)
    assert (lost.wid, lost.batches, lost.reason) == (ANN, 1, "its token vanished")
    (again,) = dispatch.leases(4.0)
    assert (again.wid, again.attempt) == (BOB, 2)


def test_news_of_the_same_loss_puts_nothing_off() -> None:
    dispatch = with_work(n=4)
    dispatch.leases(0.0)
    dispatch.gone(ANN, 3.0)
    dispatch.gone(ANN, 3.9)
    assert len(dispatch.tick(3.0 + GRACE)) == 1


def test_a_worker_that_comes_back_within_the_second_keeps_its_batches() -> None:
    dispatch = with_work(n=4)
    dispatch.leases(0.0)
    dispatch.gone(ANN, 3.0)
    dispatch.back(ANN, 3.5)
    assert dispatch.tick(3.0 + GRACE) == []
    assert dispatch.counters["requeued"] == 0


def test_a_vanished_worker_is_leased_nothing_even_if_a_late_result_of_it_arrives() -> None:
    dispatch = with_work(n=10)
    lease, _ = dispatch.leases(0.0)
    dispatch.gone(ANN, 0.1)
    assert settle(dispatch, lease, 0.2).kind is Settlement.FRESH
    assert dispatch.leases(0.3) == []
    assert len(dispatch.tick(0.1 + GRACE)) == 1


def test_nobody_is_given_up_while_our_own_link_is_down() -> None:
    dispatch = with_work(n=4, workers=(ANN, BOB))
    dispatch.leases(0.0)
    dispatch.link(False, 1.0)
    for wid in (ANN, BOB):
        dispatch.gone(wid, 1.0)
    assert dispatch.next_deadline() == inf
    assert dispatch.tick(500.0) == []
    dispatch.link(True, 500.0)
    dispatch.back(ANN, 500.1)
    assert [lost.wid for lost in dispatch.tick(500.0 + GRACE)] == [BOB]


def test_a_silent_worker_is_given_up_when_its_lease_is_over() -> None:
    dispatch = with_work(n=4, workers=(ANN, BOB))
    _, bobs = sorted(dispatch.leases(0.0), key=lambda lease: lease.wid)
    settle(dispatch, bobs, 1.0)
    assert dispatch.next_deadline() == LEASE_SECONDS
    (lost,) = dispatch.tick(LEASE_SECONDS)
    assert (lost.wid, lost.reason) == (ANN, "no sign of progress for 10 seconds")
    assert [lease.wid for lease in dispatch.leases(LEASE_SECONDS)] == [BOB]


def test_signs_of_progress_put_the_end_of_a_lease_off() -> None:
    dispatch = with_work(n=4)
    dispatch.leases(0.0)
    dispatch.seen(ANN, 8.0)
    assert dispatch.tick(LEASE_SECONDS) == []
    assert dispatch.next_deadline() == 8.0 + LEASE_SECONDS


def test_the_lease_begins_when_an_idle_worker_gets_work() -> None:
    dispatch = Dispatch(EPOCH, 2)
    dispatch.join(ANN, 1, 2, [], 0.0)
    submit(dispatch, 4)
    dispatch.leases(100.0)
    assert dispatch.tick(100.0 + LEASE_SECONDS / 2) == []


def test_leases_are_longer_where_batches_take_longer() -> None:
    dispatch = with_work(n=100, batch_size=1)
    for now in range(0, 60, 3):
        (lease, *_) = dispatch.leases(now)
        settle(dispatch, lease, now + 3)
    dispatch.leases(60.0)
    assert dispatch.tick(60.0 + 25) == []
    assert 60.0 + 25 < dispatch.next_deadline() < 60.0 + 35


def test_a_stuck_worker_gets_nothing_until_it_shows_progress() -> None:
    dispatch = with_work(n=20, workers=(ANN, BOB))
    anns = [lease for lease in dispatch.leases(0.0) if lease.wid == ANN]
    dispatch.seen(BOB, 9.0)
    assert [lost.wid for lost in dispatch.tick(LEASE_SECONDS)] == [ANN]
    assert dispatch.workers == 1
    assert dispatch.leases(10.0) == []  # Bob's credit is used up
    settle(dispatch, anns[0], 11.0)
    assert {lease.wid for lease in dispatch.leases(11.0)} == {ANN}


def test_where_all_workers_are_stuck_all_of_them_are_tried_in_turn() -> None:
    dispatch = with_work(n=1, workers=(ANN, BOB, EVE))
    tried = []
    for turn in range(6):
        tried += [lease.wid for lease in dispatch.leases(turn * LEASE_SECONDS)]
        dispatch.tick((turn + 1) * LEASE_SECONDS)
    assert set(tried[:3]) == set(tried[3:]) == {ANN, BOB, EVE}
