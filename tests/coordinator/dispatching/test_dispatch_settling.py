"""Which result counts, and what becomes of rows that the simulator fails on: rules 5 and 6."""

import pytest
from tests.coordinator.dispatching.leases import (
    ANN,
    BOB,
    EPOCH,
    EVE,
    SHAPE,
    genomes,
    indices,
    settle,
    submit,
    with_work,
)

from qdgrasp_coordinator.dispatching.batch import Settlement
from qdgrasp_coordinator.dispatching.dispatch import STRIKES, Dispatch
from qdgrasp_coordinator.dispatching.member import GRACE
from qdgrasp_coordinator.dispatching.pace import LEASE_SECONDS
from qdgrasp_coordinator.dispatching.tickets import REMEMBERED
from qdgrasp_protocol.errors import MessageError
from qdgrasp_protocol.messages import Failure, Result
from qdgrasp_protocol.outcome import Outcome

# 5. Settle once.


def test_a_fresh_result_gives_complete_rows() -> None:
    dispatch = with_work(n=10, batch_size=5)
    _, lease = dispatch.leases(0.0)
    settled = settle(dispatch, lease, 0.5)
    assert settled.kind is Settlement.FRESH
    assert settled.rows is not None
    assert settled.rows["index"].tolist() == settled.rows["nu"].tolist() == [5, 6, 7, 8, 9]
    assert settled.rows["genome"].tobytes() == genomes(10)[5:].tobytes()
    assert (settled.rows["outcome"] == Outcome.HELD).all()
    assert (settled.cpu_seconds, settled.failures, settled.superseded) == (0.5, (), None)


def test_a_second_result_of_the_same_worker_is_a_duplicate() -> None:
    dispatch = with_work()
    lease, _ = dispatch.leases(0.0)
    settle(dispatch, lease, 0.1)
    again = settle(dispatch, lease, 0.2)
    assert (again.kind, again.rows) == (Settlement.DUPLICATE, None)


def test_the_first_of_two_workers_wins_and_the_other_is_late() -> None:
    dispatch = with_work(n=2)
    (zombies,) = dispatch.leases(0.0)
    dispatch.join(BOB, 1, 2, [], 1.0)
    dispatch.tick(LEASE_SECONDS)
    (bobs,) = dispatch.leases(LEASE_SECONDS)
    assert (bobs.wid, bobs.batch) == (BOB, zombies.batch)
    settled = settle(dispatch, zombies, 11.0)
    assert (settled.kind, settled.superseded) == (Settlement.FRESH, BOB)
    assert settle(dispatch, bobs, 12.0).kind is Settlement.LATE
    assert (dispatch.leases(13.0), dispatch.queued_seconds) == ([], 0)


def test_a_worker_that_was_overtaken_has_its_credit_back_at_once() -> None:
    dispatch = with_work(n=2)
    (zombies,) = dispatch.leases(0.0)
    dispatch.join(BOB, 1, 1, [], 1.0)
    dispatch.tick(LEASE_SECONDS)
    (bobs,) = dispatch.leases(LEASE_SECONDS)
    settle(dispatch, zombies, 11.0)
    dispatch.gone(ANN, 11.0)
    submit(dispatch, 2, generation=1)
    assert [lease.wid for lease in dispatch.leases(11.0)] == [BOB]
    assert settle(dispatch, bobs, 12.0).kind is Settlement.LATE
    assert dispatch.leases(12.0) == []


def test_a_result_settles_a_batch_that_waits_to_be_leased_again() -> None:
    dispatch = with_work(n=2)
    (lease,) = dispatch.leases(0.0)
    dispatch.gone(ANN, 0.1)
    dispatch.tick(0.1 + GRACE)
    assert settle(dispatch, lease, 2.0).kind is Settlement.FRESH
    dispatch.join(BOB, 1, 2, [], 2.0)
    assert dispatch.leases(2.0) == []


def test_results_of_other_epochs_and_other_workers_are_foreign() -> None:
    dispatch = with_work(n=2)
    dispatch.join(EVE, 1, 0, [], 0.0)
    (lease,) = dispatch.leases(0.0)
    assert settle(dispatch, lease, 0.1, epoch=EPOCH - 1).kind is Settlement.FOREIGN
    assert settle(dispatch, lease, 0.1, wid=EVE).kind is Settlement.FOREIGN
    assert settle(dispatch, lease, 0.2).kind is Settlement.FRESH
    assert settle(dispatch, lease, 0.3, wid=EVE).kind is Settlement.FOREIGN


def test_a_foreign_result_is_no_sign_of_progress() -> None:
    dispatch = with_work(n=2)
    (lease,) = dispatch.leases(0.0)
    settle(dispatch, lease, 9.0, epoch=EPOCH - 1)
    assert len(dispatch.tick(LEASE_SECONDS)) == 1


