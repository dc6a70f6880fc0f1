"""How long a simulator has said nothing, in whatever way time was spent."""

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
from tests.worker.runtime.leased_batches import work

from qdgrasp_protocol.messages import Result, Work
from qdgrasp_worker.runtime import simulator_supervisor
from qdgrasp_worker.runtime.batch_queue import BatchProgress
from qdgrasp_worker.runtime.process_limits import PROBE_SECONDS, STALL_FACTOR
from qdgrasp_worker.runtime.simulator_messages import SimulatorSettings
from qdgrasp_worker.runtime.simulator_supervisor import (
    LOOK_SLICE,
    NoSimulator,
    SimulatorClient,
    SimulatorEvent,
    SimulatorSupervisor,
    StallDetector,
)


@pytest.fixture
def silence() -> StallDetector:
    silence = StallDetector()
    silence.begin(100.0)
    return silence


def look_again_and_again(
    silence: StallDetector, since: float, slices: int, *, is_stopped: bool = False
) -> float:
    for number in range(1, slices + 1):
        silence.look(since + number * LOOK_SLICE, is_stopped=is_stopped)
    return since + slices * LOOK_SLICE


def test_silence_is_the_time_that_passes(silence):
    now = look_again_and_again(silence, 100.0, 7)
    silence.look(now + LOOK_SLICE / 2, is_stopped=False)
    assert silence.seconds == 7.5 * LOOK_SLICE
    assert silence.look_at == now + 1.5 * LOOK_SLICE


def test_a_word_ends_it(silence):
    now = look_again_and_again(silence, 100.0, 7)
    silence.begin(now)
    assert look_again_and_again(silence, now, 2) == now + 2 * LOOK_SLICE
    assert silence.seconds == 2 * LOOK_SLICE


def test_a_worker_that_stood_still_has_missed_one_slice(silence):
    look_again_and_again(silence, 100.0, 2)
    silence.look(1e6, is_stopped=False)
    assert silence.seconds == 3 * LOOK_SLICE


def test_a_simulator_that_stands_still_is_not_silent(silence):
    now = look_again_and_again(silence, 100.0, 1000, is_stopped=True)
    look_again_and_again(silence, now, 1)
    assert silence.seconds == LOOK_SLICE


def test_before_anything_is_known_of_a_simulator_it_is_looked_at_at_once():
    silence = StallDetector()
    assert silence.look_at == 0.0
    silence.look(1e6, is_stopped=False)
    assert (silence.seconds, silence.look_at) == (0.0, 1e6 + LOOK_SLICE)


BRISK = 0.4
"""CPU seconds of a row, a tenth of the longest silence, in tests of these limits; else rows have PATIENCE."""
MEGABYTE = 1_000_000
SCENE = b"a scene"
PROBE_FOR_EVER = """
import signal
from qdgrasp_worker.runtime import simulator_main as child
child.main(probe=signal.pause)
"""


class Hands:
    """Puts batches into a workshop, and waits for what comes of them."""

    def __init__(self, command: list[str], row_seconds: float = PATIENCE) -> None:
        self.inbox: SimpleQueue[SimulatorEvent] = SimpleQueue()
        self.hired: list[SimulatorClient] = []
        self.command = command
        self.settings = SimulatorSettings(row_seconds=row_seconds, memory=900 * MEGABYTE, nice=0)
        self.workshop = SimulatorSupervisor(self.hire, row_seconds=row_seconds, memory=250 * MEGABYTE)
        self.done: list[Result] = []
        self.lost: list[BatchProgress] = []

    def hire(self) -> SimulatorClient:
        self.hired.append(SimulatorClient(self.command, self.settings, self.inbox.put))
        return self.hired[-1]

    def begin(self) -> None:
        """Wait until a batch may be put in."""
        while not self.workshop.has_room:
            self.hear()

    def hear(self, patience: float = PATIENCE) -> None:
        """Take the next news, if they come soon enough, and have begun batches go on."""
        if self.workshop.opens_at < inf:
            self.workshop.tick(self.workshop.opens_at)
            return
        try:
            news = self.inbox.get(timeout=max(0.0, min(patience, self.workshop.tick_at - monotonic())))
        except Empty:
            self.workshop.tick(monotonic())
            return
        upshot = self.workshop.hear(news, monotonic())
        self.done += [task.result("a" * 32) for task in upshot.done]
        self.lost += upshot.lost
        while self.workshop.has_room and (task := self.workshop.next_again):
            self.put(task)

    def let_pass(self, seconds: float) -> None:
        """Have so much time pass at once, in which nothing is heard."""
        began = monotonic()
        for second in range(round(seconds)):
            self.workshop.tick(began + second)

    def put(self, task: BatchProgress, bundle: bytes = SCENE) -> None:
        known = self.workshop.has_scene(task.work.scene)
        self.workshop.put(task, None if known else bundle, monotonic())

    def evaluate(self, batch: Work, bundle: bytes = SCENE) -> Result:
        """The result of one batch."""
        self.begin()
        self.put(BatchProgress("job", batch), bundle)
        while not self.done:
            self.hear()
        return self.done.pop()


