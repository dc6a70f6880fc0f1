"""Leases, joins and results at the dispatcher (rules 1 and 3 to 6 of docs/bus.md).

tests/simulation mixes all of them.
"""

from math import inf

import numpy as np
import pytest
from msgspec import structs
from tests.coordinator.scheduler.leases import (
    EPOCH,
    SCENE,
    SHAPE,
    Dispatch,
    failures,
    genomes,
    indices,
    result,
    settle,
    submit,
    with_work,
)
from tests.fakes.messages import ANN, BOB, EVE

from qdgrasp_coordinator.scheduler.batch_dispatcher import STRIKES
from qdgrasp_coordinator.scheduler.batch_queue import Lease, Settlement
from qdgrasp_coordinator.scheduler.batch_table import MOST_SETTLED
from qdgrasp_coordinator.scheduler.worker import SCENES_KEPT, TOKEN_GRACE
from qdgrasp_coordinator.scheduler.worker_registry import LEASE_SECONDS
from qdgrasp_protocol.errors import MessageError
from qdgrasp_protocol.messages import Failure, Work, decode, encode
from qdgrasp_protocol.rows import Outcome


def lose(dispatch: Dispatch, now: float) -> None:
    """Have Ann vanish, and give her up."""
    dispatch.workers.on_token(ANN, False, now)
    dispatch.give_up(now + TOKEN_GRACE)


def with_one_lease() -> tuple[Dispatch, Lease]:
    """All the work there is, leased to Ann."""
    dispatch = with_work(n=2)
    (lease,) = dispatch.leases(0.0)
    return dispatch, lease


# 1. Credit.


def test_a_worker_is_leased_as_many_batches_as_it_has_credit() -> None:
    dispatch = with_work()
    first = dispatch.leases(0.0)
    assert indices(first) == [[0, 1], [2, 3]]
    assert dispatch.leases(0.1) == []
    settle(dispatch, first[1], 0.2)
    assert indices(dispatch.leases(0.2)) == [[4, 5]]


def test_rows_of_a_device_go_to_workers_that_have_one_as_many_as_it_takes_at_once() -> None:
    dispatch = Dispatch(EPOCH)
    submit(dispatch, 40, run="plain")
    submit(dispatch, 250, run="on-device", engine="mujoco-warp")
    dispatch.admit(ANN, 1, 2, [], 0.0)
    dispatch.admit(BOB, 1, 2, [], 0.0, rows=100)
    first = dispatch.leases(0.0)
    assert {(lease.wid, lease.batch.run.run) for lease in first} == {(ANN, "plain"), (BOB, "on-device")}
    assert [len(lease.batch) for lease in first if lease.wid == BOB] == [100, 100]
    for lease in first:
        settle(dispatch, lease, 0.1)
    assert next(len(lease.batch) for lease in dispatch.leases(0.1) if lease.wid == BOB) == 50


def test_without_a_device_its_rows_wait_and_others_do_not() -> None:
    dispatch = Dispatch(EPOCH, batch_size=2)
    submit(dispatch, 4, run="on-device", engine="mujoco-warp")
    dispatch.admit(ANN, 1, 2, [], 0.0)
    assert dispatch.leases(0.0) == []
    submit(dispatch, 2, run="plain")
    assert [lease.batch.run.run for lease in dispatch.leases(0.0)] == ["plain"]
    dispatch.admit(BOB, 1, 2, [], 0.0, rows=64)
    assert [(lease.wid, len(lease.batch)) for lease in dispatch.leases(0.1)] == [(BOB, 2), (BOB, 2)]


def test_a_device_takes_rows_of_other_engines_when_its_own_are_done() -> None:
    dispatch = Dispatch(EPOCH, batch_size=2)
    submit(dispatch, 2, run="plain")
    submit(dispatch, 2, run="on-device", engine="mujoco-warp")
    dispatch.admit(BOB, 1, 2, [], 0.0, rows=64)
    assert [lease.batch.run.run for lease in dispatch.leases(0.0)] == ["on-device", "plain"]