def test_a_result_of_a_batch_that_was_never_cut_is_unknown() -> None:
    other = Dispatch(EPOCH, 2)
    submit(other, 2)
    other.join(ANN, 1, 2, [], 0.0)
    (lease,) = other.leases(0.0)
    assert settle(with_work(n=0), lease, 0.1).kind is Settlement.UNKNOWN


def test_settled_batches_are_forgotten_in_the_end() -> None:
    dispatch = with_work(n=REMEMBERED + 10, batch_size=1)
    first, _ = dispatch.leases(0.0)
    settle(dispatch, first, 0.0)
    for _ in range(REMEMBERED):
        settle(dispatch, dispatch.leases(0.0)[0], 0.0)
    assert len(dispatch._tickets._settled) == REMEMBERED
    assert settle(dispatch, first, 1.0).kind is Settlement.UNKNOWN


def test_each_kind_of_result_is_counted() -> None:
    dispatch = with_work(n=2)
    (lease,) = dispatch.leases(0.0)
    settle(dispatch, lease, 0.1, epoch=1)
    for _ in range(3):
        settle(dispatch, lease, 0.1)
    counted = {name: count for name, count in dispatch.counters.items() if count}
    assert counted == {"foreign": 1, "fresh": 1, "duplicate": 2, "leased": 1}


@pytest.mark.parametrize(("n", "failed"), [(1, ()), (3, ()), (2, (2,))])
def test_a_result_that_does_not_fit_its_batch_is_refused_and_changes_nothing(
    n: int, failed: tuple[int, ...]
) -> None:
    dispatch = with_work(n=2)
    (lease,) = dispatch.leases(0.0)
    result = Result(
        epoch=EPOCH,
        run="run",
        generation=0,
        batch=lease.batch.id,
        attempt=1,
        wid=ANN,
        n=n,
        joints=1,
        descriptors=3,
        columns={},
        cpu_seconds=0.0,
        failures=[Failure(row=row, reason="") for row in failed],
    )
    with pytest.raises(MessageError):
        dispatch.settle(ANN, result, SHAPE.empty(n), 0.1)
    assert dispatch.leases(0.1) == []
    assert settle(dispatch, lease, 0.2).kind is Settlement.FRESH


# 6. Poison.


def test_failed_rows_are_leased_again_each_on_its_own() -> None:
    dispatch = with_work(n=6, batch_size=6)
    (lease,) = dispatch.leases(0.0)
    settled = settle(dispatch, lease, 0.1, failed=(4, 1))
    assert settled.rows is not None
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
        assert settled.rows is not None
        assert len(settled.rows) == 0
    (lease,) = dispatch.leases(0.4)
    settled = settle(dispatch, lease, 0.5, failed=(0,))
    assert settled.failures == (Failure(row=0, reason="row 0 burst"),)
    assert settled.rows is not None
    (row,) = settled.rows
    assert (row["outcome"], row["index"], row["nu"]) == (Outcome.ERROR, 1, 0)
    assert row["genome"].tobytes() == genomes(3)[1].tobytes()
    assert (dispatch.leases(0.6), dispatch.counters["errors"], dispatch.counters["failures"]) == ([], 1, 3)


def test_a_row_that_succeeds_in_the_end_is_no_error() -> None:
    dispatch = with_work(n=1)
    for now in range(STRIKES - 1):
        settle(dispatch, dispatch.leases(now)[0], now, failed=(0,))
    settled = settle(dispatch, dispatch.leases(9.0)[0], 9.0)
    assert settled.rows is not None
    assert (settled.rows["outcome"].tolist(), settled.failures) == ([Outcome.HELD], ())


def test_lost_workers_are_no_evidence_against_a_row() -> None:
    dispatch = with_work(n=1)
    for turn in range(3 * STRIKES):
        now = 10.0 * turn
        dispatch.leases(now)
        dispatch.gone(ANN, now)
        dispatch.tick(now + GRACE)
        dispatch.join(ANN, turn + 2, 2, [], now + 2)
    (lease,) = dispatch.leases(1000.0)
    assert (lease.attempt, lease.batch.failed) == (3 * STRIKES + 1, 0)


def test_two_results_of_a_failed_row_count_once() -> None:
    dispatch = with_work(n=1)
    (lease,) = dispatch.leases(0.0)
    settle(dispatch, lease, 0.1, failed=(0,))
    assert settle(dispatch, lease, 0.2, failed=(0,)).kind is Settlement.DUPLICATE
    (again,) = dispatch.leases(0.3)
    assert again.batch.failed == 1
