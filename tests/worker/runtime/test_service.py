"""A worker on the bus with its simulator's process: joining, serving, handing back, leaving."""

import os
import signal
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path

import pytest
from structlog.testing import capture_logs
from tests.fakes.coordinator import LeasingCoordinator
from tests.fakes.memory_bus import MemoryNetwork
from tests.fakes.worker import GRACE, RunningWorker
from tests.worker.runtime import scripted_simulator
from tests.worker.runtime.scripted_simulator import DAWDLE, HANG, WAIT, work

from qdgrasp_protocol import messages
from qdgrasp_protocol.keys import Keys
from qdgrasp_protocol.messages import Control, Work


@pytest.fixture
def network() -> MemoryNetwork:
    return MemoryNetwork()


@pytest.fixture
def log(tmp_path: Path) -> Path:
    return tmp_path / "rows"


@pytest.fixture
def go_on(log: Path) -> Callable[[], None]:
    """Lets rows that wait go on."""
    return scripted_simulator.go_on(log).touch


@pytest.fixture
def hire(network: MemoryNetwork, log: Path) -> Iterator[Callable[..., RunningWorker]]:
    hired: list[RunningWorker] = []

    def hire(job: str | None = None, grace: float = GRACE) -> RunningWorker:
        hired.append(RunningWorker(network.session(), job, grace, [*scripted_simulator.COMMAND, str(log)]))
        return hired[-1]

    yield hire
    for worker in hired:
        worker.leave(signal.SIGINT)
        worker.ends()


@pytest.fixture
def open_office(network: MemoryNetwork) -> Iterator[Callable[..., LeasingCoordinator]]:
    with ExitStack() as stack:
        yield lambda *given, **named: stack.enter_context(LeasingCoordinator(network, *given, **named))


@pytest.fixture
def office(open_office: Callable[..., LeasingCoordinator]) -> LeasingCoordinator:
    return open_office()


@pytest.fixture
def worker(office: LeasingCoordinator, hire: Callable[..., RunningWorker]) -> RunningWorker:
    return hire()


def test_a_worker_fetches_a_scene_once_and_answers_every_batch(office, worker):
    office.give(*(work(batch, n=20) for batch in range(5)))
    office.wait(lambda: len(office.results) == 5, "five results")
    assert office.answered() == [0, 1, 2, 3, 4]
    assert office.fetched == 1
    assert (office.joins[0].platform, office.joins[0].credit) == (scripted_simulator.PLATFORM, 2)
    assert all(result.n == 20 and not result.failures[1:] for result in office.results)


def test_jobs_share_a_worker_and_are_served_in_turn(hire, open_office):
    one, other = open_office("one"), open_office("other")
    order: list[str] = []
    hire()
    for office in (one, other):
        office.wait(lambda office=office: office.joins and office.joins[-1].credit == 1, "half of the credit")
        office.give(work(0))
        office.wait(lambda office=office: office.results, "a first result")
        office.told = lambda result, office=office: order.append(office.job)
    one.give(*(work(batch) for batch in range(1, 31)))
    other.give(*(work(batch) for batch in range(1, 11)))
    for office, count in ((one, 31), (other, 11)):
        office.wait(lambda office=office, count=count: len(office.results) == count, "all results")
    there = [order[i] for i in range(order.index("other"), 40 - order[::-1].index("other"))]
    assert abs(there.count("one") - there.count("other")) <= 2


def test_a_worker_that_is_drained_finishes_what_it_holds_and_leaves_that_job_alone(
    hire, open_office, network
):
    office, other = open_office("drained"), open_office("other")
    worker = hire()
    office.wait(lambda: office.joins and office.joins[-1].credit == 1, "a join")
    office.give(work(1, n=2, row_0=DAWDLE))
    office.control(drain=True)
    office.wait(lambda: not office.workers, "the end of its token")
    assert office.answered() == [1]
    other.wait(lambda: other.joins[-1].credit == 2, "all of the credit")
    joins = len(office.joins)
    office.give(work(3))
    worker.bus.disconnect()
    worker.bus.reconnect()
    office.wait(lambda: len(office.joins) > joins, "a question whether it is still the same coordinator")
    office.wait(lambda: not office.workers, "the end of its token")
    other.wait(lambda: other.joins[-1].credit == 2, "all of the credit")
    other.give(work(2))
    other.wait(lambda: other.results, "a result")
    assert office.answered() == [1]