def test_workers_take_turns() -> None:
    assert with_work(workers=()).leases(0.0) == []
    dispatch = with_work(workers=(ANN, BOB))
    assert sorted(lease.wid for lease in dispatch.leases(0.0)) == [ANN, ANN, BOB, BOB]
    dispatch = with_work(n=4, workers=(ANN, BOB))
    assert sorted(lease.wid for lease in dispatch.leases(0.0)) == [ANN, BOB]


def test_a_batch_holds_rows_of_one_generation_only() -> None:
    dispatch = with_work(n=3)
    submit(dispatch, 3, generation=1)
    dispatch.admit(BOB, 1, 4, [], 0.0)
    leases = dispatch.leases(0.0)
    assert sorted((lease.batch.rows.number, lease.batch.rows.indices.tolist()) for lease in leases) == [
        (0, [0, 1]),
        (0, [2]),
        (1, [0, 1]),
        (1, [2]),
    ]


def test_a_lease_travels_as_a_message() -> None:
    lease = with_work().leases(0.0)[1]
    work = decode(encode(lease.work(EPOCH)), Work)
    assert (work.epoch, work.run, work.scene, work.prior) == (EPOCH, "run", SCENE, "contact")
    assert (work.batch, work.attempt, work.join, work.n, work.genes) == (lease.batch.id, 1, 1, 2, 2)
    assert np.frombuffer(work.columns["index"], "<u4").tolist() == [2, 3]
    assert np.frombuffer(work.columns["trial"], "<u2").tolist() == [0, 0]
    assert work.columns["genome"] == genomes(10)[2:4].tobytes()


def test_batch_ids_are_never_used_again() -> None:
    seen = set()
    for epoch in range(3):
        dispatch = Dispatch(epoch, 1)
        submit(dispatch, 50)
        dispatch.admit(ANN, 1, 64, [], 0.0)
        ids = {lease.batch.id for lease in dispatch.leases(0.0)}
        assert len(ids) == 50
        assert {len(one) for one in ids} == {16}
        assert not ids & seen
        seen |= ids


def test_measured_batches_grow_from_small_ones() -> None:
    dispatch = with_work(n=2000, batch_size=None)
    sizes = []
    for now in range(20):
        for lease in dispatch.leases(now):
            sizes.append(len(lease.batch))
            settle(dispatch, lease, now)
    assert sizes[:2] == [4, 4]
    assert sizes[-1] == 2  # a quarter of a second at 0.1 s a row


# Fairness across runs.


def test_runs_are_served_in_turn_by_what_they_cost() -> None:
    dispatch = Dispatch(EPOCH, 1)
    for run in ("one", "two"):
        submit(dispatch, 1000, run, scene=run)
    dispatch.admit(ANN, 1, 1, [], 0.0)
    served = {"one": 0, "two": 0}
    for now in range(400):
        (lease,) = dispatch.leases(now)
        settle(dispatch, lease, now)
        served[lease.batch.run.run] += 1
    assert abs(served["one"] - served["two"]) <= 2 * 5.0 / 0.1 + 2


def test_a_worker_opens_few_scenes_where_there_are_more_than_it_can_keep() -> None:
    dispatch = Dispatch(EPOCH, 1)
    for number in range(20):
        submit(dispatch, 1000, f"run{number}", scene=f"{number}")
    dispatch.admit(ANN, 1, 1, [], 0.0)
    opened, kept = 0, []
    for now in range(1000):
        (lease,) = dispatch.leases(now)
        settle(dispatch, lease, now)
        opened += lease.batch.run.scene not in kept
        kept = [lease.batch.run.scene, *(scene for scene in kept if scene != lease.batch.run.scene)][
            :SCENES_KEPT
        ]
    assert 10 < opened < 60


def test_a_worker_that_rejoins_holds_its_scenes_still() -> None:
    dispatch = Dispatch(EPOCH, 1)
    for run in ("one", "two"):
        submit(dispatch, 10, run, scene=run)
    dispatch.admit(ANN, 1, 1, [], 0.0)
    for _ in range(2):
        (lease,) = dispatch.leases(0.0)
        settle(dispatch, lease, 0.1)
    dispatch.admit(ANN, 2, 1, [], 0.2)
    assert [again.batch.run.scene for again in dispatch.leases(0.3)] == [lease.batch.run.scene]


