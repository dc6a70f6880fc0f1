"""Builds of shapes are leased, settled once, tried again, and given back."""

import pytest
from msgspec import structs
from tests.coordinator.scheduler.leases import EPOCH, SHAPE, Dispatch, result, submit
from tests.fakes.messages import ANN, BOB, join_message, made_id

from qdgrasp_coordinator.scheduler.batch_dispatcher import BUILDER_SECONDS, MOST_BUILD_LEASES, STRIKES
from qdgrasp_coordinator.scheduler.shape_queue import BuildLease
from qdgrasp_protocol.build_messages import Built, MeshFile, ShapeTask
from qdgrasp_protocol.errors import MessageError

CODE, OTHER_CODE = "c" * 64, "d" * 64


def task(name: str = "mug", code: str = CODE) -> ShapeTask:
    mesh = MeshFile(name=f"{name}.stl", sha256="0" * 64, size=1)
    return ShapeTask(files=(mesh,), seconds=1.0, memory=1 << 30, code=code)


def dispatch_of(*tasks: ShapeTask, **codes: str) -> Dispatch:
    """A dispatcher with these builds, and workers with the code of each."""
    dispatch = Dispatch(EPOCH, 1)
    dispatch.build(tasks)
    for wid, code in codes.items():
        dispatch.workers.on_token(wid, True, 0.0)
        dispatch.join(join_message(wid, builds=code), 0.0)
    return dispatch


def answer(lease: BuildLease, wid: str = "", **values: object) -> Built:
    common = {"epoch": EPOCH, "batch": lease.build.id, "attempt": lease.attempt, "wid": wid or lease.wid}
    return Built(**common | (values or {"pieces": (b"a shape",)}))  # type: ignore[arg-type]


def test_a_worker_that_builds_is_leased_nothing_else_until_it_has_answered() -> None:
    dispatch = dispatch_of(task(), task("bowl"), **{ANN: CODE})
    submit(dispatch, 4)
    (lease,) = dispatch.build_leases(0.0)
    assert (lease.wid, lease.build.task) == (ANN, task())
    assert not dispatch.build_leases(0.0)
    assert not dispatch.leases(0.0)
    reply = dispatch.settle_build(ANN, answer(lease), 1.0)
    assert reply is not None
    assert (reply.key, reply.pieces) == (task().key, (b"a shape",))
    assert len(dispatch.leases(1.0)) == 2


def test_a_worker_that_holds_a_batch_is_leased_a_build_behind_it() -> None:
    dispatch = dispatch_of(**{ANN: CODE})
    submit(dispatch, 1)
    assert len(dispatch.leases(0.0)) == 1
    dispatch.build([task()])
    assert len(dispatch.build_leases(0.0)) == 1


def test_builds_go_to_workers_with_their_code_alone() -> None:
    dispatch = dispatch_of(task(), **{ANN: OTHER_CODE, BOB: CODE})
    assert [lease.wid for lease in dispatch.build_leases(0.0)] == [BOB]
    assert not dispatch.unbuildable(0.0)


@pytest.mark.parametrize("code", ["", OTHER_CODE])
def test_builds_that_no_worker_has_the_code_for_are_taken_back_one_by_one_after_a_while(code: str) -> None:
    dispatch = dispatch_of(task(), task("bowl"))
    assert not dispatch.unbuildable(BUILDER_SECONDS)  # one may come
    dispatch.admit(ANN, 1, 2, [], 100.0)
    dispatch.join(join_message(ANN, 2, builds=code), 100.0)
    assert not dispatch.unbuildable(100.0)
    assert not dispatch.unbuildable(99.0 + BUILDER_SECONDS)
    taken = [dispatch.unbuildable(100.0 + BUILDER_SECONDS) for _ in range(3)]
    assert taken == [[task()], [task("bowl")], []]


def test_a_worker_with_the_code_that_comes_meanwhile_gets_the_builds() -> None:
    dispatch = dispatch_of(task(), **{ANN: ""})
    assert not dispatch.unbuildable(0.0)
    dispatch.workers.on_token(BOB, True, 1.0)
    dispatch.join(join_message(BOB, builds=CODE), 1.0)
    assert not dispatch.unbuildable(2 * BUILDER_SECONDS)
    assert [lease.wid for lease in dispatch.build_leases(2 * BUILDER_SECONDS)] == [BOB]


def test_a_build_that_waits_is_work_for_a_worker() -> None:
    dispatch = dispatch_of(task(), task("bowl"))
    assert dispatch.wanted_workers(is_leasing=True) == 2
    assert dispatch.wanted_workers(is_leasing=False) == 0


def test_a_build_of_a_lost_worker_is_leased_to_another_one_and_the_first_answer_counts() -> None:
    dispatch = dispatch_of(task(), **{ANN: CODE})
    (first,) = dispatch.build_leases(0.0)
    assert [one.worker.wid for one in dispatch.give_up(100.0)] == [ANN]
    dispatch.workers.on_token(BOB, True, 100.0)
    dispatch.join(join_message(BOB, builds=CODE), 100.0)
    (second,) = dispatch.build_leases(100.0)
    assert (second.wid, second.attempt, second.build.id) == (BOB, 2, first.build.id)
    reply = dispatch.settle_build(ANN, answer(first), 101.0)
    assert reply is not None
    assert reply.superseded == (BOB,)
    assert dispatch.settle_build(BOB, answer(second), 102.0) is None
    dispatch.build([task("bowl")])
    assert [lease.wid for lease in dispatch.build_leases(103.0)], "the credit of both is free again"


