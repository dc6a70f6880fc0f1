"""Supervises the simulator's process: starts it, feeds it batches, ends a stalled one, starts the next.

A stall is counted in slices of time: while the simulator stood still (SIGSTOP), or its worker did, it is not
at fault, and a slice that took longer, because nothing looked, counts as one. Time is passed in, in seconds
of any steady clock.
"""

import signal
import socket
import subprocess
import sys
import threading
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from itertools import chain, repeat
from math import inf
from pathlib import Path
from queue import SimpleQueue
from typing import Self

import structlog

from qdgrasp_protocol.errors import InputError, MessageError, QdgraspError
from qdgrasp_worker.runtime import simulator_messages
from qdgrasp_worker.runtime.batch_queue import BatchProgress, InFlightBatches
from qdgrasp_worker.runtime.process_limits import (
    CPU_LIMIT_SIGNAL,
    NO_STATS,
    PROBE_SECONDS,
    STALL_FACTOR,
    STALL_SIGNAL,
    ProcessStats,
    process_stats,
)
from qdgrasp_worker.runtime.simulator_messages import (
    AnySimulatorMessage,
    FramedSocket,
    PartialResult,
    SceneMissing,
    SimulatorCrashed,
    SimulatorMessage,
    SimulatorReady,
    SimulatorSettings,
)

LOOK_SLICE = 1.0  # Seconds between two looks at a simulator that is at work


class StallDetector:
    """The silence of a simulator."""

    def __init__(self) -> None:
        self.seconds = 0.0
        """How long it has lasted."""
        self._looked_at: float | None = None

    def begin(self, now: float) -> None:
        """Hear that the simulator said something, or was given something to do."""
        self.seconds, self._looked_at = 0.0, now

    @property
    def look_at(self) -> float:
        """When to look next."""
        return 0.0 if self._looked_at is None else self._looked_at + LOOK_SLICE

    def look(self, now: float, *, is_stopped: bool) -> None:
        """Look at the simulator, which may stand still now."""
        before, self._looked_at = self._looked_at, now
        if not (before is None or is_stopped):
            self.seconds += min(now - before, LOOK_SLICE)


STANDARD_ERROR = 2
OUTSIDE_SIGNALS = (signal.SIGKILL, signal.SIGTERM, signal.SIGINT, signal.SIGHUP)
"""What ends a simulator without a word on what it was at."""


@dataclass(frozen=True)
class SimulatorSaid:
    """A simulator said something."""

    simulator: "SimulatorClient"
    frame: AnySimulatorMessage


@dataclass(frozen=True)
class SimulatorEnded:
    """A simulator ended; nothing more is heard of it."""

    simulator: "SimulatorClient"
    code: int
    """Its exit code; negative: the signal that killed it."""


SimulatorEvent = SimulatorSaid | SimulatorEnded


class SimulatorClient:
    """A simulator's process, with a thread that reads and one that writes: no call here waits for it.

    Parameters
    ----------
    command
        What is started, with the line as its standard input.
    hear
        Called from the reading thread.
    """

    def __init__(
        self, command: Sequence[str], settings: SimulatorMessage, hear: Callable[[SimulatorEvent], None]
    ) -> None:
        ours, its = socket.socketpair()
        with its:
            self._process = subprocess.Popen(
                command, stdin=its.fileno(), stdout=STANDARD_ERROR, start_new_session=True
            )
        self._line = FramedSocket(ours)
        self._hear = hear
        self._outbox: SimpleQueue[SimulatorMessage | None] = SimpleQueue()
        self.say(settings)
        for work in (self._read, self._write):
            threading.Thread(target=work, name="simulator", daemon=True).start()

    def say(self, frame: SimulatorMessage) -> None:
        """Say something; it is heard when the simulator has done all that was said before."""
        self._outbox.put(frame)

    @property
    def pid(self) -> int:
        """The id of its process."""
        return self._process.pid

    @property
    def vitals(self) -> ProcessStats:
        """What it takes of the processor and the memory."""
        return process_stats(self.pid)

    def stop(self) -> None:
        """End it for having said nothing for too long; its end is heard as any other."""
        self._process.send_signal(STALL_SIGNAL)

    def close(self) -> None:
        """End it at once, whatever it is at; closing twice is allowed."""
        self._process.kill()
        self._process.wait()
        self._outbox.put(None)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _read(self) -> None:
        try:
            while (data := self._line.receive()) is not None:
                self._hear(SimulatorSaid(self, simulator_messages.decode(data)))
        except MessageError:  # its memory is not what it was
            self._process.kill()
        self._hear(SimulatorEnded(self, self._process.wait()))
        self._outbox.put(None)

    def _write(self) -> None:
        while (frame := self._outbox.get()) is not None:
            try:
                self._line.send(simulator_messages.encode(frame))
            except OSError:  # it ended; the reading thread tells
                break
        self._line.close()


