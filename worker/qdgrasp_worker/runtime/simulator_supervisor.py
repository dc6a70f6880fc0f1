"""Supervision of the simulator's process: batches sent to it, stalls, crashes and restarts.

A stall is counted in heartbeats of the worker: while the simulator or its worker stood still (SIGSTOP), the
simulator is not at fault. Time is passed in, in seconds of any steady clock.
"""

import signal
import subprocess
import sys
import threading
from collections import Counter, deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import inf
from multiprocessing import Pipe
from pathlib import Path
from queue import SimpleQueue
from typing import Self

import structlog

from qdgrasp_protocol.errors import InputError, MessageError, QdgraspError
from qdgrasp_protocol.process import RestartPolicy
from qdgrasp_protocol.process_limits import (
    CPU_LIMIT_SIGNAL,
    NO_STATS,
    PROBE_SECONDS,
    STALL_FACTOR,
    STALL_SIGNAL,
    ProcessStats,
    process_stats,
)
from qdgrasp_protocol.spec import Device
from qdgrasp_worker.runtime.simulator_messages import (
    AnySimulatorMessage,
    BatchProgress,
    BatchRejected,
    MessageConnection,
    PartialResult,
    SceneLoaded,
    SceneMissing,
    SimulatorCrashed,
    SimulatorMessage,
    SimulatorReady,
)

STANDARD_ERROR = 2
OUTSIDE_SIGNALS = (signal.SIGKILL, signal.SIGTERM, signal.SIGINT, signal.SIGHUP)
"""Signals that end a simulator and are no evidence against its batch."""


@dataclass(frozen=True)
class SimulatorSaid:
    """A simulator sent a message."""

    simulator: "SimulatorClient"
    message: AnySimulatorMessage


@dataclass(frozen=True)
class SimulatorEnded:
    """A simulator ended; nothing more comes from it."""

    simulator: "SimulatorClient"
    code: int
    """Its exit code; negative: the signal that killed it."""


SimulatorEvent = SimulatorSaid | SimulatorEnded


class SimulatorClient:
    """A simulator's process, read and written by two threads: no call here waits for it.

    Its events are reported in the reading thread.
    """

    def __init__(self, command: Sequence[str], report: Callable[[SimulatorEvent], None]) -> None:
        ours, its = Pipe()
        with its:
            self._process = subprocess.Popen(
                command, stdin=its.fileno(), stdout=STANDARD_ERROR, start_new_session=True
            )
        self.pid = self._process.pid
        self._pipe = MessageConnection(ours)
        self._report = report
        self._outbox: SimpleQueue[SimulatorMessage | None] = SimpleQueue()
        for work in (self._read, self._write):
            threading.Thread(target=work, name="simulator", daemon=True).start()

    def send(self, message: SimulatorMessage) -> None:
        """Send a message; it is read when all earlier requests are done."""
        self._outbox.put(message)

    @property
    def stats(self) -> ProcessStats:
        """Its processor time and memory."""
        return process_stats(self.pid)

    def end_stalled(self) -> None:
        """End it after too long a silence; its end is reported as any other."""
        self._process.send_signal(STALL_SIGNAL)

    def close(self) -> None:
        """End it at once, even during a batch; closing twice is allowed."""
        self._process.kill()
        self._process.wait()
        self._outbox.put(None)

    def _read(self) -> None:
        try:
            while (message := self._pipe.receive()) is not None:
                self._report(SimulatorSaid(self, message))
        except MessageError:  # its memory is damaged
            self._process.kill()
        self._report(SimulatorEnded(self, self._process.wait()))
        self._outbox.put(None)

    def _write(self) -> None:
        while (message := self._outbox.get()) is not None:
            try:
                self._pipe.send(message)
            except OSError:  # it ended; the reading thread reports that
                break
        self._pipe.close()


def crash_reason(code: int, row_seconds: float) -> str | None:
    """The evidence of a simulator's end against its batch; None: it was killed from outside."""
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

MAX_IN_FLIGHT = 2  # Batches at the simulator: the one in work, and one that waits, so that it is never idle
MEMORY_HEADROOM = 1.4  # Memory that a simulator may allocate within a batch, over what it may keep
MAX_LOAD_CRASHES = 3  # A scene that crashed as many simulators while loading is not tried again
MAX_FIRST_DEATHS = 3  # Simulators killed at their start, before any was ready, that end the worker
SIMULATOR_COMMAND = [sys.executable, "-m", "qdgrasp_worker.runtime.simulator_main"]