def test_a_run_that_comes_late_is_not_given_what_it_missed() -> None:
    dispatch = Dispatch(EPOCH, 1)
    submit(dispatch, 1000, "one")
    dispatch.admit(ANN, 1, 1, [], 0.0)
    for now in range(200):
        settle(dispatch, dispatch.leases(now)[0], now)
    submit(dispatch, 1000, "two")
    runs = []
    for now in range(200, 400):
        (lease,) = dispatch.leases(now)
        settle(dispatch, lease, now)
        runs.append(lease.batch.run.run)
    assert 60 < runs.count("two") < 140


def test_only_the_scenes_that_a_worker_keeps_open_are_remembered() -> None:
    dispatch = Dispatch(EPOCH, 1)
    dispatch.admit(ANN, 1, 1, [], 0.0)
    for number in range(SCENES_KEPT + 3):
        submit(dispatch, 1, f"run{number}", scene=f"{number}")
        settle(dispatch, dispatch.leases(0.0)[0], 0.0)
    worker = dispatch.workers.get(ANN)
    assert list(worker.scenes) == [f"{number}" for number in range(3, SCENES_KEPT + 3)]


# The end of a run.


def test_a_withdrawn_run_is_leased_no_more_and_its_batches_may_be_dropped() -> None:
    dispatch = with_work(n=10)
    submit(dispatch, 4, "other", scene="2" * 64)
    mine = [lease for lease in dispatch.leases(0.0) if lease.batch.run.run == "run"]
    assert dispatch.withdraw("run") == {ANN: [lease.batch.id for lease in mine]}
    assert {lease.batch.run.run for lease in dispatch.leases(0.1)} == {"other"}
    assert settle(dispatch, mine[0], 0.2).kind is Settlement.LATE
    assert dispatch.withdraw("run") == {}


def test_a_withdrawn_run_may_hold_batches_that_wait_to_be_leased_again() -> None:
    dispatch = with_work(n=4)
    dispatch.leases(0.0)
    lose(dispatch, 0.0)
    assert dispatch.withdraw("run") == {}
    dispatch.admit(BOB, 1, 2, [], 1.5)
    assert (dispatch.leases(2.0), dispatch.queued_seconds, dispatch.workers.next_deadline()) == ([], 0, inf)


def test_the_workers_that_are_wanted_are_those_that_queued_and_leased_batches_keep_busy() -> None:
    dispatch = Dispatch(EPOCH, 2)
    assert dispatch.wanted_workers(is_leasing=True) == 0
    submit(dispatch, 9)
    assert dispatch.wanted_workers(is_leasing=True) == 5
    assert dispatch.wanted_workers(is_leasing=False) == 0
    dispatch.admit(ANN, 1, 2, [], 0.0)
    first, second = dispatch.leases(0.1)
    assert dispatch.wanted_workers(is_leasing=True) == 5
    assert dispatch.wanted_workers(is_leasing=False) == 2
    settle(dispatch, first, 0.2)
    settle(dispatch, second, 0.2)
    assert dispatch.wanted_workers(is_leasing=True) == 3
    dispatch.withdraw("run")
    assert dispatch.wanted_workers(is_leasing=True) == 0


def test_of_rows_whose_cost_was_measured_a_quarter_of_a_second_keeps_a_worker_busy() -> None:
    dispatch = with_work(n=10, batch_size=None)
    lease, *_ = dispatch.leases(0.0)
    settle(dispatch, lease, 0.1)  # 0.1 s a row
    submit(dispatch, 100, generation=1)
    held = len(lease.batch) + len(dispatch.leases(0.0))  # those of before, and new ones
    assert dispatch.wanted_workers(is_leasing=True) > 30
    assert dispatch.wanted_workers(is_leasing=False) <= held


# 5. Settle once.


