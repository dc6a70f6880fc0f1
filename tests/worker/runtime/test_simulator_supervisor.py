"""The supervision of simulators: their stall, their crashes, and the batches that they had."""

import os
import signal
import sys
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from math import inf
from pathlib import Path
from queue import Empty, SimpleQueue
from time import monotonic

import numpy as np
import pytest
from tests.common import PATIENCE
from tests.worker.runtime import scripted_simulator
from tests.worker.runtime.scripted_simulator import (
    ABORT,
    BE_KILLED,
    EXIT,
    HANG,
    LEAK,
    RAISE,
    SLEEP,
    TAKE_EVERYTHING,
    work,
)

from qdgrasp_protocol.messages import Result, Work
from qdgrasp_protocol.process_limits import PROBE_SECONDS, STALL_FACTOR
from qdgrasp_worker.runtime import simulator_supervisor
from qdgrasp_worker.runtime.simulator_messages import BatchProgress
from qdgrasp_worker.runtime.simulator_supervisor import (
    NoSimulator,
    SimulatorClient,
    SimulatorEvent,
    SimulatorSupervisor,
)

BRISK = 0.4
"""CPU seconds of a row, a tenth of the longest stall, where limits are tested."""
MEGABYTE = 1_000_000
SCENE = b"a scene"
PROBE_FOR_EVER = """
import signal
from qdgrasp_worker.runtime import simulator_main as child
child.main(probe=signal.pause)
"""


class Supervision:
    """Submits batches to a supervisor, and waits for their results."""

    def __init__(self, command: list[str], row_seconds: float = PATIENCE) -> None:
        self.inbox: SimpleQueue[SimulatorEvent] = SimpleQueue()
        self.started: list[SimulatorClient] = []
        self.command = [*command, str(row_seconds), str(900 * MEGABYTE), "0"]
        self.supervisor = SimulatorSupervisor(self.start, row_seconds=row_seconds, memory=250 * MEGABYTE)
        self.done: list[Result] = []
        self.lost: list[BatchProgress] = []

    def start(self) -> SimulatorClient:
        self.started.append(SimulatorClient(self.command, self.inbox.put))
        return self.started[-1]

    def begin(self) -> None:
        """Wait until a batch may be put in."""
        while not self.supervisor.has_room:
            self.receive()

    def receive(self, patience: float = PATIENCE) -> None:
        """Take the next event, if it comes soon enough, and have begun batches go on."""
        if self.supervisor.restart_at < inf:
            self.supervisor.step(self.supervisor.restart_at)
            return
        try:
            event = self.inbox.get(timeout=patience)
        except Empty:
            self.supervisor.step(monotonic())
            return
        for task in self.supervisor.on_event(event, monotonic()):
            if task.is_done:
                self.done.append(task.result("a" * 32, bytes(32)))
            else:
                self.lost.append(task)
        while self.supervisor.has_room and (task := self.supervisor.next_requeued):
            self.submit(task)

    def let_pass(self, seconds: float) -> None:
        """Have so much time pass at once, in which no event is taken."""
        for _ in range(round(seconds)):
            self.supervisor.on_heartbeat()

    def submit(self, task: BatchProgress, bundle: bytes = SCENE) -> None:
        known = self.supervisor.has_scene(task.work.scene)
        self.supervisor.submit(task, None if known else bundle)

    def give(self, batch: Work, bundle: bytes = SCENE) -> None:
        """Have a batch begun, as soon as there is room."""
        self.begin()
        self.submit(BatchProgress("job", batch), bundle)

    def result(self) -> Result:
        """Wait for the next result."""
        while not self.done:
            self.receive()
        return self.done.pop(0)

    def evaluate(self, batch: Work, bundle: bytes = SCENE) -> Result:
        self.give(batch, bundle)
        return self.result()


@pytest.fixture
def log(tmp_path: Path) -> Path:
    return tmp_path / "rows"


@pytest.fixture
def start(log: Path) -> Iterator[Callable[[float], Supervision]]:
    """Opens supervisors whose rows have so many CPU seconds."""
    with ExitStack() as stack:

        def start(row_seconds: float) -> Supervision:
            supervision = Supervision([*scripted_simulator.COMMAND, str(log)], row_seconds)
            stack.enter_context(supervision.supervisor)
            return supervision

        yield start


@pytest.fixture
def supervision(start: Callable[[float], Supervision]) -> Supervision:
    return start(PATIENCE)


def fitness(result: Result) -> list[float]:
    return np.frombuffer(result.columns["fitness"], "<f4").tolist()


def failed(result: Result) -> list[tuple[int, str]]:
    return [(failure.row, failure.reason) for failure in result.failures]


def test_a_batch_comes_back_with_the_rows_in_order(supervision):
    result = supervision.evaluate(work(n=40))
    assert fitness(result) == list(range(40))
    assert failed(result) == [(13, "odd")]
    assert supervision.supervisor.platform == scripted_simulator.PLATFORM
    assert len(supervision.started) == 1


