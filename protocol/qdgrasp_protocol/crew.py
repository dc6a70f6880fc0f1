"""The processes that a command starts and watches together.

A crew is a context manager: leaving it ends every process that is still there, by pid. Should the command
itself be killed, each member sees its standard input end and stops by itself (`lifetime`).
"""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import IO

from qdgrasp_protocol.credentials import VARIABLE
from qdgrasp_protocol.lifetime import SUPERVISED

GRACE = 2.0  # seconds that a process may take to stop before it is killed
MARGIN = 0.5  # of them, those that it is not told of, so that it is not killed while it stops
BACK_OFF_FIRST, BACK_OFF_LAST = 0.5, 10.0  # seconds before a dead member is started again
ONE_THREAD = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
"""Each process works on one core."""
STEADY = 5.0  # seconds of life after which the next death starts from the first back-off again


@dataclass
class Member:
    """One process of a crew."""

    name: str
    arguments: list[str]
    log: Path | None
    """Where it speaks; None: where this process does."""
    process: subprocess.Popen[bytes]
    started: float
    restarts: int = 0
    restart_at: float | None = None
    log_start: int = 0
    """Where in the log this process began to write."""
    core: int | None = None
    """The core that it is kept on; None: any."""


@dataclass(frozen=True)
class Death:
    """A member of the crew ended."""

    name: str
    exit_code: int
    """Negative: the signal that killed it."""

    @property
    def words(self) -> str:
        """How it ended, for a person."""
        if self.exit_code < 0:
            return f"was killed by {signal.Signals(-self.exit_code).name}"
        return f"ended with exit code {self.exit_code}"


def back_off(restarts: int) -> float:
    """Seconds to wait before the next start of a member that was restarted `restarts` times in a row."""
    return float(min(BACK_OFF_FIRST * 2**restarts, BACK_OFF_LAST))


class Crew:
    """Processes by name.

    Parameters
    ----------
    logs
        Where each has a log file; None: they speak where this process does.
    grace
        Seconds that they may take to stop.
    """

    def __init__(self, logs: Path | None, grace: float = GRACE) -> None:
        self._logs = logs
        self._grace = grace
        self._leave_by: float | None = None
        self._members: dict[str, Member] = {}

    @property
    def members_grace(self) -> float:
        """Seconds that a member may be told to take at most."""
        return max(0.0, self._grace - MARGIN)

    def hire(self, name: str, module: str, arguments: Iterable[str], core: int | None = None) -> None:
        """Start `python -m module arguments` as the member `name`, on one core or on any."""
        command = [sys.executable, "-m", module, *arguments]
        log = self._log(name)
        began = log.stat().st_size if log is not None and log.exists() else 0
        started = time.monotonic()
        self._members[name] = Member(
            name, command, log, _start(command, log, core), started, log_start=began, core=core
        )

    def deaths(self) -> list[Death]:
        """The members that ended since the last look, and are not to be started again yet."""
        found = []
        for member in self._members.values():
            code = member.process.poll()
            if code is not None and member.restart_at is None:
                member.restart_at = float("inf")
                found.append(Death(member.name, code))
        return found

    def restart_later(self, name: str, now: float) -> float:
        """Start a dead member again after its back-off; returns the seconds until then."""
        member = self._members[name]
        if now - member.started > STEADY:
            member.restarts = 0
        pause = back_off(member.restarts)
        member.restarts += 1
        member.restart_at = now + pause
        return pause

    def restart_due(self, now: float) -> None:
        """Start the dead members whose back-off is over."""
        for member in self._members.values():
            if member.restart_at is not None and member.restart_at <= now:
                member.process, member.started = _start(member.arguments, member.log, member.core), now
                member.restart_at = None

    def last_words(self, name: str) -> str:
        """The sentence with which a member ended; empty where it ended without one."""
        member = self._members[name]
        if member.log is None:
            return ""
        try:
            said = member.log.read_bytes()[member.log_start :].decode(errors="replace")
        except OSError:
            return ""
        mark = "qdgrasp-"
        lines = [line for line in said.splitlines() if line.startswith(mark) and ": " in line]
        return lines[-1].partition(": ")[2] if lines else ""

    def process(self, name: str) -> subprocess.Popen[bytes]:
        """The process of a member."""
        return self._members[name].process

    def pids(self) -> dict[str, int]:
        """The process ids of the members that live."""
        return {m.name: m.process.pid for m in self._members.values() if m.process.poll() is None}

    def _alive(self) -> list[subprocess.Popen[bytes]]:
        return [member.process for member in self._members.values() if member.process.poll() is None]

    def bid_leave(self, number: int = signal.SIGTERM) -> None:
        """Ask every member to stop, by a signal; the grace begins."""
        self._leave_by = time.monotonic() + self._grace
        for process in self._alive():
            process.send_signal(number)

    def dismiss(self, number: int = signal.SIGTERM) -> None:
        """End every member: politely, by a signal, then, after the grace, by force."""
        if self._leave_by is None:
            self.bid_leave(number)
        for process in self._alive():
            try:
                process.wait(max(0.0, (self._leave_by or 0.0) - time.monotonic()))
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()
        for member in self._members.values():
            _close(member.process.stdin)

    def __enter__(self) -> "Crew":
        return self

    def __exit__(
        self, _kind: type[BaseException] | None, _error: BaseException | None, _trace: TracebackType | None
    ) -> None:
        self.dismiss()

    def _log(self, name: str) -> Path | None:
        if self._logs is None:
            return None
        self._logs.mkdir(parents=True, exist_ok=True)
        return self._logs / f"{name}.log"


def _start(command: list[str], log: Path | None, core: int | None) -> subprocess.Popen[bytes]:
    """Start a process that lives only as long as we do, in a session of its own, so that Ctrl-C is ours."""
    with nullcontext() if log is None else log.open("ab") as file, _on(core):
        return subprocess.Popen(
            command,
            stdin=subprocess.PIPE,
            stdout=file,
            stderr=file,
            start_new_session=True,
            env=_environment(),
        )


def _environment() -> dict[str, str]:
    """Ours, but for certificates: they go with an endpoint, and we say for each whether it is encrypted."""
    ours = {name: value for name, value in os.environ.items() if name != VARIABLE}
    return {**ours, **ONE_THREAD, SUPERVISED: "1"}


def _close(pipe: IO[bytes] | None) -> None:
    if pipe is not None:
        pipe.close()


@contextmanager
def _on(core: int | None) -> Iterator[None]:
    """Keep this process on a core while it starts another, which stays there."""
    cores = os.sched_getaffinity(0)
    if core is not None:
        os.sched_setaffinity(0, {core})
    try:
        yield
    finally:
        os.sched_setaffinity(0, cores)