def simulator_command(evaluator: str | None, device: Device | None = None) -> list[str]:
    """The command of our simulator, or of one with an evaluator FILE.py:NAME or MODULE:NAME.

    An InputError if the name is of another form, or there is no such file, or a device as well.
    """
    if evaluator is None:
        return [*SIMULATOR_COMMAND, *(map(str, device) if device else ())]
    if device:
        raise InputError("A device is for the package's own simulator: leave out --device or --evaluator.")
    where, mark, name = evaluator.rpartition(":")
    if not (mark and where and name):
        raise InputError(f"An evaluator is named FILE.py:NAME or MODULE:NAME, got '{evaluator}'.")
    if where.endswith(".py"):
        if not Path(where).is_file():
            raise InputError(f"There is no file {where} to take the evaluator '{name}' from.")
        where = str(Path(where).resolve())
    return [sys.executable, "-m", "qdgrasp_worker.runtime.custom_evaluator", f"{where}:{name}"]


class NoSimulator(InputError):
    """Simulators end before they have evaluated the probes, or any row; with the reason."""

    def __init__(self, reason: str) -> None:
        super().__init__(f"The simulator does not start: {reason}.")


class OtherPlatform(QdgraspError):
    """The restarted simulator has another platform than the one that this worker joined with."""

    def __init__(self) -> None:
        super().__init__("The package was changed while this worker ran; start it again.")


