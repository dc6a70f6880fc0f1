"""The sessions of a worker's jobs: batches that are held and let go, joins, ends."""

from collections.abc import Iterator
from math import inf
from unittest.mock import Mock

import pytest
from tests.worker.runtime.scripted_simulator import work

from qdgrasp_protocol.keys import Keys
from qdgrasp_protocol.memory_bus import MemoryNetwork
from qdgrasp_protocol.messages import Control, Joined
from qdgrasp_worker.runtime.background_requests import JoinAnswered
from qdgrasp_worker.runtime.job_registry import ABANDON_SECONDS, JobRegistry, JobSession

KEY = bytes(32)


def answer(epoch: int = 1, drop: tuple[int, ...] = ()) -> Joined:
    return Joined(epoch=epoch, drop=[bytes([batch]) * 16 for batch in drop])


def join(session: JobSession, answer: Joined) -> bool:
    """Ask to join, and have a coordinator answer that is there."""
    session.on_coordinator(answer.epoch, True, 0.0)
    session.ask(2)
    return session.on_answer(answer, 0.0, 1.0)


@pytest.fixture
def session() -> JobSession:
    session = JobSession("job")
    assert join(session, answer())
    assert session.number == 1
    return session


def test_work_that_arrives_before_the_answer_to_its_join_is_kept_out_of_older_epochs():
    session = JobSession("job")
    session.ask(2)
    assert not session.accept(work(1))


def test_what_is_held_at_a_join_is_kept_unless_the_coordinator_takes_it_back(session):
    session.accept(work(1))
    session.accept(work(2))
    session.ask(2)
    assert session.held == [work(1).batch, work(2).batch]
    session.on_answer(answer(drop=(1,)), 0.0, 1.0)
    assert session.held == [work(2).batch]


def test_a_new_epoch_ends_everything_older(session):
    session.accept(work(1))
    assert join(session, answer(epoch=2))
    assert session.held == []
    assert not session.accept(work(3, epoch=1, join=2))


def test_a_job_that_begins_anew_after_its_coordinator_left_is_served(session):
    join(session, answer(epoch=5))
    session.on_coordinator(5, False, 1.0)
    assert session.follows(1)
    assert join(session, answer(epoch=1))
    assert session.epoch == 1


def test_a_batch_can_be_taken_back_at_any_time_but_only_by_its_own_epoch(session):
    session.accept(work(1))
    session.on_control(Control(epoch=0, drop=[work(1).batch]))
    assert session.held
    session.on_control(Control(epoch=1, drop=[work(1).batch]))
    assert session.held == []


class Membership:
    """A worker's jobs, and the tokens that others see of it."""

    def __init__(self) -> None:
        network = MemoryNetwork()
        self.requests = Mock()
        self.tokens: set[str] = set()
        self.bus = network.session()
        network.session().watch("qdgrasp/v1/*/live/worker/*", self._see)
        self.jobs = JobRegistry(self.bus, self.requests, "a" * 32, None, key=KEY)

    def meet(self, job: str, epoch: int, now: float, *, is_alive: bool = True) -> None:
        self.jobs.on_coordinator(Keys(job).coordinator_token(epoch), is_alive, now)

    def join(self, job: str, epoch: int, now: float) -> JobSession:
        """Join all jobs that are to be joined, and have one answer."""
        self.jobs.join_due(now, {}, is_open=True)
        session = self.jobs.get(job)
        self.jobs.on_join_answered(JoinAnswered(job, session.number, Joined(epoch=epoch, drop=[])), now)
        return session

    def _see(self, key: str, is_alive: bool) -> None:
        (self.tokens.add if is_alive else self.tokens.discard)(key)


@pytest.fixture
def member() -> Iterator[Membership]:
    member = Membership()
    with member.bus:
        yield member


def test_a_job_whose_coordinator_is_there_or_of_which_something_is_held_goes_on(member):
    member.meet("job", 1, 0.0)
    session = member.join("job", 1, 0.0)
    session.accept(work(1))
    assert member.jobs.next_end == inf
    member.meet("job", 1, 5.0, is_alive=False)
    member.jobs.end_abandoned(1e6)
    assert member.jobs.next_end == inf
    session.release(work(1).batch)
    assert member.jobs.next_end == 5.0 + ABANDON_SECONDS


def test_the_numbers_of_joins_go_on_where_a_job_comes_back_after_its_end(member):
    member.meet("job", 1, 0.0)
    for now in (0.0, 1.0, 2.0):
        member.join("job", 1, now)
        member.jobs.on_link_up(now)
    member.meet("job", 1, 3.0, is_alive=False)
    member.jobs.end_abandoned(3.0 + ABANDON_SECONDS)
    member.meet("job", 1, 100.0)
    member.join("job", 1, 100.0)
    numbers = [asked.args[1].number for asked in member.requests.join.call_args_list]
    assert numbers == sorted(set(numbers))


@pytest.fixture
def drained(member):
    member.meet("job", 7, 0.0)
    member.join("job", 7, 0.0).on_control(Control(epoch=7, drop=[], drain=True))
    member.jobs.leave_drained()
    assert list(member.jobs) == []
    return member


def test_a_job_that_was_left_is_joined_again_for_a_later_coordinator_and_for_no_earlier_one(drained):
    drained.meet("job", 6, 1.0)
    assert list(drained.jobs) == []
    drained.meet("job", 8, 2.0)
    assert [session.job for session in drained.jobs] == ["job"]