@pytest.fixture
def log(tmp_path: Path) -> Path:
    return tmp_path / "rows"


@pytest.fixture
def start(log: Path) -> Iterator[Callable[[float], Hands]]:
    """Opens workshops whose rows have so many CPU seconds."""
    with ExitStack() as stack:

        def start(row_seconds: float) -> Hands:
            hands = Hands([*scripted_simulator.COMMAND, str(log)], row_seconds)
            stack.enter_context(hands.workshop)
            return hands

        yield start


@pytest.fixture
def hands(start: Callable[[float], Hands]) -> Hands:
    return start(PATIENCE)


def fitness(result: Result) -> list[float]:
    return np.frombuffer(result.columns["fitness"], "<f4").tolist()


def test_a_batch_comes_back_with_the_rows_in_order(hands):
    result = hands.evaluate(work(n=40))
    assert fitness(result) == list(range(40))
    assert [(failure.row, failure.reason) for failure in result.failures] == [(13, "odd")]
    assert hands.workshop.platform == scripted_simulator.PLATFORM
    assert len(hands.hired) == 1


def test_a_simulator_that_stood_still_for_long_is_no_evidence_against_its_row(start):
    hands = start(10.0)
    hands.begin()
    (simulator,) = hands.hired
    os.kill(simulator.pid, signal.SIGSTOP)
    while not simulator.vitals.is_stopped:
        pass
    hands.put(BatchProgress("job", work()))
    hands.let_pass(10 * STALL_FACTOR * 10.0)
    os.kill(simulator.pid, signal.SIGCONT)
    while not hands.done:
        hands.hear()
    assert (hands.done[0].failures, hands.hired) == ([], [simulator])


def test_a_worker_that_stood_still_for_long_ends_no_simulator_for_it(start):
    hands = start(10.0)
    hands.begin()
    (simulator,) = hands.hired
    hands.put(BatchProgress("job", work(row_0=scripted_simulator.DAWDLE)))
    hands.workshop.tick(monotonic() + 10 * STALL_FACTOR * 10.0)
    while not hands.done:
        hands.hear()
    assert (hands.done[0].failures, hands.hired) == ([], [simulator])


def test_a_row_at_which_simulators_fall_silent_is_found(start, log):
    hands = start(BRISK)
    hands.begin()
    hands.put(BatchProgress("job", work(n=3, row_1=scripted_simulator.SLEEP)))
    for silences in (1, 2):
        while not log.exists() or log.read_text().split().count("1") < silences:
            hands.hear(0.01)
        hands.let_pass(STALL_FACTOR * BRISK + 2)
        while len(hands.hired) == silences:
            hands.hear()
    while not hands.done:
        hands.hear()
    (result,) = hands.done
    reason = f"the simulator said nothing for {STALL_FACTOR * BRISK:g} s"
    assert [(failure.row, failure.reason) for failure in result.failures] == [(1, reason)]
    assert fitness(result) == [0, 0, 2]


def test_probes_that_never_end_end_the_simulator():
    hands = Hands([sys.executable, "-c", PROBE_FOR_EVER])
    with hands.workshop:
        hands.let_pass(STALL_FACTOR * PROBE_SECONDS + 2)
        with pytest.raises(NoSimulator, match="said nothing"):
            hands.begin()


@pytest.mark.parametrize(
    ("deed", "reason"),
    [
        (scripted_simulator.ABORT, "the simulator was ended by SIGABRT"),
        (scripted_simulator.HANG, f"the simulator took more than {BRISK} CPU seconds"),
        (scripted_simulator.RAISE, "ValueError: as the genome wants it"),
        (scripted_simulator.EXIT, "the simulator ended with exit code 3"),
        (scripted_simulator.TAKE_EVERYTHING, "MemoryError: "),
    ],
)
def test_the_row_that_ends_a_simulator_is_found_and_the_others_are_evaluated(
    start, deed, reason, monkeypatch
):
    monkeypatch.setattr(simulator_supervisor, "STALL_FACTOR", inf)  # CPU seconds may take long to come by
    hands = start(BRISK if deed == scripted_simulator.HANG else PATIENCE)
    result = hands.evaluate(work(n=20, row_7=deed))
    assert [(failure.row, failure.reason) for failure in result.failures] == [(7, reason), (13, "odd")]
    assert fitness(result) == [0 if row == 7 else row for row in range(20)]
    assert len(hands.hired) == 3


