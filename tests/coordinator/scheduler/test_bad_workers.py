"""Workers that are sick, late or wrong, and the treatment of their rows."""

from collections.abc import Sequence

import pytest
from tests.coordinator.scheduler.leases import EPOCH, SHAPE, Dispatch, indices, result, settle, submit
from tests.fakes.messages import ANN, BOB, EVE, FAY, join_message

from qdgrasp_coordinator.scheduler.batch_dispatcher import EARLY_SECONDS, STRIKES
from qdgrasp_coordinator.scheduler.batch_queue import Lease, Settlement
from qdgrasp_coordinator.scheduler.cross_checks import CHECKED_ROWS, CHECKED_SHARE
from qdgrasp_coordinator.scheduler.worker import SICK_SECONDS, TOKEN_GRACE
from qdgrasp_coordinator.scheduler.worker_registry import (
    AWAY_SECONDS,
    FIRST_STRAGGLER_SECONDS,
    LEASE_SECONDS,
    SICK_FAULTS,
    STRAGGLER_SECONDS,
)
from qdgrasp_protocol.messages import Heartbeat
from qdgrasp_protocol.rows import Outcome

FAR = 1000.0  # Long after the first join
NODES = {ANN: "node1", BOB: "node1", EVE: "node2", FAY: "node3"}


def pool(
    *wids: str, n: int = 40, batch_size: int | None = 4, credit: int = 1, checked: float = 0.0
) -> Dispatch:
    """A dispatcher with rows for these workers, each on its node."""
    dispatch = Dispatch(EPOCH, batch_size, checked)
    submit(dispatch, n)
    for wid in wids:
        admit(dispatch, wid, credit=credit)
    return dispatch


def admit(dispatch: Dispatch, wid: str, now: float = 0.0, credit: int = 1) -> None:
    dispatch.workers.on_token(wid, True, now)
    dispatch.join(join_message(wid, 1, credit, [], host=NODES[wid]), now)


def by_worker(leases: Sequence[Lease]) -> dict[str, Lease]:
    return {lease.wid: lease for lease in leases}


def answer(dispatch: Dispatch, lease: Lease, now: float = 0.1, *, shift: float = 0.0) -> Settlement:
    """Settle a lease with true results, or others."""
    rows = SHAPE.empty(len(lease.batch))
    rows["outcome"], rows["nu"] = Outcome.HELD, lease.batch.rows.indices + shift
    return dispatch.settle(lease.wid, result(lease), rows, now).kind


def released(dispatch: Dispatch) -> list[tuple[str, list[int]]]:
    """Workers and rows of results that are held no longer."""
    return [(one.worker.wid, one.rows["index"].tolist()) for one in dispatch.take_released(FAR)]


# Failed rows go to other workers, on other hosts first.


def test_a_row_that_failed_goes_to_another_host_where_there_is_one() -> None:
    dispatch = pool(ANN, BOB, EVE, n=1)
    (lease,) = dispatch.leases(0.0)
    assert lease.wid == ANN
    settle(dispatch, lease, 0.1, failed=(0,))
    (again,) = dispatch.leases(0.2)
    assert again.wid == EVE


def test_a_row_that_failed_on_a_host_waits_for_the_other_one_while_that_is_busy() -> None:
    dispatch = pool(ANN, BOB, EVE, n=3, batch_size=1)
    leases = by_worker(dispatch.leases(0.0))
    settle(dispatch, leases[ANN], 0.1, failed=(0,))
    settle(dispatch, leases[BOB], 0.2)
    assert dispatch.leases(0.3) == []
    settle(dispatch, leases[EVE], 0.4)
    assert [lease.wid for lease in dispatch.leases(0.5)] == [EVE]


def test_a_row_that_failed_goes_to_another_worker_of_the_same_host_where_there_is_no_other_host() -> None:
    dispatch = pool(ANN, BOB, n=1)
    (lease,) = dispatch.leases(0.0)
    settle(dispatch, lease, 0.1, failed=(0,))
    assert [lease.wid for lease in dispatch.leases(0.2)] == [BOB]


def test_one_worker_never_makes_an_error_of_a_row_that_another_may_try() -> None:
    dispatch = pool(ANN, n=1)
    for turn in range(STRIKES - 1):
        (lease,) = dispatch.leases(turn)
        settle(dispatch, lease, turn, failed=(0,))
    admit(dispatch, EVE, 5.0)
    (lease,) = dispatch.leases(5.0)
    assert lease.wid == EVE
    settled = settle(dispatch, lease, 5.1)
    assert (settled.rows["outcome"].tolist(), dispatch.counters["errors"]) == ([Outcome.HELD], 0)