class SimulatorSupervisor:
    """Evaluates batches in a simulator's process; a context manager that ends it.

    `start` starts a simulator whose events come back to `on_event`. Above `memory` bytes between two batches
    another one is started. `row_seconds` are the CPU seconds of a row, as the simulator was told.
    """

    def __init__(self, start: Callable[[], SimulatorClient], *, row_seconds: float, memory: int) -> None:
        self._start = start
        self._row_seconds = row_seconds
        self._memory = memory
        self._sent: deque[BatchProgress] = deque()  # Batches at the simulator, which works on the first
        self._requeued: deque[BatchProgress] = deque()  # Batches to be sent again, before any other
        self._scenes: set[str] = set()
        self._load_crashes: Counter[str] = Counter()
        self._restarts = RestartPolicy()
        self._silence = 0  # Heartbeats without a message, while the simulator is at work
        self._is_retiring = False
        self._raised = ""  # The error that the simulator raised; empty: none
        self._stats = NO_STATS
        self.restarts = 0
        """Number of simulators that were started after the first."""
        self.platform: dict[str, str] | None = None
        """The platform of its results; None until the first simulator has sent it."""
        self.is_ready = False
        """True if a simulator is there that has evaluated the probes."""
        self.restart_at = inf
        """Time at which the next simulator is to be started; infinite: there is one."""
        self._simulator = start()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._simulator.close()

    @property
    def has_room(self) -> bool:
        """True if another batch may be submitted."""
        return self.is_ready and not self._is_retiring and len(self._sent) < MAX_IN_FLIGHT

    @property
    def head(self) -> BatchProgress | None:
        """The batch that the simulator works on; None: nothing."""
        return self._sent[0] if self._sent else None

    @property
    def next_requeued(self) -> BatchProgress | None:
        """A batch that was begun, and goes on before others: submit it again, or drop it."""
        return self._requeued[0] if self._requeued else None

    def has_scene(self, digest: str) -> bool:
        """Return whether the simulator was given a scene."""
        return digest in self._scenes

    def is_fatal(self, digest: str) -> bool:
        """Return whether a scene crashed too many simulators at loading to be tried again."""
        return self._load_crashes[digest] >= MAX_LOAD_CRASHES

    def submit(self, task: BatchProgress, bundle: bytes | None) -> None:
        """Let the simulator evaluate a batch, with its scene unless it has that."""
        if self.head is None:
            self._silence = 0
        self._simulator.send(task.request(bundle))
        if task is self.next_requeued:
            self._requeued.popleft()
        self._sent.append(task)
        self._scenes.add(task.work.scene)

    def drop(self, task: BatchProgress) -> None:
        """Forget `next_requeued`."""
        self._requeued.remove(task)

    def on_event(self, event: SimulatorEvent, now: float) -> list[BatchProgress]:
        """Take a message or the end of the simulator; those of an older one are ignored.

        Returns the batches that are done, and those that were lost by a kill from outside: of these not all
        rows are known, and they are not at fault. NoSimulator if none can be started here, OtherPlatform
        if this one is of another platform than the one before.
        """
        if event.simulator is not self._simulator or self.restart_at < inf:
            return []
        if isinstance(event, SimulatorSaid):
            return self._on_message(event.message)
        return self._on_end(event, now)

    def _on_message(self, message: AnySimulatorMessage) -> list[BatchProgress]:
        self._silence = 0
        match message:
            case SimulatorReady(platform=platform):
                if self.platform is not None and platform != self.platform:
                    raise OtherPlatform
                self.platform = platform
                self.is_ready = True
            case SimulatorCrashed(reason=reason):
                self._raised = reason
            case PartialResult():
                self._restarts.on_progress()
        if (head := self.head) is None:
            return []
        match message:
            case SceneLoaded():
                head.is_loading = False
            case PartialResult():
                head.add(message)
            case BatchRejected(reason=reason):
                head.fail_all(reason)
            case SceneMissing():
                self._scenes.discard(head.work.scene)
                self._requeued.append(self._sent.popleft())
        if not head.is_done:
            return []
        self._sent.popleft()
        return [head]

    def _pause(self, reason: str | None, now: float) -> float:
        """Seconds before the next simulator; NoSimulator after too many without a row."""
        if reason is not None and self.is_ready:  # this row is known by its end
            self._restarts.on_progress()
            return 0.0
        pause = self._restarts.on_death(now, is_from_outside=reason is None)
        deaths, killed = self._restarts.deaths, "the last was killed, as for want of memory"
        if pause is None or (self.platform is None and deaths >= MAX_FIRST_DEATHS):
            raise NoSimulator(f"{deaths} died without a row; {reason or killed}")
        return pause

    def _on_end(self, event: SimulatorEnded, now: float) -> list[BatchProgress]:
        """Blame the batch in work if there is a reason to; the others go to the next simulator."""
        reason = self._raised or crash_reason(event.code, self._row_seconds)
        if self.platform is None and reason:
            raise NoSimulator(reason)
        log.warning("the simulator ended; another one is started", reason=reason or "it was killed")
        self._forget_simulator(now + self._pause(reason, now))
        sent = list(self._sent)
        self._sent.clear()
        if reason is None:
            return sent
        done = []
        if sent:
            if sent[0].is_loading:
                self._load_crashes[sent[0].work.scene] += 1
            sent[0].on_crash(reason)
            if sent[0].is_done:
                done.append(sent.pop(0))
        self._requeued.extendleft(reversed(sent))
        return done

    def step(self, now: float) -> None:
        """Start the next simulator when it is time, or when this one took too much memory."""
        if now >= self.restart_at:
            self.restart_at, self._silence = inf, 0
            self.restarts += 1
            self._simulator = self._start()
        elif self._is_retiring and self.head is None:
            self._simulator.close()
            self._forget_simulator(now)

    def on_heartbeat(self) -> bool:
        """Look at the simulator, once a second; True if it ran since the last time.

        One that is silent at its work for too long is ended, one with too much memory is replaced.
        """
        before, self._stats = self._stats, self._simulator.stats
        if self._stats.memory > self._memory and not self._is_retiring:
            self._is_retiring = True
            log.warning("the simulator takes too much memory and is replaced", bytes=self._stats.memory)
        if (self.head is not None or not self.is_ready) and not self._stats.is_stopped:
            self._silence += 1
        if self._silence > STALL_FACTOR * (self._row_seconds if self.is_ready else PROBE_SECONDS):
            self._silence = 0
            self._simulator.end_stalled()
        return self._stats.cpu_seconds != before.cpu_seconds

    @property
    def memory(self) -> int:
        """The simulator's memory when it was measured last [bytes]."""
        return self._stats.memory

    def _forget_simulator(self, restart_at: float) -> None:
        self.is_ready = self._is_retiring = False
        self.restart_at = restart_at
        self._raised = ""
        self._silence = 0
        self._scenes.clear()
