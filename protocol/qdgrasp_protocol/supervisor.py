"""Supervisor of child processes: starts, watches, restarts after a pause, and stops them.

Used by the job on one machine, by a command's workers, and, for its restarts, by a worker with its simulator.
A supervisor is a context manager: leaving it ends every process that is still there, by pid. Should this
process itself be killed, each child sees its standard input end and stops by itself (`process.lifetime`).
"""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass, field
from math import inf
from pathlib import Path

from qdgrasp_protocol.errors import EndedEarly, InputError
from qdgrasp_protocol.process import ONE_THREAD, SUPERVISED
from qdgrasp_protocol.session import SECURITY_VARIABLE

GRACE = 2.0  # seconds that a process may take to stop before it is killed
GRACE_MARGIN = 0.5
"""A child is told to stop within the grace less this margin [s], so that it ends before it is killed."""
FIRST_PAUSE, LAST_PAUSE = 0.5, 10.0  # seconds before a dead process is started again
MOST_DEATHS = 5  # Most deaths in a row without progress that are followed by another start
MOST_OUTSIDE_DEATHS = 20  # The same where the last one came from outside: a kill, or an unreachable router
OUTSIDE_CODES = {-signal.SIGKILL, -signal.SIGTERM, 128 + signal.SIGTERM, InputError.exit_code}


@dataclass
class RestartPolicy:
    """Decides when a process that died is started again, if at all. Pure: time is passed in.

    The pause doubles with each death in a row. A row of deaths ends with progress, which its owner notes, or
    with a life of `steady` seconds where nothing else shows progress.
    """

    steady: float = inf
    deaths: int = 0
    """Deaths in a row, without progress."""
    _started: float = inf

    def on_start(self, now: float) -> None:
        """Note that the process was started."""
        self._started = now

    def on_progress(self) -> None:
        """Note that its work got further."""
        self.deaths = 0

    def on_death(self, now: float, *, is_from_outside: bool) -> float | None:
        """Count a death; returns the seconds before the next start, None: there is to be none."""
        if now - self._started >= self.steady:
            self.deaths = 0
        self.deaths += 1
        if self.deaths > (MOST_OUTSIDE_DEATHS if is_from_outside else MOST_DEATHS):
            return None
        return float(min(FIRST_PAUSE * 2 ** (self.deaths - 1), LAST_PAUSE))


@dataclass(frozen=True)
class ProcessExit:
    """A child ended."""

    name: str
    exit_code: int
    """Exit code; negative: the signal that killed it."""
    words: str = ""
    """The error sentence that it ended with, by its log; empty: none."""

    @property
    def description(self) -> str:
        """Description of the end for a person."""
        if self.exit_code < 0:
            return f"was killed by {signal.Signals(-self.exit_code).name}"
        return f"ended with exit code {self.exit_code}"


class DiesAgain(EndedEarly):
    """A process died again and again without progress."""

    def __init__(self, death: ProcessExit, deaths: int) -> None:
        super().__init__(
            f"The {death.name} died {deaths} times while the job got no further; "
            f"the last time it {death.description}. {death.words}".strip()
        )


Arguments = Callable[[], Iterable[str]]
"""Returns the arguments of a process for its next start."""


@dataclass
class ChildProcess:
    """One process of a supervisor."""

    name: str
    module: str
    arguments: Arguments
    log: Path | None
    """Log file; None: this process's standard error."""
    core: int | None
    """Core that it is pinned to; None: any."""
    policy: RestartPolicy
    process: subprocess.Popen[bytes] = field(init=False)
    log_start: int = field(init=False)
    """Byte of the log at which this process began to write."""
    restart_at: float | None = None
    """Time of the next start; infinite: none is planned, None: no death was noted."""

    def start(self, now: float) -> None:
        """Start its process, for the first time or again."""
        self.log_start = self.log.stat().st_size if self.log is not None and self.log.exists() else 0
        command = [sys.executable, "-m", self.module, *self.arguments()]
        self.process = _start(command, self.log, self.core)
        self.policy.on_start(now)
        self.restart_at = None

    @property
    def last_words(self) -> str:
        """The error sentence with which its process ended; empty where it ended without one."""
        if self.log is None:
            return ""
        try:
            said = self.log.read_bytes()[self.log_start :].decode(errors="replace")
        except OSError:
            return ""
        lines = [line for line in said.splitlines() if line.startswith("qdgrasp-") and ": " in line]
        return lines[-1].partition(": ")[2] if lines else ""