def test_a_row_that_fails_on_three_workers_is_an_error() -> None:
    dispatch = pool(ANN, EVE, FAY, n=1)
    for turn in range(STRIKES):
        (lease,) = dispatch.leases(turn)
        settled = settle(dispatch, lease, turn, failed=(0,))
    assert len(settled.failures) == 1
    assert dispatch.counters["errors"] == 1


# Sick workers are left out for a while.


def sicken(dispatch: Dispatch, wid: str, now: float) -> None:
    """Let rows fail on a worker, and not on the others, until it is sick."""
    for turn in range(SICK_FAULTS):
        for lease in dispatch.leases(now + turn):
            settle(dispatch, lease, now + turn, failed=(0,) if lease.wid == wid else ())
        for lease in dispatch.leases(now + turn + 0.5):
            settle(dispatch, lease, now + turn + 0.5)


def test_a_worker_on_which_rows_fail_that_others_evaluate_gets_no_work_for_a_while() -> None:
    dispatch = pool(ANN, EVE, n=100, batch_size=1)
    sicken(dispatch, ANN, 0.0)
    (sick,) = dispatch.take_sick()
    assert (sick.wid, sick.state, sick.is_well) == (ANN, "sick", False)
    assert {lease.wid for lease in dispatch.leases(9.0)} == {EVE}
    assert dispatch.workers.next_deadline() <= 9.0 + SICK_SECONDS
    assert [worker.wid for worker in dispatch.workers.recovered(9.0 + SICK_SECONDS)] == [ANN]
    assert ANN in {lease.wid for lease in dispatch.leases(9.0 + SICK_SECONDS)}


def test_a_worker_that_is_sick_again_is_left_out_for_twice_as_long() -> None:
    dispatch = pool(ANN, EVE, n=200, batch_size=1)
    sicken(dispatch, ANN, 0.0)
    first = dispatch.take_sick()[0].sick_until
    dispatch.workers.recovered(first)
    sicken(dispatch, ANN, first)
    (again,) = dispatch.take_sick()
    assert again.sick_until - first >= 2 * SICK_SECONDS


def test_rows_that_fail_everywhere_make_nobody_sick() -> None:
    dispatch = pool(ANN, EVE, FAY, n=30, batch_size=1)
    for now in range(100):
        for lease in dispatch.leases(now):
            settle(dispatch, lease, now, failed=(0,))
    assert dispatch.counters["errors"] == 30
    assert dispatch.take_sick() == []


def test_where_all_are_sick_all_get_work() -> None:
    dispatch = pool(ANN, EVE, n=200, batch_size=1)
    sicken(dispatch, ANN, 0.0)
    worker = dispatch.workers.get(EVE)
    for _ in range(SICK_FAULTS):
        dispatch.workers.blame(EVE, 10.0)
    assert worker.is_sick
    assert {lease.wid for lease in dispatch.leases(11.0)} == {ANN, EVE}


def test_a_few_faults_among_many_good_rows_make_nobody_sick() -> None:
    dispatch = pool(ANN, n=1)
    for _ in range(20):
        dispatch.workers.blame(ANN, 0.0)
        dispatch.workers.on_settled(ANN, 100, 0.0)
    assert not dispatch.workers.get(ANN).is_sick


# Batches that are held for long go to a second worker too.


def test_what_a_straggler_holds_is_leased_to_an_idle_worker_too_and_the_first_answer_counts() -> None:
    dispatch = pool(ANN, EVE, n=4, batch_size=4)
    (slow,) = dispatch.leases(0.0)
    assert dispatch.leases(FIRST_STRAGGLER_SECONDS - 0.1) == []
    (second,) = dispatch.leases(FIRST_STRAGGLER_SECONDS)
    assert (second.wid, second.batch.id, second.attempt) == (EVE, slow.batch.id, 2)
    settled = settle(dispatch, second, FIRST_STRAGGLER_SECONDS + 0.5)
    assert (settled.kind, settled.superseded) == (Settlement.FRESH, (ANN,))
    assert settle(dispatch, slow, 9.0).kind is Settlement.LATE
    assert dispatch.counters["doubled"] == 1


def test_batches_that_are_quick_have_a_straggler_sooner_and_slow_ones_later() -> None:
    for turnaround, limit in ((0.05, STRAGGLER_SECONDS), (1.0, 3.0)):
        dispatch = pool(ANN, EVE, n=8, batch_size=4)
        leases = by_worker(dispatch.leases(0.0))
        settle(dispatch, leases[EVE], turnaround)
        assert dispatch.leases(limit - 0.01) == []
        assert [lease.batch.id for lease in dispatch.leases(limit)] == [leases[ANN].batch.id]