def test_a_build_is_kept_by_a_worker_that_lists_it_and_leased_again_if_it_does_not() -> None:
    dispatch = dispatch_of(task(), **{ANN: CODE})
    (lease,) = dispatch.build_leases(0.0)
    assert dispatch.join(join_message(ANN, 2, held=[lease.build.id], builds=CODE), 1.0) == []
    assert not dispatch.build_leases(1.0)
    dispatch.join(join_message(ANN, 3, builds=CODE), 2.0)
    (again,) = dispatch.build_leases(2.0)
    assert (again.build.id, again.attempt) == (lease.build.id, 2)


def test_a_build_that_fails_is_tried_on_other_workers_and_then_ends_with_its_reason() -> None:
    wids = [made_id(number) for number in range(STRIKES + 1)]
    dispatch = dispatch_of(task(), **dict.fromkeys(wids, CODE))
    replies, tried = [], set()
    for _ in range(STRIKES):
        (lease,) = dispatch.build_leases(0.0)
        tried.add(lease.wid)
        replies.append(dispatch.settle_build(lease.wid, answer(lease, reason="it burst"), 0.0))
    *before, last = replies
    assert before == [None] * (STRIKES - 1)
    assert len(tried) == STRIKES
    assert last is not None
    assert (last.key, last.reason, last.pieces) == (task().key, "it burst", ())
    assert not dispatch.build_leases(0.0)


def test_a_build_that_failed_on_every_worker_that_can_do_it_is_taken_back() -> None:
    dispatch = dispatch_of(task(), **{ANN: CODE, BOB: ""})
    (lease,) = dispatch.build_leases(0.0)
    assert dispatch.settle_build(ANN, answer(lease, reason="its disk is full"), 0.0) is None
    assert not dispatch.build_leases(0.0)
    assert dispatch.unbuildable(0.0) == [task()]


def test_a_build_that_is_leased_again_and_again_without_an_answer_is_taken_back() -> None:
    dispatch = dispatch_of(task(), **{ANN: CODE})
    for number in range(MOST_BUILD_LEASES):
        assert len(dispatch.build_leases(float(number))) == 1
        assert not dispatch.unbuildable(float(number))
        dispatch.join(join_message(ANN, 2 + number, builds=CODE), float(number))
    assert not dispatch.build_leases(10.0)
    assert dispatch.unbuildable(10.0) == [task()]
    assert not dispatch.unbuildable(10.0)


def test_a_failure_while_another_worker_is_at_it_changes_nothing() -> None:
    dispatch = dispatch_of(task(), **{ANN: CODE})
    (first,) = dispatch.build_leases(0.0)
    dispatch.give_up(100.0)
    dispatch.workers.on_token(BOB, True, 100.0)
    dispatch.join(join_message(BOB, builds=CODE), 100.0)
    (second,) = dispatch.build_leases(100.0)
    assert dispatch.settle_build(ANN, answer(first, reason="it burst"), 101.0) is None
    reply = dispatch.settle_build(BOB, answer(second), 102.0)
    assert reply is not None
    assert reply.pieces


def test_files_of_which_no_object_can_be_made_are_not_tried_again() -> None:
    dispatch = dispatch_of(task(), **{ANN: CODE})
    (lease,) = dispatch.build_leases(0.0)
    reply = dispatch.settle_build(ANN, answer(lease, reason="it is open", is_final=True), 0.0)
    assert reply is not None
    assert reply.reason == "it is open"


def test_builds_that_are_withdrawn_are_dropped_by_their_workers() -> None:
    dispatch = dispatch_of(task(), task("bowl"), **{ANN: CODE})
    (lease,) = dispatch.build_leases(0.0)
    assert dispatch.withdraw_builds() == {ANN: [lease.build.id]}
    assert not dispatch.build_leases(0.0)
    assert dispatch.settle_build(ANN, answer(lease), 1.0) is None


def test_a_shape_is_no_answer_to_a_batch_nor_rows_to_a_build() -> None:
    dispatch = dispatch_of(task(), **{ANN: CODE, BOB: ""})
    submit(dispatch, 1)
    (build,) = dispatch.build_leases(0.0)
    (batch,) = dispatch.leases(0.0)
    shape = Built(epoch=EPOCH, batch=batch.batch.id, attempt=1, wid=BOB, pieces=(b"a shape",))
    with pytest.raises(MessageError, match="a shape is no answer to a batch"):
        dispatch.settle_build(BOB, shape, 0.0)
    rows = structs.replace(result(batch), batch=build.build.id, wid=ANN)
    with pytest.raises(MessageError, match="nor rows to a build"):
        dispatch.settle(ANN, rows, SHAPE.empty(1), 0.0)
