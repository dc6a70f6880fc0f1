"""Leases, joins and results at the dispatcher (rules 1 and 3 to 6 of docs/bus.md).

tests/simulation mixes all of them, and checks that nothing is lost, settled twice or left waiting.
"""

import pytest
from msgspec import structs
from tests.coordinator.scheduler.leases import (
    EPOCH,
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
from tests.fakes.messages import ANN, BOB, EVE, FAY, join_message

from qdgrasp_coordinator.scheduler.batch_dispatcher import PAUSE_SECONDS, STRIKES, Lease
from qdgrasp_coordinator.scheduler.batch_queue import Probe
from qdgrasp_coordinator.scheduler.worker_registry import (
    ANSWER_SECONDS,
    AWAY_SECONDS,
    FIRST_ANSWER_SECONDS,
    FIRST_STRAGGLER_SECONDS,
    LEASE_SECONDS,
    LOOK_SECONDS,
    SCENES_KEPT,
    TOKEN_GRACE,
)
from qdgrasp_protocol.build_messages import Built, MeshFile, ShapeTask
from qdgrasp_protocol.errors import MessageError
from qdgrasp_protocol.messages import Failure
from qdgrasp_protocol.rows import Outcome


def lose(dispatch: Dispatch, now: float, wid: str = ANN) -> None:
    """Have a worker vanish, and give it up."""
    dispatch.workers.on_token(wid, False, now)
    dispatch.give_up(now + TOKEN_GRACE)


def with_one_lease() -> tuple[Dispatch, Lease]:
    """All the work there is, leased to Ann."""
    dispatch = with_work(n=2)
    (lease,) = dispatch.leases(0.0)
    return dispatch, lease


class TestCredit:
    def test_rows_of_a_device_go_to_workers_that_have_one_as_many_as_it_takes_at_once(self) -> None:
        dispatch = Dispatch(EPOCH)
        submit(dispatch, 40, run="plain")
        submit(dispatch, 250, run="on-device", engine="mujoco-warp")
        dispatch.admit(ANN, 1, 2, [], 0.0)
        dispatch.admit(BOB, 1, 2, [], 0.0, rows=100)
        first = dispatch.leases(0.0)
        assert {(lease.wid, lease.task.run.run) for lease in first} == {(ANN, "plain"), (BOB, "on-device")}
        assert [len(lease.task) for lease in first if lease.wid == BOB] == [100, 100]
        for lease in first:
            settle(dispatch, lease, 0.1)
        assert next(len(lease.task) for lease in dispatch.leases(0.1) if lease.wid == BOB) == 50

    def test_ids_of_batches_are_never_used_again_also_where_an_epoch_recurs(self) -> None:
        ids = [lease.task.id for _ in range(3) for lease in with_work(n=50, batch_size=1).leases(0.0)]
        assert (len(set(ids)), {len(one) for one in ids}) == (len(ids), {16})

    def test_the_workers_that_are_wanted_are_those_that_queued_and_leased_batches_keep_busy(self) -> None:
        dispatch = with_work(n=9)
        dispatch.leases(0.1)
        assert dispatch.wanted_workers(is_leasing=True) == 5
        assert dispatch.wanted_workers(is_leasing=False) == 2
        dispatch.withdraw("run")
        assert dispatch.wanted_workers(is_leasing=True) == 0


class TestTurnsOfRuns:
    def test_runs_are_served_in_turn_by_what_they_cost(self) -> None:
        dispatch = Dispatch(EPOCH, 1)
        for run in ("one", "two"):
            submit(dispatch, 1000, run, scene=run)
        dispatch.admit(ANN, 1, 1, [], 0.0)
        served = {"one": 0, "two": 0}
        for now in range(400):
            (lease,) = dispatch.leases(now)
            settle(dispatch, lease, now)
            served[lease.task.run.run] += 1
        assert abs(served["one"] - served["two"]) <= 2 * 5.0 / 0.1 + 2

    def test_a_worker_opens_few_scenes_where_there_are_more_than_it_can_keep(self) -> None:
        dispatch = Dispatch(EPOCH, 1)
        for number in range(20):
            submit(dispatch, 1000, f"run{number}", scene=f"{number}")
        dispatch.admit(ANN, 1, 1, [], 0.0)
        opened, kept = 0, []
        for now in range(1000):
            (lease,) = dispatch.leases(now)
            settle(dispatch, lease, now)
            scene = lease.task.run.scene
            opened += scene not in kept
            kept = [scene, *(one for one in kept if one != scene)][:SCENES_KEPT]
        assert 10 < opened < 60


class TestSettlement:
    def test_a_fresh_result_gives_complete_rows(self) -> None:
        dispatch = with_work(n=10, batch_size=5)
        _, lease = dispatch.leases(0.0)
        settled = settle(dispatch, lease, 0.5)
        assert settled.rows["index"].tolist() == settled.rows["nu"].tolist() == [5, 6, 7, 8, 9]
        assert settled.rows["genome"].tobytes() == genomes(10)[5:].tobytes()
        assert (settled.cpu_seconds, settled.failures) == (0.5, ())

    def test_the_first_of_two_workers_wins_and_the_other_gets_nothing_until_it_answers_too(self) -> None:
        dispatch, anns = with_one_lease()
        dispatch.admit(BOB, 1, 1, [], 1.0)
        dispatch.give_up(LEASE_SECONDS)
        (bobs,) = dispatch.leases(LEASE_SECONDS)
        assert (bobs.wid, bobs.task) == (BOB, anns.task)
        assert settle(dispatch, anns, 11.0) is not None
        submit(dispatch, 4, generation=1)
        assert {lease.wid for lease in dispatch.leases(11.0)} == {ANN}
        assert settle(dispatch, bobs, 12.0) is None
        submit(dispatch, 4, generation=2)
        assert {lease.wid for lease in dispatch.leases(12.0)} == {BOB}

    def test_each_kind_of_result_is_told_apart_and_counted(self) -> None:
        dispatch, lease = with_one_lease()
        dispatch.admit(EVE, 1, 0, [], 0.0)
        dropped = [
            settle(dispatch, lease, 0.1, epoch=EPOCH - 1),
            settle(dispatch, lease, 0.1, wid=EVE),
            settle(with_work(n=0), lease, 0.1),
        ]
        assert dropped == [None] * 3
        assert settle(dispatch, lease, 0.1) is not None
        assert settle(dispatch, lease, 0.1) is None
        assert (dispatch.counters["foreign"], dispatch.strays) == (2, 3)

    @pytest.mark.parametrize(
        "wrong", [{"n": 1}, {"n": 3}, {"failures": failures((2,))}, {"run": "other"}], ids=str
    )
    def test_a_result_that_does_not_fit_its_batch_is_refused_and_changes_nothing(self, wrong) -> None:
        dispatch, lease = with_one_lease()
        answer = structs.replace(result(lease), **wrong)
        with pytest.raises(MessageError):
            dispatch.settle(ANN, answer, SHAPE.empty(answer.n), 0.1)
        assert settle(dispatch, lease, 0.2) is not None


class TestFailedRows:
    def test_failed_rows_are_leased_again_each_on_its_own(self) -> None:
        dispatch = with_work(n=6, batch_size=6)
        (lease,) = dispatch.leases(0.0)
        settled = settle(dispatch, lease, 0.1, failed=(4, 1))
        assert (settled.rows["index"].tolist(), settled.failures) == ([0, 2, 3, 5], ())
        assert indices(dispatch.leases(0.2)) == [[1], [4]]

    def test_a_row_that_failed_waits_for_another_worker_that_is_there_or_was_lately(self) -> None:
        dispatch = with_work(n=2, batch_size=1, workers=(ANN, BOB))
        anns, _ = sorted(dispatch.leases(0.0), key=lambda lease: lease.wid)
        lose(dispatch, 0.0, BOB)
        settle(dispatch, anns, 1.0, failed=(0,))
        assert indices(dispatch.leases(1.0)) == [[1]], "what Bob has lost, and not what Ann has tried"
        dispatch.admit(FAY, 1, 1, [], 2.0)
        (again,) = dispatch.leases(2.0)
        assert (again.wid, again.task.tried_by) == (FAY, (ANN,))

    def test_it_is_tried_again_where_no_other_worker_is_expected(self) -> None:
        dispatch = with_work(n=1, workers=(ANN, BOB))
        (lease,) = dispatch.leases(0.0)
        other = BOB if lease.wid == ANN else ANN
        lose(dispatch, 0.0, other)
        settle(dispatch, lease, 1.0, failed=(0,))
        assert dispatch.leases(2.0) == []
        assert [again.wid for again in dispatch.leases(2.0 + AWAY_SECONDS)] == [lease.wid]

    def test_a_row_that_failed_three_times_is_an_error_with_its_reason(self) -> None:
        dispatch = with_work(n=3, batch_size=3)
        (lease,) = dispatch.leases(0.0)
        settle(dispatch, lease, 0.1, failed=(1,))
        for _ in range(STRIKES - 1):
            (lease,) = dispatch.leases(0.2)
            settled = settle(dispatch, lease, 0.3, failed=(0,))
        assert settled.failures == ()
        (probe,) = dispatch.leases(0.4)
        assert indices([probe]) == [[0]], "another row, which is evaluated again"
        assert settle(dispatch, probe, 0.5) is None
        (lease,) = dispatch.leases(0.6)
        settled = settle(dispatch, lease, 0.7, failed=(0,))
        assert settled.failures == (Failure(row=0, reason="row 0 burst"),)
        (row,) = settled.rows
        assert (row["outcome"], row["index"], row["nu"]) == (Outcome.ERROR, 1, 0)
        assert row["genome"].tobytes() == genomes(3)[1].tobytes()
        assert dispatch.leases(9.1) == []
        assert (dispatch.counters["errors"], dispatch.counters["failures"]) == (1, 4)

    def test_rows_that_all_fail_are_no_errors_but_tried_now_and_then_until_one_is_evaluated(self) -> None:
        dispatch, now = with_work(n=20, batch_size=2), 0.0
        while not dispatch.trouble:
            for lease in dispatch.leases(now):
                assert not settle(dispatch, lease, now, failed=(0, 1)[: len(lease.task)]).failures
            now += 0.1
        assert "burst" in dispatch.trouble
        assert dispatch.leases(now + PAUSE_SECONDS / 2) == []
        lease, *_ = dispatch.leases(now + PAUSE_SECONDS)
        settle(dispatch, lease, now + PAUSE_SECONDS)
        assert (dispatch.trouble, dispatch.counters["errors"]) == ("", 0)

    def test_a_row_that_was_evaluated_before_tells_that_all_fail_now(self) -> None:
        dispatch, now = with_work(n=40, batch_size=2), 0.0
        settle(dispatch, dispatch.leases(now)[0], now)
        while not dispatch.trouble:
            now += 0.1
            for lease in dispatch.leases(now):
                settled = settle(dispatch, lease, now, failed=(0, 1)[: len(lease.task)])
                assert settled is None or not settled.failures
        for lease in dispatch.leases(now + PAUSE_SECONDS):
            settle(dispatch, lease, now + PAUSE_SECONDS, failed=() if isinstance(lease.task, Probe) else (0,))
        assert dispatch.trouble == ""

    def test_the_only_row_is_an_error_where_it_fails_too_often(self) -> None:
        dispatch, settled = with_work(n=1), None
        for _ in range(STRIKES):
            (lease,) = dispatch.leases(0.0)
            settled = settle(dispatch, lease, 0.0, failed=(0,))
        assert settled.failures


class TestJoins:
    def test_a_worker_is_told_to_drop_what_others_have_or_nobody_wants(self) -> None:
        dispatch = with_work(n=8)
        settled, moved = dispatch.leases(0.0)
        settle(dispatch, settled, 0.1)
        lose(dispatch, 0.1)
        dispatch.admit(BOB, 1, 1, [], 1.2)
        (lease,) = dispatch.leases(1.2)
        assert lease.task.id == moved.task.id
        held = [settled.task.id, moved.task.id, b"\0" * 16]
        assert dispatch.admit(ANN, 2, 2, held, 1.3) == held

    def test_a_worker_may_continue_what_was_queued_again_meanwhile_and_nobody_else_may(self) -> None:
        dispatch = with_work(n=4)
        ids = [lease.task.id for lease in dispatch.leases(0.0)]
        lose(dispatch, 0.1)
        assert dispatch.admit(EVE, 1, 0, ids, 1.4) == ids
        assert dispatch.admit(ANN, 2, 2, ids, 1.5) == []
        assert (dispatch.queued_seconds, dispatch.leases(1.6)) == (0, [])


class TestEndsOfLeases:
    def test_a_vanished_worker_is_given_up_after_a_second_unless_it_comes_back(self) -> None:
        dispatch = with_work(n=4, workers=(ANN, BOB))
        anns = [lease.task.id for lease in dispatch.leases(0.0) if lease.wid == ANN]
        for wid in (ANN, BOB):
            dispatch.workers.on_token(wid, False, 3.0)
        dispatch.workers.on_token(BOB, True, 3.5)
        assert dispatch.give_up(3.0 + TOKEN_GRACE - LOOK_SECONDS) == []
        (lost,) = dispatch.give_up(3.0 + TOKEN_GRACE)
        assert (lost.worker.wid, lost.batches, lost.reason) == (ANN, anns, "its token vanished")
        (again,) = dispatch.leases(4.0)
        assert (again.wid, again.attempt) == (BOB, 2)

    def test_signs_of_progress_put_the_end_of_a_lease_off(self) -> None:
        dispatch = with_work(n=4)
        dispatch.leases(0.0)
        dispatch.workers.progressed(ANN, 8.0)
        assert dispatch.give_up(LEASE_SECONDS) == []
        (lost,) = dispatch.give_up(8.0 + LEASE_SECONDS)
        assert lost.reason == "no sign of progress for 10 seconds"

    @pytest.mark.parametrize("is_measured", [False, True])
    def test_a_worker_that_shows_progress_and_never_answers_is_given_up_too(self, is_measured) -> None:
        dispatch = with_work(n=4)
        dispatch.leases(0.0)
        if is_measured:
            dispatch.workers.lease_timeout.measure(1.0)
        limit = ANSWER_SECONDS if is_measured else FIRST_ANSWER_SECONDS
        reasons, now = [], 0.0
        while now < limit:
            now += 5.0
            dispatch.workers.progressed(ANN, now)
            reasons += [lost.reason for lost in dispatch.give_up(now)]
        assert reasons == [f"no answer for {limit:.0f} seconds"]
        assert ANN[:8] in dispatch.workers.trouble

    def test_a_stuck_worker_gets_nothing_until_it_answers_while_another_is_well(self) -> None:
        dispatch = with_work(n=20, workers=(ANN, BOB))
        anns = [lease for lease in dispatch.leases(0.0) if lease.wid == ANN]
        dispatch.workers.progressed(BOB, 9.0)
        assert [lost.worker.wid for lost in dispatch.give_up(LEASE_SECONDS)] == [ANN]
        assert dispatch.leases(10.0) == []  # Bob's credit is used up
        settle(dispatch, anns[0], 11.0)
        assert {lease.wid for lease in dispatch.leases(11.0)} == {ANN}

    def test_where_all_workers_are_stuck_all_of_them_are_tried_in_turn(self) -> None:
        dispatch = with_work(n=1, workers=(ANN, BOB, EVE))
        tried = []
        for turn in range(6):
            tried += [lease.wid for lease in dispatch.leases(turn * LEASE_SECONDS)]
            dispatch.give_up((turn + 1) * LEASE_SECONDS)
        assert set(tried[:3]) == set(tried[3:]) == {ANN, BOB, EVE}


class TestStragglers:
    def test_what_a_straggler_holds_is_leased_to_one_idle_worker_too(self) -> None:
        dispatch = with_work(n=2, batch_size=2, workers=(ANN, BOB, EVE))
        (first,) = dispatch.leases(0.0)
        assert dispatch.leases(FIRST_STRAGGLER_SECONDS - 0.1) == []
        (second,) = dispatch.leases(FIRST_STRAGGLER_SECONDS)
        assert (second.task, second.wid != first.wid) == (first.task, True)
        assert dispatch.leases(2 * FIRST_STRAGGLER_SECONDS) == []
        assert settle(dispatch, second, 5.0) is not None


CODE, OTHER_CODE = "c" * 64, "d" * 64


def shape_task(name: str = "mug") -> ShapeTask:
    mesh = MeshFile(name=f"{name}.stl", sha256="0" * 64, size=1)
    return ShapeTask(files=(mesh,), code=CODE)


def with_builds(*tasks: ShapeTask, **codes: str) -> Dispatch:
    """A dispatcher with these builds, and workers with the code of each."""
    dispatch = Dispatch(EPOCH, 1)
    dispatch.build(tasks)
    for wid, code in codes.items():
        dispatch.workers.on_token(wid, True, 0.0)
        dispatch.join(join_message(wid, builds=code), 0.0)
    return dispatch


def built(lease: Lease, **values: object) -> Built:
    common = {"epoch": EPOCH, "batch": lease.task.id, "attempt": lease.attempt, "wid": lease.wid}
    return Built(**common | (values or {"pieces": (b"a shape",)}))  # type: ignore[arg-type]


class TestBuilds:
    def test_a_worker_that_builds_is_leased_nothing_else_until_it_has_answered(self) -> None:
        dispatch = with_builds(shape_task(), shape_task("bowl"), **{ANN: CODE})
        submit(dispatch, 4)
        (lease,) = dispatch.leases(0.0)
        assert (lease.wid, lease.task.task) == (ANN, shape_task())
        assert dispatch.leases(0.0) == []
        reply = dispatch.settle_build(ANN, built(lease), 1.0)
        assert (reply.key, reply.pieces) == (shape_task().key, (b"a shape",))
        assert len(dispatch.leases(1.0)) == 1

    def test_builds_go_to_workers_with_their_code_and_are_given_up_where_there_is_none(self) -> None:
        dispatch = with_builds(shape_task(), shape_task("bowl"))
        assert dispatch.give_up_build() is None, "one may come"
        dispatch = with_builds(shape_task(), **{ANN: OTHER_CODE, BOB: CODE})
        assert dispatch.give_up_build() is None
        assert [lease.wid for lease in dispatch.leases(0.0)] == [BOB]
        dispatch = with_builds(shape_task(), shape_task("bowl"), **{ANN: OTHER_CODE, BOB: ""})
        assert dispatch.leases(0.0) == []
        taken = [dispatch.give_up_build() for _ in range(3)]
        assert taken == [shape_task(), shape_task("bowl"), None]

    def test_a_build_of_a_lost_worker_is_leased_to_another_one_and_the_first_shape_counts(self) -> None:
        dispatch = with_builds(shape_task(), **{ANN: CODE})
        (first,) = dispatch.leases(0.0)
        dispatch.give_up(100.0)
        dispatch.workers.on_token(BOB, True, 100.0)
        dispatch.join(join_message(BOB, builds=CODE), 100.0)
        (second,) = dispatch.leases(100.0)
        assert (second.wid, second.attempt, second.task) == (BOB, 2, first.task)
        assert dispatch.settle_build(ANN, built(first, reason="it burst"), 101.0) is None, "Bob is at it"
        assert dispatch.settle_build(ANN, built(first), 101.0).pieces
        assert dispatch.settle_build(BOB, built(second), 102.0) is None

    def test_a_build_that_fails_three_times_ends_with_its_reason(self) -> None:
        dispatch = with_builds(shape_task(), **{ANN: CODE})
        replies = []
        for _ in range(STRIKES):
            (lease,) = dispatch.leases(0.0)
            replies.append(dispatch.settle_build(ANN, built(lease, reason="it burst"), 0.0))
        assert [reply and reply.reason for reply in replies] == [None, None, "it burst"]
        assert dispatch.leases(0.0) == []

    def test_a_build_that_is_leased_three_times_without_an_answer_is_given_up(self) -> None:
        dispatch = with_builds(shape_task(), **{ANN: CODE})
        for number in range(STRIKES):
            assert dispatch.give_up_build() is None
            assert len(dispatch.leases(0.0)) == 1
            dispatch.join(join_message(ANN, 2 + number, builds=CODE), 0.0)
        assert dispatch.leases(10.0) == []
        assert [dispatch.give_up_build(), dispatch.give_up_build()] == [shape_task(), None]

    def test_files_of_which_no_object_can_be_made_are_not_tried_again(self) -> None:
        dispatch = with_builds(shape_task(), **{ANN: CODE})
        (lease,) = dispatch.leases(0.0)
        assert dispatch.settle_build(ANN, built(lease, reason="it is open", is_final=True), 0.0).reason

    def test_a_shape_is_no_answer_to_a_batch_nor_rows_to_a_build(self) -> None:
        dispatch = with_builds(shape_task(), **{ANN: CODE, BOB: ""})
        submit(dispatch, 1)
        build, batch = dispatch.leases(0.0)
        with pytest.raises(MessageError, match="a shape is no answer to a batch"):
            dispatch.settle_build(BOB, built(batch), 0.0)
        rows = structs.replace(result(batch), batch=build.task.id, wid=ANN)
        with pytest.raises(MessageError, match="nor rows to a build"):
            dispatch.settle(ANN, rows, SHAPE.empty(1), 0.0)