def test_a_batch_has_two_holders_at_most() -> None:
    dispatch = pool(ANN, EVE, FAY, n=4, batch_size=4)
    dispatch.leases(0.0)
    assert len(dispatch.leases(5.0)) == 1
    assert dispatch.leases(50.0) == []


def test_a_batch_is_not_leased_to_a_second_worker_while_rows_wait() -> None:
    dispatch = pool(ANN, EVE, n=12, batch_size=4)
    settle(dispatch, by_worker(dispatch.leases(0.0))[EVE], 5.0)
    (lease,) = dispatch.leases(5.1)
    assert indices([lease]) == [[8, 9, 10, 11]]


def test_a_batch_that_one_of_two_holders_loses_stays_with_the_other() -> None:
    dispatch = pool(ANN, EVE, n=4, batch_size=4)
    dispatch.leases(0.0)
    (second,) = dispatch.leases(FIRST_STRAGGLER_SECONDS)
    dispatch.workers.on_token(ANN, False, 3.0)
    dispatch.give_up(3.0 + TOKEN_GRACE)
    assert dispatch.counters["requeued"] == 0
    assert settle(dispatch, second, 5.0).superseded == ()


def test_a_batch_that_both_holders_lose_is_queued_once() -> None:
    dispatch = pool(ANN, EVE, n=4, batch_size=4)
    dispatch.leases(0.0)
    dispatch.leases(FIRST_STRAGGLER_SECONDS)
    for wid in (ANN, EVE):
        dispatch.workers.on_token(wid, False, 3.0)
    dispatch.give_up(3.0 + TOKEN_GRACE)
    admit(dispatch, FAY, 5.0, credit=2)
    assert indices(dispatch.leases(5.0)) == [[0, 1, 2, 3]]


def test_a_stopped_simulator_holds_its_batch_for_no_longer_than_a_straggler() -> None:
    dispatch = pool(ANN, EVE, n=8, batch_size=4)
    leases = by_worker(dispatch.leases(0.0))
    settle(dispatch, leases[EVE], 0.2)
    for second in range(1, 4):
        for wid in (ANN, EVE):
            beat = Heartbeat(wid=wid, host="node", progressed=wid == EVE)
            dispatch.workers.on_heartbeat(wid, beat, second)
    assert FIRST_STRAGGLER_SECONDS < 4 < LEASE_SECONDS
    assert [(lease.wid, lease.batch.id) for lease in dispatch.leases(4.0)] == [(EVE, leases[ANN].batch.id)]


# Results are checked by other workers.