def test_a_fresh_result_gives_complete_rows() -> None:
    dispatch = with_work(n=10, batch_size=5)
    _, lease = dispatch.leases(0.0)
    settled = settle(dispatch, lease, 0.5)
    assert settled.kind is Settlement.FRESH
    assert settled.rows["index"].tolist() == settled.rows["nu"].tolist() == [5, 6, 7, 8, 9]
    assert settled.rows["genome"].tobytes() == genomes(10)[5:].tobytes()
    assert (settled.rows["outcome"] == Outcome.HELD).all()
    assert (settled.cpu_seconds, settled.failures, settled.superseded) == (0.5, (), ())


def test_the_first_of_two_workers_wins_and_the_other_is_late() -> None:
    dispatch = with_work(n=2)
    (zombies,) = dispatch.leases(0.0)
    dispatch.admit(BOB, 1, 2, [], 1.0)
    dispatch.give_up(LEASE_SECONDS)
    (bobs,) = dispatch.leases(LEASE_SECONDS)
    assert (bobs.wid, bobs.batch) == (BOB, zombies.batch)
    settled = settle(dispatch, zombies, 11.0)
    assert (settled.kind, settled.superseded) == (Settlement.FRESH, (BOB,))
    assert settle(dispatch, bobs, 12.0).kind is Settlement.LATE
    assert (dispatch.leases(13.0), dispatch.queued_seconds) == ([], 0)


def test_a_worker_that_was_overtaken_has_its_credit_back_at_once() -> None:
    dispatch = with_work(n=2)
    (zombies,) = dispatch.leases(0.0)
    dispatch.admit(BOB, 1, 1, [], 1.0)
    dispatch.give_up(LEASE_SECONDS)
    (bobs,) = dispatch.leases(LEASE_SECONDS)
    settle(dispatch, zombies, 11.0)
    dispatch.workers.on_token(ANN, False, 11.0)
    submit(dispatch, 2, generation=1)
    assert [lease.wid for lease in dispatch.leases(11.0)] == [BOB]
    assert settle(dispatch, bobs, 12.0).kind is Settlement.LATE
    assert dispatch.leases(12.0) == []


def test_a_result_settles_a_batch_that_waits_to_be_leased_again() -> None:
    dispatch, lease = with_one_lease()
    lose(dispatch, 0.1)
    assert dispatch.workers.next_deadline() == inf
    assert settle(dispatch, lease, 2.0).kind is Settlement.FRESH
    dispatch.admit(BOB, 1, 2, [], 2.0)
    assert dispatch.leases(2.0) == []


def test_results_of_other_epochs_and_other_workers_are_foreign() -> None:
    dispatch = with_work(n=2)
    dispatch.admit(EVE, 1, 0, [], 0.0)
    (lease,) = dispatch.leases(0.0)
    assert settle(dispatch, lease, 0.1, epoch=EPOCH - 1).kind is Settlement.FOREIGN
    assert settle(dispatch, lease, 0.1, wid=EVE).kind is Settlement.FOREIGN
    assert settle(dispatch, lease, 0.2).kind is Settlement.FRESH
    assert settle(dispatch, lease, 0.3, wid=EVE).kind is Settlement.FOREIGN


def test_a_foreign_result_is_no_sign_of_progress() -> None:
    dispatch, lease = with_one_lease()
    settle(dispatch, lease, 9.0, epoch=EPOCH - 1)
    assert len(dispatch.give_up(LEASE_SECONDS)) == 1


def test_a_result_of_a_batch_that_was_never_cut_is_unknown() -> None:
    other = Dispatch(EPOCH, 2)
    submit(other, 2)
    other.admit(ANN, 1, 2, [], 0.0)
    (lease,) = other.leases(0.0)
    assert settle(with_work(n=0), lease, 0.1).kind is Settlement.UNKNOWN


def test_settled_batches_are_forgotten_in_the_end() -> None:
    dispatch = with_work(n=MOST_SETTLED + 10, batch_size=1)
    first, _ = dispatch.leases(0.0)
    settle(dispatch, first, 0.0)
    for _ in range(MOST_SETTLED):
        settle(dispatch, dispatch.leases(0.0)[0], 0.0)
    assert len(dispatch._batches._settled) == MOST_SETTLED
    assert settle(dispatch, first, 1.0).kind is Settlement.UNKNOWN