def test_two_rows_that_end_simulators_are_both_found(hands):
    result = hands.evaluate(work(n=8, row_0=scripted_simulator.ABORT, row_7=scripted_simulator.RAISE))
    assert [failure.row for failure in result.failures] == [0, 7]
    assert fitness(result) == [0, 1, 2, 3, 4, 5, 6, 0]


def test_rows_that_are_known_are_not_evaluated_again(hands, log):
    hands.evaluate(work(n=20, row_1=scripted_simulator.DAWDLE, row_18=scripted_simulator.ABORT))
    begun = [int(line) for line in log.read_text().split()]
    assert [begun.count(row) for row in (0, 15, 16, 17, 18, 19)] == [1, 1, 2, 2, 2, 1]


def test_the_batch_that_waits_behind_goes_to_the_next_simulator(hands):
    hands.begin()
    hands.put(BatchProgress("job", work(1, n=3, row_1=scripted_simulator.ABORT)))
    hands.put(BatchProgress("job", work(2, n=3)))
    assert not hands.workshop.has_room
    while len(hands.done) < 2:
        hands.hear()
    first, second = hands.done
    assert [failure.row for failure in first.failures] == [1]
    assert (second.batch, second.failures, fitness(second)) == (work(2).batch, [], [0, 1, 2])


def test_a_kill_from_outside_says_nothing_against_a_row(hands):
    hands.begin()
    hands.put(BatchProgress("job", work(n=3, row_1=scripted_simulator.BE_KILLED)))
    while not hands.lost:
        hands.hear()
    assert hands.done == []
    assert [task.work.batch for task in hands.lost] == [work().batch]
    assert fitness(hands.evaluate(work(2, n=3))) == [0, 1, 2]


def test_a_simulator_heeds_no_signal_that_is_meant_for_its_worker(hands):
    hands.evaluate(work(1))
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        os.kill(hands.hired[0].pid, number)
    assert hands.evaluate(work(2, n=3)).failures == []
    assert len(hands.hired) == 1


def test_a_scene_that_cannot_be_used_fails_its_batch_and_no_simulator(hands):
    result = hands.evaluate(work(n=2), b"no scene")
    assert {failure.reason for failure in result.failures} == {"This is no scene."}
    assert fitness(hands.evaluate(work(n=2, scene="1" * 64))) == [0, 1]
    assert len(hands.hired) == 1


def test_a_scene_that_ends_the_simulator_fails_its_batch_at_once(hands):
    result = hands.evaluate(work(n=20), b"abort")
    reasons = {failure.reason for failure in result.failures}
    assert reasons == {"the simulator was ended by SIGABRT while it loaded the scene"}
    assert len(result.failures) == 20
    assert len(hands.hired) == 1


def test_a_scene_that_a_simulator_no_longer_has_is_given_to_it_again(hands):
    scenes = [f"{number:064x}" for number in range(9)]
    for number, scene in enumerate(scenes):
        hands.evaluate(work(number, scene=scene))
    assert fitness(hands.evaluate(work(9, n=3, scene=scenes[0]))) == [0, 1, 2]


def test_a_simulator_that_takes_too_much_memory_is_replaced_between_batches(hands):
    leaks = {f"row_{row}": scripted_simulator.LEAK for row in range(3)}
    hands.begin()
    hands.put(BatchProgress("job", work(1, n=4, **leaks)))
    while not hands.done:
        hands.hear()
    assert fitness(hands.done.pop()) == [0, 1, 2, 3]
    hands.workshop.look()
    assert not hands.workshop.has_room
    hands.workshop.tick(monotonic())
    assert fitness(hands.evaluate(work(2, n=3))) == [0, 1, 2]
    assert len(hands.hired) == 2
    assert hands.lost == []


def test_a_simulator_that_does_not_start_is_said_with_its_reason():
    hands = Hands([*scripted_simulator.COMMAND[:2], "tests.worker.runtime.no_such_module"])
    with hands.workshop, pytest.raises(NoSimulator, match="ended with exit code 1"):
        hands.begin()