def test_a_worker_with_one_job_ends_when_that_is_drained_of_it(office, hire):
    worker = hire(job="job")
    office.wait(lambda: office.joins, "a join")
    office.control(drain=True)
    worker.ends()


def test_after_sigterm_the_batch_in_work_is_finished_and_others_are_handed_back(office, worker, go_on):
    office.give(work(0), work(1, n=2, row_0=DAWDLE, row_1=WAIT), work(2), work(3))
    office.wait(lambda: office.results, "a result")
    worker.leave()
    office.wait(lambda: office.joins[-1].credit == 0, "its farewell")
    go_on()
    worker.ends()
    assert (office.joins[-1].credit, office.joins[-1].held) == (0, [work(1).batch])
    assert office.answered() == [0, 1]


def test_a_batch_that_is_not_finished_within_the_grace_is_not_answered(office, hire):
    worker = hire(grace=1.0)
    office.give(work(0), work(1, n=3, row_1=HANG))
    office.wait(lambda: office.results, "a result")
    worker.leave()
    worker.ends()
    assert (office.joins[-1].credit, office.joins[-1].held) == (0, [work(1).batch])
    assert not office.workers
    assert office.answered() == [0]


@pytest.mark.parametrize("signals", [[signal.SIGINT], [signal.SIGTERM, signal.SIGINT]])
def test_sigint_ends_a_worker_at_once_also_one_that_is_about_to_leave(office, hire, signals):
    worker = hire(grace=1000.0)
    office.give(work(0), work(1, row_0=HANG))
    office.wait(lambda: office.results, "a result")
    for number in signals:
        worker.leave(number)
    worker.ends()
    assert not Path(f"/proc/{worker.simulators[-1].pid}").exists()


def test_what_a_killed_simulator_had_is_handed_back_and_nothing_is_held_against_it(office, worker, go_on):
    office.give(work(1, n=2, row_0=DAWDLE, row_1=WAIT))
    office.wait(lambda: office.signs, "a sign of progress")
    os.kill(worker.simulators[0].pid, signal.SIGKILL)
    go_on()
    office.wait(lambda: office.results, "a result")
    assert [join.held for join in office.joins[1:]].count([]) >= 1
    assert office.answered() == [1]
    assert office.results[0].failures == []
    assert len(worker.simulators) == 2


def test_a_message_that_is_not_what_its_key_says_is_dropped_and_told_of(office, worker):
    office.wait(lambda: office.joins, "a join")
    wid, control = office.joins[-1].wid, Control(epoch=1, drop=[], drain=True)
    sent = [
        (Keys("job").ctl(wid), work(1), messages.encoding(Work)),
        (Keys("job").work(wid), control, messages.encoding(Control)),
        (Keys("job").ctl(wid), control, "application/json"),
    ]
    with capture_logs() as logs:
        for key, message, encoding in sent:
            office.bus.put(key, messages.encode(message), encoding=encoding)
        office.give(work(2))
        office.wait(lambda: office.results, "a result")
    assert office.answered() == [2]
    assert office.workers
    assert worker.is_alive
    assert [entry["dropped"] for entry in logs if entry["event"] == "dropped a message"] == [1, 2]


def test_a_batch_that_is_taken_back_is_not_answered(office, worker, go_on):
    office.give(work(1, n=5, row_0=WAIT), work(2), work(3))
    office.wait(lambda: office.fetched, "its beginning")
    office.control(work(1))
    go_on()
    office.wait(lambda: 3 in office.answered(), "the third")
    assert office.answered() == [2, 3]


def test_a_worker_that_its_only_job_refuses_says_why(office, hire):
    office.refusal = "another numpy"
    worker = hire(job="job")
    worker.ends()
    assert "Job 'job' does not take this worker: another numpy" in str(worker.error)


def test_a_scene_that_ends_every_simulator_is_tried_three_times_and_not_again(hire, open_office):
    office = open_office(scene=b"abort")
    worker = hire()
    office.give(*(work(batch, n=2) for batch in range(6)))
    office.wait(lambda: len(office.results) == 6, "six results")
    assert all(len(result.failures) == 2 for result in office.results)
    assert office.results[-1].failures[0].reason == "its scene ends every simulator"
    assert len(worker.simulators) <= 4