def test_each_kind_of_result_is_counted() -> None:
    dispatch, lease = with_one_lease()
    settle(dispatch, lease, 0.1, epoch=1)
    replies = [settle(dispatch, lease, 0.1) for _ in range(3)]
    assert [reply.rows is None for reply in replies] == [False, True, True]
    counted = {name: count for name, count in dispatch.counters.items() if count}
    assert counted == {"foreign": 1, "fresh": 1, "duplicate": 2, "leased": 1}


@pytest.mark.parametrize(
    "wrong", [{"n": 1}, {"n": 3}, {"failures": failures((2,))}, {"run": "other"}], ids=str
)
def test_a_result_that_does_not_fit_its_batch_is_refused_and_changes_nothing(wrong) -> None:
    dispatch, lease = with_one_lease()
    answer = structs.replace(result(lease), **wrong)
    with pytest.raises(MessageError):
        dispatch.settle(ANN, answer, SHAPE.empty(answer.n), 0.1)
    assert dispatch.leases(0.1) == []
    assert settle(dispatch, lease, 0.2).kind is Settlement.FRESH


# 6. Poison.


def test_failed_rows_are_leased_again_each_on_its_own() -> None:
    dispatch = with_work(n=6, batch_size=6)
    (lease,) = dispatch.leases(0.0)
    settled = settle(dispatch, lease, 0.1, failed=(4, 1))
    assert settled.rows["index"].tolist() == [0, 2, 3, 5]
    assert settled.failures == ()
    assert indices(dispatch.leases(0.2)) == [[1], [4]]


def test_a_row_that_failed_three_times_is_an_error_with_its_reason() -> None:
    dispatch = with_work(n=3, batch_size=3)
    (lease,) = dispatch.leases(0.0)
    settle(dispatch, lease, 0.1, failed=(1,))
    for _ in range(STRIKES - 2):
        (lease,) = dispatch.leases(0.2)
        settled = settle(dispatch, lease, 0.3, failed=(0,))
        assert len(settled.rows) == 0
    (lease,) = dispatch.leases(0.4)
    settled = settle(dispatch, lease, 9.0, failed=(0,))
    assert settled.failures == (Failure(row=0, reason="row 0 burst"),)
    (row,) = settled.rows
    assert (row["outcome"], row["index"], row["nu"]) == (Outcome.ERROR, 1, 0)
    assert row["genome"].tobytes() == genomes(3)[1].tobytes()
    assert (dispatch.leases(9.1), dispatch.counters["errors"], dispatch.counters["failures"]) == ([], 1, 3)


def test_a_row_that_succeeds_in_the_end_is_no_error() -> None:
    dispatch = with_work(n=1)
    for now in range(STRIKES - 1):
        settle(dispatch, dispatch.leases(now)[0], now, failed=(0,))
    settled = settle(dispatch, dispatch.leases(9.0)[0], 9.0)
    assert (settled.rows["outcome"].tolist(), settled.failures) == ([Outcome.HELD], ())


def test_lost_workers_are_no_evidence_against_a_row() -> None:
    dispatch = with_work(n=1)
    for turn in range(3 * STRIKES):
        now = 10.0 * turn
        dispatch.leases(now)
        lose(dispatch, now)
        dispatch.admit(ANN, turn + 2, 2, [], now + 2)
    (lease,) = dispatch.leases(1000.0)
    assert (lease.attempt, lease.batch.tried_by) == (3 * STRIKES + 1, ())


def test_two_results_of_a_failed_row_count_once() -> None:
    dispatch = with_work(n=1)
    (lease,) = dispatch.leases(0.0)
    settle(dispatch, lease, 0.1, failed=(0,))
    assert settle(dispatch, lease, 0.2, failed=(0,)).kind is Settlement.DUPLICATE
    (again,) = dispatch.leases(0.3)
    assert [name.wid for name in again.batch.tried_by] == [ANN]


# 3. The join fence.


def test_what_a_worker_does_not_hold_when_it_rejoins_is_leased_again_under_the_new_join() -> None:
    dispatch = with_work(n=4)
    held, dropped = dispatch.leases(0.0)
    assert dispatch.admit(ANN, 2, 2, [held.batch.id], 0.1) == []
    (again,) = dispatch.leases(0.2)
    assert (again.batch.id, again.attempt, again.join) == (dropped.batch.id, 2, 2)
    assert settle(dispatch, held, 0.3).kind is Settlement.FRESH


