"""What a worker holds of a job, and what it lets go."""

import pytest
from tests.worker.serving.batches import work

from qdgrasp_protocol.messages import Control, Joined
from qdgrasp_worker.serving.desk import Desk


def answer(epoch: int = 1, drop: tuple[int, ...] = ()) -> Joined:
    return Joined(epoch=epoch, drop=[bytes([batch]) * 16 for batch in drop])


@pytest.fixture
def desk() -> Desk:
    desk = Desk("job")
    assert desk.joining() == 1
    assert desk.joined(answer())
    return desk


def test_batches_are_served_in_the_order_they_came(desk):
    assert desk.accept(work(1))
    assert desk.accept(work(2))
    assert desk.next().batch == work(1).batch
    desk.release(work(1).batch)
    assert desk.next().batch == work(2).batch


def test_work_that_arrives_before_the_answer_to_its_join_is_kept_out_of_older_epochs():
    desk = Desk("job")
    desk.joining()
    assert not desk.accept(work(1))


def test_work_of_an_older_join_is_dropped(desk):
    desk.joining()
    desk.joined(answer())
    assert not desk.accept(work(1, join=1))
    assert desk.accept(work(1, join=2))
    assert desk.dropped == 1


def test_what_is_held_at_a_join_is_kept_unless_the_coordinator_takes_it_back(desk):
    desk.accept(work(1))
    desk.accept(work(2))
    desk.joining()
    assert desk.held == [work(1).batch, work(2).batch]
    desk.joined(answer(drop=(1,)))
    assert desk.held == [work(2).batch]


def test_a_new_epoch_ends_everything_older(desk):
    desk.accept(work(1))
    desk.joining()
    assert desk.joined(answer(epoch=2))
    assert desk.held == []
    assert not desk.accept(work(3, epoch=1, join=2))


def test_an_older_coordinator_is_not_served_again(desk):
    desk.joining()
    desk.joined(answer(epoch=5))
    desk.joining()
    assert not desk.joined(answer(epoch=4))
    assert desk.epoch == 5


def test_a_job_that_begins_anew_after_its_coordinator_left_is_served(desk):
    desk.joining()
    desk.joined(answer(epoch=5))
    desk.is_orphaned = True
    assert desk.follows(1)
    desk.joining()
    assert desk.joined(answer(epoch=1))
    assert desk.epoch == 1


def test_a_batch_can_be_taken_back_at_any_time_but_only_by_its_own_epoch(desk):
    desk.accept(work(1))
    desk.control(Control(epoch=0, drop=[work(1).batch]))
    assert desk.held
    desk.control(Control(epoch=1, drop=[work(1).batch]))
    assert desk.held == []
