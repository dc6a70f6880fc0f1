"""What a worker holds of a job, and what it lets go."""

from collections.abc import Iterator
from math import inf

import pytest
from tests.worker.runtime.leased_batches import work

from qdgrasp_protocol.keys import Keys
from qdgrasp_protocol.memory_bus import MemoryNetwork
from qdgrasp_protocol.messages import Control, Join, Joined
from qdgrasp_worker.runtime.background_requests import JoinAnswered
from qdgrasp_worker.runtime.job_registry import (
    ABANDON_SECONDS,
    JobMembership,
    JobRegistry,
    JobSession,
    JoinState,
)


def answer(epoch: int = 1, drop: tuple[int, ...] = ()) -> Joined:
    return Joined(epoch=epoch, drop=[bytes([batch]) * 16 for batch in drop])


@pytest.fixture
def desk() -> JobSession:
    desk = JobSession("job")
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
    desk = JobSession("job")
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


WID = "a" * 32


class Questions:
    """Errands that are noted only."""

    def __init__(self) -> None:
        self.joins: list[tuple[str, Join]] = []

    def join(self, job: str, join: Join) -> None:
        self.joins.append((job, join))


class Life:
    """A worker's memberships, and who sees its tokens."""

    def __init__(self) -> None:
        network = MemoryNetwork()
        self.questions = Questions()
        self.jobs = JobRegistry()
        self.tokens: set[str] = set()
        self.bus = network.session()
        network.session().watch("qdgrasp/v1/*/live/worker/*", self._see)
        self.memberships = JobMembership(self.bus, self.questions, self.jobs, WID, None)

    def meet(self, job: str, epoch: int, now: float, *, is_alive: bool = True) -> None:
        self.memberships.meet(Keys(job).coordinator_token(epoch), is_alive, now)

    def join(self, job: str, epoch: int, now: float) -> JoinState:
        """Join all jobs that are to be joined, and have one answer."""
        self.memberships.join_due(now, {}, is_open=True)
        appointment = self.jobs.get(job)
        self.memberships.answered(
            JoinAnswered(job, appointment.desk.number, Joined(epoch=epoch, drop=[])), now
        )
        return appointment

    def _see(self, key: str, is_alive: bool) -> None:
        (self.tokens.add if is_alive else self.tokens.discard)(key)


@pytest.fixture
def life() -> Iterator[Life]:
    life = Life()
    with life.bus:
        yield life


def test_a_thousand_jobs_that_ended_leave_nothing_behind(life):
    for i in range(1000):
        life.meet(f"job-{i}", 1, float(i))
        life.meet(f"job-{i}", 1, i + 0.5, is_alive=False)
        life.memberships.end_over(float(i))
    assert len(life.tokens) <= ABANDON_SECONDS + 1
    life.memberships.end_over(1000 + ABANDON_SECONDS)
    assert (list(life.jobs), life.tokens, life.jobs.next_end()) == ([], set(), inf)


def test_a_job_whose_coordinator_is_there_or_of_which_something_is_held_goes_on(life):
    life.meet("job", 1, 0.0)
    desk = life.join("job", 1, 0.0).desk
    desk.accept(work(1))
    assert life.jobs.next_end() == inf
    life.meet("job", 1, 5.0, is_alive=False)
    life.memberships.end_over(1e6)
    assert life.jobs.next_end() == inf
    desk.release(work(1).batch)
    assert life.jobs.next_end() == 5.0 + ABANDON_SECONDS


def test_the_numbers_of_joins_go_on_where_a_job_comes_back_after_its_end(life):
    life.meet("job", 1, 0.0)
    for now in (0.0, 1.0, 2.0):
        life.join("job", 1, now)
        life.memberships.reconnected(now)
    life.meet("job", 1, 3.0, is_alive=False)
    life.memberships.end_over(3.0 + ABANDON_SECONDS)
    life.meet("job", 1, 100.0)
    life.join("job", 1, 100.0)
    numbers = [join.number for _, join in life.questions.joins]
    assert numbers == sorted(set(numbers))


@pytest.fixture
def drained(life):
    life.meet("job", 7, 0.0)
    life.join("job", 7, 0.0).desk.control(Control(epoch=7, drop=[], drain=True))
    life.memberships.leave_drained()
    assert list(life.jobs) == []
    return life


def test_a_job_that_was_left_is_joined_again_for_a_later_coordinator_and_for_no_earlier_one(drained):
    drained.meet("job", 6, 1.0)
    assert list(drained.jobs) == []
    drained.meet("job", 8, 2.0)
    assert [appointment.desk.job for appointment in drained.jobs] == ["job"]


@pytest.mark.parametrize("epoch", [1, 7])
def test_a_job_of_the_same_name_that_begins_anew_is_joined_though_it_counts_from_the_beginning(
    drained, epoch
):
    drained.meet("job", 7, 1.0, is_alive=False)
    drained.meet("job", epoch, 2.0)
    assert drained.join("job", epoch, 2.0).desk.epoch == epoch


def test_a_coordinator_that_went_before_it_was_left_keeps_nobody_from_the_next_one(life):
    life.meet("job", 7, 0.0)
    desk = life.join("job", 7, 0.0).desk
    desk.accept(work(1, epoch=7))
    desk.control(Control(epoch=7, drop=[], drain=True))
    life.meet("job", 7, 1.0, is_alive=False)
    desk.release(work(1).batch)
    life.memberships.leave_drained()
    assert list(life.jobs) == []
    life.meet("job", 1, 2.0)
    assert life.join("job", 1, 2.0).desk.epoch == 1


def test_a_job_is_not_left_where_a_later_coordinator_is_there_already(life):
    life.meet("job", 7, 0.0)
    life.join("job", 7, 0.0).desk.control(Control(epoch=7, drop=[], drain=True))
    life.meet("job", 8, 1.0)
    life.memberships.leave_drained()
    assert life.join("job", 8, 1.0).has_share