class ProcessSupervisor:
    """Child processes by name, each with a log file in `logs`; None: they use our output.

    They may take `grace` seconds to stop. After `steady` seconds of life, deaths count anew.
    """

    def __init__(self, logs: Path | None, grace: float = GRACE, steady: float = inf) -> None:
        self._logs = logs
        self._grace = grace
        self._steady = steady
        self._leave_by: float | None = None
        self._children: dict[str, ChildProcess] = {}

    @property
    def children_grace(self) -> float:
        """Most seconds that a process may be given to stop."""
        return max(0.0, self._grace - GRACE_MARGIN)

    def start(
        self, name: str, module: str, arguments: Iterable[str] | Arguments, core: int | None = None
    ) -> None:
        """Start `python -m module arguments` as the process `name`, on one core or on any.

        A function as arguments is called before each start.
        """
        if self._logs is not None:
            self._logs.mkdir(parents=True, exist_ok=True)
        log = None if self._logs is None else self._logs / f"{name}.log"
        fixed = [] if callable(arguments) else list(arguments)
        function = arguments if callable(arguments) else lambda: fixed
        child = ChildProcess(name, module, function, log, core, RestartPolicy(self._steady))
        child.start(time.monotonic())
        self._children[name] = child

    def exits(self) -> list[ProcessExit]:
        """Return the processes that ended since the last call."""
        found = []
        for child in self._children.values():
            code = child.process.poll()
            if code is not None and child.restart_at is None:
                child.restart_at = inf
                found.append(ProcessExit(child.name, code, child.last_words))
        return found

    def restart_later(self, death: ProcessExit, now: float) -> float:
        """Plan the next start of a process that died; returns the seconds until then.

        DiesAgain if it died too often without progress.
        """
        child = self._children[death.name]
        pause = child.policy.on_death(now, is_from_outside=death.exit_code in OUTSIDE_CODES)
        if pause is None:
            raise DiesAgain(death, child.policy.deaths)
        child.restart_at = now + pause
        return pause

    def restart_due(self, now: float) -> None:
        """Start the processes whose pause is over."""
        for child in self._children.values():
            if child.restart_at is not None and child.restart_at <= now:
                child.start(now)

    def note_progress(self) -> None:
        """Note that the work of all got further: deaths count anew."""
        for child in self._children.values():
            child.policy.on_progress()

    def is_dead(self, name: str) -> bool:
        """True if a process died, and was not started again yet."""
        return name in self._children and self._children[name].restart_at is not None

    def process(self, name: str) -> subprocess.Popen[bytes]:
        """Return the process of this name."""
        return self._children[name].process

    def pids(self) -> dict[str, int]:
        """Return the ids of the running processes by name."""
        return {name: process.pid for name, process in self._running().items()}

    def _running(self) -> dict[str, subprocess.Popen[bytes]]:
        return {c.name: c.process for c in self._children.values() if c.process.poll() is None}

    def request_stop(self, number: int = signal.SIGTERM) -> None:
        """Send every process a signal to stop; the grace begins with the first."""
        if self._leave_by is None:
            self._leave_by = time.monotonic() + self._grace
        for process in self._running().values():
            process.send_signal(number)

    def is_late(self, now: float) -> bool:
        """True once the grace after a request to stop is over."""
        return self._leave_by is not None and now >= self._leave_by

    def __enter__(self) -> "ProcessSupervisor":
        return self

    def __exit__(self, *_: object) -> None:
        if self._leave_by is None:
            self.request_stop()
        for child in self._children.values():
            process = child.process
            try:
                process.wait(max(0.0, (self._leave_by or 0.0) - time.monotonic()))
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()
            if process.stdin is not None:
                process.stdin.close()


def _start(command: list[str], log: Path | None, core: int | None) -> subprocess.Popen[bytes]:
    """Start a process that ends with this one; its own session keeps Ctrl-C from it."""
    environment = {**os.environ, **ONE_THREAD, SUPERVISED: "1"}
    environment.pop(SECURITY_VARIABLE, None)  # children are given the certificate folder by an option
    with nullcontext() if log is None else log.open("ab") as file, _pinned_to(core):
        return subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=file, stderr=file, start_new_session=True, env=environment
        )


@contextmanager
def _pinned_to(core: int | None) -> Iterator[None]:
    """Pin this process to a core while it starts a child, which inherits that."""
    cores = os.sched_getaffinity(0)
    if core is not None:
        os.sched_setaffinity(0, {core})
    try:
        yield
    finally:
        os.sched_setaffinity(0, cores)