def test_nothing_is_evaluated_twice_for_a_rejoin_with_everything_in_hand() -> None:
    dispatch = with_work(n=4)
    dispatch.admit(ANN, 2, 2, [lease.batch.id for lease in dispatch.leases(0.0)], 0.1)
    assert (dispatch.leases(0.2), dispatch.counters["requeued"]) == ([], 0)


def test_a_worker_is_told_to_drop_what_others_have_or_nobody_wants() -> None:
    dispatch = with_work(n=8)
    settled, moved, open_ = *dispatch.leases(0.0), b"\0" * 16
    settle(dispatch, settled, 0.1)
    lose(dispatch, 0.1)
    dispatch.admit(BOB, 1, 1, [], 1.2)
    (lease,) = dispatch.leases(1.2)
    assert lease.batch.id == moved.batch.id
    held = [settled.batch.id, moved.batch.id, open_]
    assert dispatch.admit(ANN, 2, 2, held, 1.3) == held


def test_a_worker_may_go_on_with_what_was_queued_again_meanwhile() -> None:
    dispatch = with_work(n=4)
    leases = dispatch.leases(0.0)
    lose(dispatch, 0.1)
    assert dispatch.queued_seconds > 0
    assert dispatch.admit(ANN, 2, 2, [lease.batch.id for lease in leases], 1.5) == []
    assert (dispatch.queued_seconds, dispatch.leases(1.6)) == (0, [])


def test_nobody_may_go_on_with_what_it_was_never_leased() -> None:
    dispatch, lease = with_one_lease()
    assert dispatch.admit(EVE, 1, 2, [lease.batch.id], 0.1) == [lease.batch.id]
    lose(dispatch, 0.1)
    assert dispatch.admit(EVE, 2, 2, [lease.batch.id], 1.2) == [lease.batch.id]


@pytest.mark.parametrize("number", [1, 2])
def test_an_overtaken_join_changes_nothing(number: int) -> None:
    dispatch = with_work(n=4)
    dispatch.admit(ANN, 2, 2, [], 0.0)
    dispatch.leases(0.1)
    requeued = dispatch.counters["requeued"]
    assert dispatch.admit(ANN, number, 2, [], 0.2) == []
    assert (dispatch.queued_seconds, dispatch.counters["requeued"]) == (0, requeued)


# 4. Leases end.


def test_a_vanished_worker_is_given_up_after_a_second() -> None:
    dispatch = with_work(n=4, workers=(ANN, BOB))
    anns = [lease.batch.id for lease in dispatch.leases(0.0) if lease.wid == ANN]
    dispatch.workers.on_token(ANN, False, 3.0)
    assert dispatch.workers.next_deadline() == 3.0 + TOKEN_GRACE
    assert dispatch.give_up(3.0 + TOKEN_GRACE - 0.01) == []
    (lost,) = dispatch.give_up(3.0 + TOKEN_GRACE)
    assert (lost.worker.wid, lost.batches, lost.reason) == (ANN, anns, "its token vanished")
    assert dispatch.workers.get(ANN) is None
    (again,) = dispatch.leases(4.0)
    assert (again.wid, again.attempt) == (BOB, 2)


def test_news_of_the_same_loss_puts_nothing_off() -> None:
    dispatch = with_work(n=4)
    dispatch.leases(0.0)
    dispatch.workers.on_token(ANN, False, 3.0)
    dispatch.workers.on_token(ANN, False, 3.9)
    assert len(dispatch.give_up(3.0 + TOKEN_GRACE)) == 1


def test_a_worker_that_comes_back_within_the_second_keeps_its_batches() -> None:
    dispatch = with_work(n=4)
    dispatch.leases(0.0)
    dispatch.workers.on_token(ANN, False, 3.0)
    dispatch.workers.on_token(ANN, True, 3.5)
    assert dispatch.give_up(3.0 + TOKEN_GRACE) == []
    assert dispatch.counters["requeued"] == 0


