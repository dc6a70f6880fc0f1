"""Who is leased which rows: credit and fairness (rule 1 of docs/bus.md).

Rules 3 to 6 are in `test_dispatch_fence` and `test_dispatch_settling`; tests/simulation mixes all of them.
"""

from math import inf

import numpy as np
from tests.coordinator.dispatching.leases import (
    ANN,
    BOB,
    EPOCH,
    SCENE,
    genomes,
    indices,
    settle,
    submit,
    with_work,
)

from qdgrasp_coordinator.dispatching.batch import Settlement
from qdgrasp_coordinator.dispatching.dispatch import Dispatch
from qdgrasp_coordinator.dispatching.member import GRACE, SCENES
from qdgrasp_protocol.codec import decode, encode
from qdgrasp_protocol.messages import Work

# 1. Credit.


def test_a_worker_is_leased_as_many_batches_as_it_has_credit() -> None:
    dispatch = with_work()
    first = dispatch.leases(0.0)
    assert indices(first) == [[0, 1], [2, 3]]
    assert dispatch.leases(0.1) == []
    settle(dispatch, first[1], 0.2)
    assert indices(dispatch.leases(0.2)) == [[4, 5]]


def test_without_workers_nothing_is_leased() -> None:
    assert with_work(workers=()).leases(0.0) == []


def test_workers_take_turns() -> None:
    dispatch = with_work(workers=(ANN, BOB))
    assert sorted(lease.wid for lease in dispatch.leases(0.0)) == [ANN, ANN, BOB, BOB]
    dispatch = with_work(n=4, workers=(ANN, BOB))
    assert sorted(lease.wid for lease in dispatch.leases(0.0)) == [ANN, BOB]


def test_a_batch_holds_rows_of_one_generation_only() -> None:
    dispatch = with_work(n=3)
    submit(dispatch, 3, generation=1)
    dispatch.join(BOB, 1, 4, [], 0.0)
    leases = dispatch.leases(0.0)
    assert sorted((lease.batch.generation, lease.batch.indices.tolist()) for lease in leases) == [
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
        dispatch.join(ANN, 1, 64, [], 0.0)
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
    dispatch.join(ANN, 1, 1, [], 0.0)
    served = {"one": 0, "two": 0}
    for now in range(400):
        (lease,) = dispatch.leases(now)
        settle(dispatch, lease, now)
        served[lease.batch.run] += 1
    assert abs(served["one"] - served["two"]) <= 2 * 5.0 / 0.1 + 2


def test_a_worker_opens_few_scenes_where_there_are_more_than_it_can_keep() -> None:
    dispatch = Dispatch(EPOCH, 1)
    for number in range(20):
        submit(dispatch, 1000, f"run{number}", scene=f"{number}")
    dispatch.join(ANN, 1, 1, [], 0.0)
    opened, kept = 0, []
    for now in range(1000):
        (lease,) = dispatch.leases(now)
        settle(dispatch, lease, now)
        opened += lease.batch.scene not in kept
        kept = [lease.batch.scene, *(scene for scene in kept if scene != lease.batch.scene)][:SCENES]
    assert 10 < opened < 60


def test_a_worker_that_rejoins_holds_its_scenes_still() -> None:
    dispatch = Dispatch(EPOCH, 1)
    for run in ("one", "two"):
        submit(dispatch, 10, run, scene=run)
    dispatch.join(ANN, 1, 1, [], 0.0)
    for _ in range(2):
        (lease,) = dispatch.leases(0.0)
        settle(dispatch, lease, 0.1)
    dispatch.join(ANN, 2, 1, [], 0.2)
    assert [again.batch.scene for again in dispatch.leases(0.3)] == [lease.batch.scene]


def test_a_run_that_comes_late_is_not_given_what_it_missed() -> None:
    dispatch = Dispatch(EPOCH, 1)
    submit(dispatch, 1000, "one")
    dispatch.join(ANN, 1, 1, [], 0.0)
    for now in range(200):
        settle(dispatch, dispatch.leases(now)[0], now)
    submit(dispatch, 1000, "two")
    runs = []
    for now in range(200, 400):
        (lease,) = dispatch.leases(now)
        settle(dispatch, lease, now)
        runs.append(lease.batch.run)
    assert 60 < runs.count("two") < 140


def test_only_the_scenes_that_a_worker_keeps_open_are_remembered() -> None:
    dispatch = Dispatch(EPOCH, 1)
    dispatch.join(ANN, 1, 1, [], 0.0)
    for number in range(SCENES + 3):
        submit(dispatch, 1, f"run{number}", scene=f"{number}")
        settle(dispatch, dispatch.leases(0.0)[0], 0.0)
    worker = dispatch._roster.get(ANN)
    assert worker is not None
    assert list(worker.scenes) == [f"{number}" for number in range(3, SCENES + 3)]


# The end of a run.


def test_a_withdrawn_run_is_leased_no_more_and_its_batches_may_be_dropped() -> None:
    dispatch = with_work(n=10)
    submit(dispatch, 4, "other", scene="2" * 64)
    leases = dispatch.leases(0.0)
    mine = [lease for lease in leases if lease.batch.run == "run"]
    assert dispatch.withdraw("run") == {ANN: [lease.batch.id for lease in mine]}
    assert {lease.batch.run for lease in dispatch.leases(0.1)} == {"other"}
    assert settle(dispatch, mine[0], 0.2).kind is Settlement.LATE
    assert dispatch.withdraw("run") == {}


def test_a_withdrawn_run_may_hold_batches_that_wait_to_be_leased_again() -> None:
    dispatch = with_work(n=4)
    dispatch.leases(0.0)
    dispatch.gone(ANN, 0.0)
    dispatch.tick(GRACE)
    assert dispatch.withdraw("run") == {}
    dispatch.join(BOB, 1, 2, [], 1.5)
    assert (dispatch.leases(2.0), dispatch.queued_seconds, dispatch.next_deadline()) == ([], 0, inf)