def test_the_results_of_a_new_worker_wait_until_another_one_agrees() -> None:
    dispatch = pool(ANN, EVE, checked=CHECKED_SHARE)
    leases = by_worker(dispatch.leases(0.0))
    answer(dispatch, leases[ANN])
    assert released(dispatch) == []
    answer(dispatch, leases[EVE])
    assert released(dispatch) == []
    while not (found := released(dispatch)):
        checks = [lease for lease in dispatch.leases(0.3) if lease.batch.check]
        assert [len(lease.batch) for lease in checks] == [CHECKED_ROWS // 2] * len(checks)
        answer(dispatch, checks[0], 0.4)
    assert sorted(found) == sorted([(ANN, indices([leases[ANN]])[0]), (EVE, indices([leases[EVE]])[0])])
    (verdict,) = dispatch.take_verdicts()
    assert ({name.wid for name in verdict.right}, verdict.wrong) == ({ANN, EVE}, ())


def test_the_results_of_confirmed_workers_count_at_once() -> None:
    dispatch = confirmed(ANN, EVE)
    for lease in dispatch.leases(2.0):
        assert settle(dispatch, lease, 2.1).rows is not None


def test_a_lone_worker_is_not_checked() -> None:
    dispatch = pool(ANN, checked=1.0)
    (lease,) = dispatch.leases(0.0)
    assert settle(dispatch, lease, EARLY_SECONDS).rows is not None


def test_no_share_checks_nobody() -> None:
    dispatch = pool(ANN, EVE, checked=0.0)
    for lease in dispatch.leases(0.0):
        assert settle(dispatch, lease, 0.1).rows is not None


def confirmed(*wids: str, n: int = 400, checked: float = CHECKED_SHARE) -> Dispatch:
    """A dispatcher with workers that agreed with one another."""
    dispatch = pool(*wids, n=n, checked=checked)
    while not all(not dispatch.checks.must_wait(dispatch.workers.get(wid).name) for wid in wids):
        for lease in dispatch.leases(0.0):
            answer(dispatch, lease)
        dispatch.take_released(FAR)
    dispatch.take_verdicts()
    return dispatch


@pytest.mark.parametrize("share", [0.02, 0.2])
def test_as_many_rows_are_checked_as_the_share_says(share: float) -> None:
    dispatch = pool(ANN, EVE, n=4000, batch_size=10, checked=share)
    now = 0.0
    while leases := dispatch.leases(now):
        now += 0.1
        for lease in leases:
            answer(dispatch, lease, now)
        dispatch.take_released(FAR)
    assert dispatch.counters["differing"] == 0
    assert 0.5 * share * 4000 < dispatch.counters["checked"] < 1.5 * share * 4000 + 2 * CHECKED_ROWS


def test_a_liar_is_found_by_a_third_worker_and_its_rows_are_evaluated_again() -> None:
    dispatch = pool(ANN, EVE, FAY, n=12, checked=CHECKED_SHARE)
    taken: dict[int, str] = {}
    now = 0.0
    while leases := dispatch.leases(now):
        now += 0.1
        for lease in leases:
            rows = SHAPE.empty(len(lease.batch))
            rows["outcome"] = Outcome.HELD
            rows["nu"] = lease.batch.rows.indices + (0.5 if lease.wid == EVE else 0.0)
            settled = dispatch.settle(lease.wid, result(lease), rows, now)
            if settled.rows is not None:
                taken |= dict.fromkeys(settled.rows["index"].tolist(), lease.wid)
        for one in dispatch.take_released(FAR):
            assert one.rows["nu"].tolist() == one.rows["index"].tolist()
            taken |= dict.fromkeys(one.rows["index"].tolist(), one.worker.wid)
    assert sorted(taken) == list(range(12))
    assert set(taken.values()) == {ANN, FAY}
    assert [name.wid for verdict in dispatch.take_verdicts() for name in verdict.wrong] == [EVE]
    assert dispatch.counters["differing"] > 0
    assert dispatch.workers.get(EVE).state == "excluded"


def test_a_check_that_a_straggler_holds_is_leased_to_a_third_worker_too() -> None:
    dispatch = pool(ANN, EVE, FAY, n=4, batch_size=4, checked=1.0)
    (first,) = dispatch.leases(0.0)
    answer(dispatch, first, 0.05)
    (check,) = dispatch.leases(1.0)
    late = 1.0 + STRAGGLER_SECONDS
    assert dispatch.leases(late - 0.01) == []
    (second,) = dispatch.leases(late)
    assert second.batch.id == check.batch.id
    assert {first.wid, check.wid, second.wid} == {ANN, EVE, FAY}
    assert answer(dispatch, second, late + 0.05) is Settlement.FRESH
    assert released(dispatch) == [(first.wid, [0, 1, 2, 3])]
    assert answer(dispatch, check, late + 1.0) is Settlement.LATE
    assert (dispatch.counters["doubled"], dispatch.counters["differing"]) == (1, 0)


def test_nothing_of_an_excluded_worker_counts_any_more() -> None:
    dispatch = confirmed(ANN, FAY)
    admit(dispatch, EVE, 1.0, credit=2)
    leases = [lease for lease in dispatch.leases(1.0) if lease.wid == EVE]
    dispatch.checks.excluded.add(EVE)
    assert answer(dispatch, leases[0]) is Settlement.FOREIGN


def dispute() -> Dispatch:
    """A dispatcher with two workers that have answered the same rows differently."""
    dispatch = pool(ANN, EVE, n=8, checked=CHECKED_SHARE)
    for turn in range(3):
        for lease in dispatch.leases(turn):
            answer(dispatch, lease, turn, shift=0.5 if lease.wid == EVE else 0.0)
        dispatch.take_released(FAR)
    assert len(list(dispatch.checks.disputes)) >= 1
    return dispatch


def test_two_workers_that_disagree_wait_for_a_third_and_the_job_says_so() -> None:
    dispatch = dispute()
    assert released(dispatch) == []
    assert dispatch.trouble.startswith("workers ")
    assert "node1" in dispatch.trouble
    assert "node2" in dispatch.trouble
    admit(dispatch, FAY, 5.0)
    assert dispatch.trouble == ""
    while leases := dispatch.leases(5.0):
        for lease in leases:
            answer(dispatch, lease, 5.0, shift=0.5 if lease.wid == EVE else 0.0)
        dispatch.take_released(FAR)
    assert {name.wid for verdict in dispatch.take_verdicts() for name in verdict.wrong} == {EVE}


def test_of_two_workers_that_disagree_the_one_that_stays_is_believed() -> None:
    dispatch = dispute()
    dispatch.workers.drain(EVE)
    assert {wid for wid, _ in released(dispatch)} == {ANN}
    assert {name.wid for verdict in dispatch.take_verdicts() for name in verdict.wrong} == {EVE}


def test_a_check_that_nobody_else_can_make_ends_and_its_results_count() -> None:
    dispatch = pool(ANN, EVE, n=8, checked=CHECKED_SHARE)
    leases = by_worker(dispatch.leases(0.0))
    answer(dispatch, leases[ANN])
    assert released(dispatch) == []
    dispatch.workers.on_token(EVE, False, 0.2)
    dispatch.give_up(0.2 + TOKEN_GRACE)
    assert released(dispatch) == [(ANN, indices([leases[ANN]])[0])]


def test_a_check_on_which_the_simulator_fails_goes_to_others_and_then_ends() -> None:
    dispatch = pool(ANN, EVE, FAY, BOB, n=4, batch_size=4, checked=CHECKED_SHARE)
    (lease,) = dispatch.leases(0.0)
    answer(dispatch, lease)
    dispatch.take_released(FAR)
    tried = set()
    for now in range(1, 4):
        (check,) = dispatch.leases(now)
        tried.add(check.wid)
        settle(dispatch, check, now, failed=(0,))
    assert len(tried) == 3
    assert released(dispatch) == [(lease.wid, [0, 1, 2, 3])]


def test_a_withdrawn_run_leaves_no_checks_and_no_results() -> None:
    dispatch = pool(ANN, EVE, checked=CHECKED_SHARE)
    for lease in dispatch.leases(0.0):
        answer(dispatch, lease)
    dispatch.take_released(FAR)
    dispatch.withdraw("run")
    assert (dispatch.checks.held, dispatch.checks.are_open, dispatch.leases(1.0)) == ([], False, [])


# Workers that were there lately, or before a coordinator took over, are expected back.


def taken_over(n: int, checked: float = 0.0) -> Dispatch:
    """A dispatcher of a coordinator that took over, with one worker so far."""
    dispatch = Dispatch(EPOCH, 4, checked, takes_over=True)
    submit(dispatch, n)
    admit(dispatch, EVE)
    return dispatch


def test_what_the_first_worker_answers_a_coordinator_that_took_over_waits_for_others() -> None:
    dispatch = taken_over(8, CHECKED_SHARE)
    (lease,) = dispatch.leases(0.0)
    answer(dispatch, lease)
    assert dispatch.take_released(EARLY_SECONDS - 0.1) == []
    assert [one.worker.wid for one in dispatch.take_released(EARLY_SECONDS)] == [EVE]


def test_a_row_that_failed_waits_for_others_after_a_coordinator_took_over() -> None:
    dispatch = taken_over(1)
    (lease,) = dispatch.leases(0.0)
    settle(dispatch, lease, 0.1, failed=(0,))
    assert dispatch.leases(EARLY_SECONDS - 0.1) == []
    assert [lease.wid for lease in dispatch.leases(EARLY_SECONDS)] == [EVE]


def test_what_a_new_worker_answers_waits_for_those_that_were_there_lately() -> None:
    dispatch = pool(ANN, EVE, n=8, checked=CHECKED_SHARE)
    leases = by_worker(dispatch.leases(0.0))
    dispatch.workers.on_token(ANN, False, 1.0)
    dispatch.give_up(1.0 + TOKEN_GRACE)
    answer(dispatch, leases[EVE], 3.0)
    assert dispatch.take_released(AWAY_SECONDS) == []
    assert [one.worker.wid for one in dispatch.take_released(3.0 + AWAY_SECONDS)] == [EVE]


def test_nobody_waits_for_a_worker_that_has_left() -> None:
    dispatch = pool(ANN, EVE, n=8, checked=CHECKED_SHARE)
    leases = by_worker(dispatch.leases(0.0))
    dispatch.join(join_message(ANN, 2, 0, [], host=NODES[ANN]), 0.5)
    dispatch.workers.on_token(ANN, False, 1.0)
    dispatch.give_up(1.0 + TOKEN_GRACE)
    assert settle(dispatch, leases[EVE], 3.0).rows is not None