def crash_reason(code: int, row_seconds: float) -> str | None:
    """Why a simulator ended, where that speaks against what it was at; None: it was killed from outside."""
    if code > 0:
        return f"the simulator ended with exit code {code}"
    if -code == CPU_LIMIT_SIGNAL:
        return f"the simulator took more than {row_seconds:g} CPU seconds"
    if -code == STALL_SIGNAL:
        return f"the simulator said nothing for {STALL_FACTOR * row_seconds:g} s"
    if code == 0 or -code in OUTSIDE_SIGNALS:
        return None
    return f"the simulator was ended by {signal.Signals(-code).name}"


log = structlog.get_logger()

RESTART_PAUSES = (0.0, 0.5, 1.0, 2.0, 4.0)
"""Seconds before the next simulator, by how many were killed or did not start since a row was evaluated."""
LAST_RESTART_PAUSE = 8.0  # Seconds before each one after those
MEMORY_HEADROOM = 1.4  # So many times the memory that a simulator may keep it may ask for within a batch
MAX_LOAD_CRASHES = 3  # A scene that ended so many simulators while it was loaded is not tried again
SIMULATOR_COMMAND = [sys.executable, "-m", "qdgrasp_worker.runtime.simulator_main"]


def simulator_command(evaluator: str | None) -> list[str]:
    """What starts a simulator: ours, or one with an evaluator that is named FILE.py:NAME or MODULE:NAME.

    Raises
    ------
    InputError
        That is no such name, or there is no such file.
    """
    if evaluator is None:
        return SIMULATOR_COMMAND
    where, mark, name = evaluator.rpartition(":")
    if not (mark and where and name):
        raise InputError(f"An evaluator is named FILE.py:NAME or MODULE:NAME, got '{evaluator}'.")
    if where.endswith(".py"):
        if not Path(where).is_file():
            raise InputError(f"There is no file {where} to take the evaluator '{name}' from.")
        where = str(Path(where).resolve())
    return [sys.executable, "-m", "qdgrasp_worker.runtime.custom_evaluator", f"{where}:{name}"]


class NoSimulator(QdgraspError):
    """A simulator that ends before it has evaluated the probes, with the reason."""

    def __init__(self, reason: str) -> None:
        super().__init__(f"The simulator does not start: {reason}.")


class OtherPlatform(QdgraspError):
    """The simulator that was started again is not the one that this worker joined with."""

    def __init__(self) -> None:
        super().__init__("The package was changed while this worker ran; start it again.")


@dataclass(frozen=True)
class BatchOutcomes:
    """What came of news from the simulator."""

    done: list[BatchProgress] = field(default_factory=list)
    """Batches whose every row is known."""
    lost: list[BatchProgress] = field(default_factory=list)
    """Batches that a kill from outside took away; nothing is known against them."""