def test_a_simulator_that_stood_still_for_long_is_no_evidence_against_its_row(start):
    supervision = start(10.0)
    supervision.begin()
    (simulator,) = supervision.started
    os.kill(simulator.pid, signal.SIGSTOP)
    while not simulator.stats.is_stopped:
        pass
    supervision.give(work())
    supervision.let_pass(10 * STALL_FACTOR * 10.0)
    os.kill(simulator.pid, signal.SIGCONT)
    assert (supervision.result().failures, supervision.started) == ([], [simulator])


def test_a_row_at_which_simulators_fall_silent_is_found(start, log):
    supervision = start(BRISK)
    supervision.give(work(n=3, row_1=SLEEP))
    for silences in (1, 2):
        while not log.exists() or log.read_text().split().count("1") < silences:
            supervision.receive(0.01)
        supervision.let_pass(STALL_FACTOR * BRISK + 2)
        while len(supervision.started) == silences:
            supervision.receive()
    result = supervision.result()
    reason = f"the simulator said nothing for {STALL_FACTOR * BRISK:g} s"
    assert failed(result) == [(1, reason)]
    assert fitness(result) == [0, 0, 2]


def test_probes_that_never_end_end_the_simulator():
    supervision = Supervision([sys.executable, "-c", PROBE_FOR_EVER])
    with supervision.supervisor:
        supervision.let_pass(STALL_FACTOR * PROBE_SECONDS + 2)
        with pytest.raises(NoSimulator, match="said nothing"):
            supervision.begin()


@pytest.mark.parametrize(
    ("deed", "reason"),
    [
        (ABORT, "the simulator was ended by SIGABRT"),
        (HANG, f"the simulator took more than {BRISK} CPU seconds"),
        (RAISE, "ValueError: as the genome wants it"),
        (EXIT, "the simulator ended with exit code 3"),
        (TAKE_EVERYTHING, "MemoryError: "),
    ],
)
def test_the_row_that_ends_a_simulator_is_found_and_the_others_are_evaluated(
    start, deed, reason, monkeypatch
):
    monkeypatch.setattr(simulator_supervisor, "STALL_FACTOR", inf)  # CPU seconds may take long to come by
    supervision = start(BRISK if deed == HANG else PATIENCE)
    result = supervision.evaluate(work(n=20, row_7=deed))
    assert failed(result) == [(7, reason), (13, "odd")]
    assert fitness(result) == [0 if row == 7 else row for row in range(20)]
    assert len(supervision.started) == 3


def test_the_batch_that_waits_behind_goes_to_the_next_simulator(supervision):
    supervision.give(work(1, n=3, row_1=ABORT))
    supervision.give(work(2, n=3))
    assert not supervision.supervisor.has_room
    first, second = supervision.result(), supervision.result()
    assert [failure.row for failure in first.failures] == [1]
    assert (second.batch, second.failures, fitness(second)) == (work(2).batch, [], [0, 1, 2])


def test_a_kill_from_outside_says_nothing_against_a_row(supervision):
    supervision.give(work(n=3, row_1=BE_KILLED))
    while not supervision.lost:
        supervision.receive()
    assert supervision.done == []
    assert [task.work.batch for task in supervision.lost] == [work().batch]
    assert fitness(supervision.evaluate(work(2, n=3))) == [0, 1, 2]


def test_a_scene_that_ends_the_simulator_fails_its_batch_at_once(supervision):
    reason = "the simulator was ended by SIGABRT while it loaded the scene"
    assert failed(supervision.evaluate(work(n=20), b"abort")) == [(row, reason) for row in range(20)]
    assert len(supervision.started) == 1


def test_a_scene_that_a_simulator_no_longer_has_is_given_to_it_again(supervision):
    scenes = [f"{number:064x}" for number in range(9)]
    for number, scene in enumerate(scenes):
        supervision.evaluate(work(number, scene=scene))
    assert fitness(supervision.evaluate(work(9, n=3, scene=scenes[0]))) == [0, 1, 2]


def test_a_simulator_that_takes_too_much_memory_is_replaced_between_batches(supervision):
    leaks = {f"row_{row}": LEAK for row in range(3)}
    assert fitness(supervision.evaluate(work(1, n=4, **leaks))) == [0, 1, 2, 3]
    supervision.supervisor.on_heartbeat()
    assert not supervision.supervisor.has_room
    supervision.supervisor.step(monotonic())
    assert fitness(supervision.evaluate(work(2, n=3))) == [0, 1, 2]
    assert len(supervision.started) == 2
    assert supervision.lost == []


def test_simulators_that_are_killed_at_their_start_end_the_worker_after_three():
    command = [sys.executable, "-c", "import os; os.kill(os.getpid(), 9)"]
    supervision = Supervision(command)
    with (
        supervision.supervisor,
        pytest.raises(NoSimulator, match="3 died without a row; the last was killed"),
    ):
        supervision.begin()


def test_a_simulator_that_does_not_start_is_said_with_its_reason():
    supervision = Supervision([*scripted_simulator.COMMAND[:2], "tests.worker.runtime.no_such_module"])
    with supervision.supervisor, pytest.raises(NoSimulator, match="ended with exit code 1"):
        supervision.begin()