def test_a_vanished_worker_is_leased_nothing_even_if_a_late_result_of_it_arrives() -> None:
    dispatch = with_work(n=10)
    lease, _ = dispatch.leases(0.0)
    dispatch.workers.on_token(ANN, False, 0.1)
    assert settle(dispatch, lease, 0.2).kind is Settlement.FRESH
    assert dispatch.leases(0.3) == []
    assert len(dispatch.give_up(0.1 + TOKEN_GRACE)) == 1


def test_nobody_is_given_up_while_our_own_link_is_down() -> None:
    dispatch = with_work(n=4, workers=(ANN, BOB))
    dispatch.leases(0.0)
    dispatch.workers.on_link(False, 1.0)
    for wid in (ANN, BOB):
        dispatch.workers.on_token(wid, False, 1.0)
    assert dispatch.workers.next_deadline() == inf
    assert dispatch.give_up(500.0) == []
    dispatch.workers.on_link(True, 500.0)
    dispatch.workers.on_token(ANN, True, 500.1)
    assert [lost.worker.wid for lost in dispatch.give_up(500.0 + TOKEN_GRACE)] == [BOB]


def test_a_silent_worker_is_given_up_when_its_lease_is_over() -> None:
    dispatch = with_work(n=4, workers=(ANN, BOB))
    _, bobs = sorted(dispatch.leases(0.0), key=lambda lease: lease.wid)
    settle(dispatch, bobs, 1.0)
    assert dispatch.workers.next_deadline() == LEASE_SECONDS
    (lost,) = dispatch.give_up(LEASE_SECONDS)
    assert (lost.worker.wid, lost.reason) == (ANN, "no sign of progress for 10 seconds")
    assert [lease.wid for lease in dispatch.leases(LEASE_SECONDS)] == [BOB]


def test_signs_of_progress_put_the_end_of_a_lease_off() -> None:
    dispatch = with_work(n=4)
    dispatch.leases(0.0)
    dispatch.workers.progressed(ANN, 8.0)
    assert dispatch.give_up(LEASE_SECONDS) == []
    assert dispatch.workers.next_deadline() == 8.0 + LEASE_SECONDS


def test_the_lease_begins_when_an_idle_worker_gets_work() -> None:
    dispatch = Dispatch(EPOCH, 2)
    dispatch.admit(ANN, 1, 2, [], 0.0)
    submit(dispatch, 4)
    dispatch.leases(100.0)
    assert dispatch.give_up(100.0 + LEASE_SECONDS / 2) == []


def test_leases_are_longer_where_batches_take_longer() -> None:
    dispatch = with_work(n=100, batch_size=1)
    for now in range(0, 60, 3):
        (lease, *_) = dispatch.leases(now)
        settle(dispatch, lease, now + 3)
    dispatch.leases(60.0)
    assert dispatch.give_up(60.0 + 25) == []
    assert 60.0 + 25 < dispatch.workers.next_deadline() < 60.0 + 35


def test_a_stuck_worker_gets_nothing_until_it_shows_progress() -> None:
    dispatch = with_work(n=20, workers=(ANN, BOB))
    anns = [lease for lease in dispatch.leases(0.0) if lease.wid == ANN]
    dispatch.workers.progressed(BOB, 9.0)
    assert [lost.worker.wid for lost in dispatch.give_up(LEASE_SECONDS)] == [ANN]
    assert len(dispatch.workers) == 1
    assert dispatch.leases(10.0) == []  # Bob's credit is used up
    settle(dispatch, anns[0], 11.0)
    assert {lease.wid for lease in dispatch.leases(11.0)} == {ANN}


def test_where_all_workers_are_stuck_all_of_them_are_tried_in_turn() -> None:
    dispatch = with_work(n=1, workers=(ANN, BOB, EVE))
    tried = []
    for turn in range(6):
        tried += [lease.wid for lease in dispatch.leases(turn * LEASE_SECONDS)]
        dispatch.give_up((turn + 1) * LEASE_SECONDS)
    assert set(tried[:3]) == set(tried[3:]) == {ANN, BOB, EVE}