class SimulatorSupervisor:
    """Batches in, results out; a context manager that ends the simulator.

    Parameters
    ----------
    hire
        Starts a simulator; its news are to come back to `hear`.
    row_seconds
        What the simulator was told of its time, for the words with which it is mourned.
    memory
        The most that it may take between two batches [bytes]; above that another one is started.
    """

    def __init__(self, hire: Callable[[], SimulatorClient], *, row_seconds: float, memory: int) -> None:
        self._hire = hire
        self._row_seconds = row_seconds
        self._memory = memory
        self._docket = InFlightBatches()
        self._scenes: set[str] = set()
        self._fatal: Counter[str] = Counter()
        self._pauses = restart_pauses()
        self._silence = StallDetector()
        self._is_retiring = False
        self._last_words = ""
        self._vitals = NO_STATS
        self.restarts = 0
        """How often another simulator was started."""
        self.platform: dict[str, str] | None = None
        """What decides the bits of its results; None until the first simulator has said it."""
        self.is_ready = False
        """A simulator is there that has evaluated the probes."""
        self.opens_at = inf
        """When the next simulator is to be started; infinite: there is one."""
        self._simulator = hire()

    @classmethod
    def open(
        cls,
        hear: Callable[[SimulatorEvent], None],
        row_seconds: float,
        memory: int,
        nice: int,
        command: Sequence[str] = SIMULATOR_COMMAND,
    ) -> "SimulatorSupervisor":
        """A workshop with simulators of its own, the first of which starts now."""
        settings = SimulatorSettings(
            row_seconds=row_seconds, memory=round(MEMORY_HEADROOM * memory), nice=nice
        )
        return cls(lambda: SimulatorClient(command, settings, hear), row_seconds=row_seconds, memory=memory)

    def __enter__(self) -> "SimulatorSupervisor":
        return self

    def __exit__(self, *_: object) -> None:
        self._simulator.close()

    # Batches.

    @property
    def has_room(self) -> bool:
        """A batch may be put in."""
        return self.is_ready and not self._is_retiring and self._docket.has_room

    @property
    def head(self) -> BatchProgress | None:
        """The batch that is worked on."""
        return self._docket.head

    @property
    def tasks(self) -> list[BatchProgress]:
        """All batches that are here."""
        return self._docket.tasks

    @property
    def next_again(self) -> BatchProgress | None:
        """A batch that was begun, and goes on before others: put it in again, or drop it."""
        return self._docket.next_again

    def has_scene(self, digest: str) -> bool:
        """Whether the simulator was given a scene."""
        return digest in self._scenes

    def is_fatal(self, digest: str) -> bool:
        """Whether a scene ended so many simulators while they loaded it that it is not tried again."""
        return self._fatal[digest] >= MAX_LOAD_CRASHES

    def put(self, task: BatchProgress, bundle: bytes | None, now: float) -> None:
        """Let the simulator evaluate a batch, with its scene unless it has that."""
        if self.head is None:
            self._silence.begin(now)
        self._simulator.say(task.request(bundle))
        self._docket.send(task, now)
        self._scenes.add(task.work.scene)

    def drop(self, task: BatchProgress) -> None:
        """Forget `next_again`."""
        self._docket.drop(task)

    # News of the simulator.

    def hear(self, news: SimulatorEvent, now: float) -> BatchOutcomes:
        """Take what the simulator says, or that it ended; what came late from an older one is passed over.

        Raises
        ------
        NoSimulator
            No simulator can be started here.
        OtherPlatform
            This one is of another platform than the one before.
        """
        if news.simulator is not self._simulator or self.opens_at < inf:
            return BatchOutcomes()
        if isinstance(news, SimulatorSaid):
            return self._said(news.frame, now)
        return self._ended(news, now)

    def _said(self, frame: AnySimulatorMessage, now: float) -> BatchOutcomes:
        self._silence.begin(now)
        match frame:
            case SimulatorReady(platform=platform):
                self._welcome(platform)
            case SimulatorCrashed(reason=reason):
                self._last_words = reason
            case SceneMissing() if self.head is not None:
                self._scenes.discard(self.head.work.scene)
            case PartialResult():
                self._pauses = restart_pauses()
        done = self._docket.hear(frame, now)
        return BatchOutcomes(done=[done] if done else [])

    def _welcome(self, platform: dict[str, str]) -> None:
        if self.platform is not None and platform != self.platform:
            raise OtherPlatform
        self.platform = platform
        self.is_ready = True

    def _ended(self, news: SimulatorEnded, now: float) -> BatchOutcomes:
        reason = self._last_words or crash_reason(news.code, self._row_seconds)
        if self.platform is None and reason:
            raise NoSimulator(reason)
        log.warning("the simulator ended; another one is started", reason=reason or "it was killed")
        is_of_a_row = reason is not None and self.is_ready
        self._close(now if is_of_a_row else now + next(self._pauses))
        if reason is None:
            return BatchOutcomes(lost=self._docket.lose())
        if self.head is not None and self.head.is_loading:
            self._fatal[self.head.work.scene] += 1
        done = self._docket.stumble(reason)
        return BatchOutcomes(done=[done] if done else [])

    # Time passes.

    @property
    def tick_at(self) -> float:
        """When `tick` has something to do if nothing happens before; infinite: never."""
        return min(self.opens_at, self._silence.look_at if self._is_at_work else inf)

    @property
    def _is_at_work(self) -> bool:
        """Something is awaited of a simulator that is there: the probes, or a batch."""
        return self.opens_at == inf and not (self.is_ready and self.head is None)

    def tick(self, now: float) -> None:
        """Start the next simulator when it is time, and end one that is silent, or takes too much memory."""
        if now >= self.opens_at:
            self.opens_at = inf
            self.restarts += 1
            self._simulator = self._hire()
        elif self._is_retiring and self.head is None:
            self._simulator.close()
            self._close(now)
        elif now >= self.tick_at:
            self._listen(now)

    def _listen(self, now: float) -> None:
        """End the simulator if it has been silent for too long."""
        self._silence.look(now, is_stopped=self._simulator.vitals.is_stopped)
        if self._silence.seconds > STALL_FACTOR * (self._row_seconds if self.is_ready else PROBE_SECONDS):
            self._silence.begin(now)
            self._simulator.stop()

    def look(self) -> bool:
        """Look at the simulator: whether it did anything since the last time, and what memory it takes."""
        before, self._vitals = self._vitals, self._simulator.vitals
        if self._vitals.memory > self._memory and not self._is_retiring:
            self._is_retiring = True
            log.warning("the simulator takes too much memory and is replaced", bytes=self._vitals.memory)
        return self._vitals.cpu_seconds != before.cpu_seconds

    @property
    def memory(self) -> int:
        """What the simulator took at the last look [bytes]."""
        return self._vitals.memory

    def _close(self, opens_at: float) -> None:
        """Forget the simulator that there was."""
        self.is_ready = self._is_retiring = False
        self.opens_at = opens_at
        self._last_words = ""
        self._silence = StallDetector()
        self._scenes.clear()


def restart_pauses() -> chain[float]:
    """The pauses before the next simulators, from the first on."""
    return chain(RESTART_PAUSES, repeat(LAST_RESTART_PAUSE))
