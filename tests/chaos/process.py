"""A process that is started, killed, stopped and started again; it never outlives the one that starts it."""

import ctypes
import os
import signal
import subprocess
import sys
from collections.abc import Sequence
from copy import copy
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
_PR_SET_PDEATHSIG = 1
_LIBC = ctypes.CDLL(None)


class Process:
    """One process after another with the same command.

    Parameters
    ----------
    module
        What is run, as `python -m module`.
    log
        What it says is added here.
    """

    def __init__(
        self, name: str, module: str, arguments: Sequence[object], log: Path, **environment: str
    ) -> None:
        self.name = name
        self.log = log
        self.is_stopped = False
        self._command = [sys.executable, "-m", module, *map(str, arguments)]
        path = os.pathsep.join([str(ROOT), *filter(None, [os.environ.get("PYTHONPATH")])])
        self._environment = {**os.environ, "PYTHONPATH": path, **environment}
        self._process: subprocess.Popen[bytes] | None = None

    @property
    def pid(self) -> int:
        """Of the process that is there, or was last."""
        assert self._process is not None
        return self._process.pid

    @property
    def exit_code(self) -> int | None:
        """How it ended; None while it is there. Negative: the signal that killed it."""
        assert self._process is not None
        return self._process.poll()

    @property
    def is_there(self) -> bool:
        """It was started and has not ended."""
        return self._process is not None and self._process.poll() is None

    def start(self) -> None:
        """Start it, unless it is there; the kernel kills it with the process that calls this."""
        if self.is_there:
            return
        self.is_stopped = False
        self.log.parent.mkdir(parents=True, exist_ok=True)
        with self.log.open("ab") as file:
            self._process = subprocess.Popen(
                self._command,
                stdin=subprocess.DEVNULL,
                stdout=file,
                stderr=file,
                env=self._environment,
                start_new_session=True,
                preexec_fn=_die_with_the_starter,
            )

    def twin(self, log: Path) -> "Process":
        """Another process with the same command, not started yet."""
        twin = copy(self)
        twin.name, twin.log, twin.is_stopped, twin._process = log.stem, log, False, None
        return twin

    def send(self, number: signal.Signals) -> None:
        """Send a signal, if it is there; a process that was killed has ended when this returns."""
        if not self.is_there:
            return
        os.kill(self.pid, number)
        if number in (signal.SIGSTOP, signal.SIGCONT):
            self.is_stopped = number == signal.SIGSTOP
        if number == signal.SIGKILL:
            self.wait()

    def wait(self, patience: float | None = None) -> int:
        """Wait for its end; gives its exit code."""
        assert self._process is not None
        return self._process.wait(patience)

    @property
    def words(self) -> str:
        """All that was said under this name."""
        return self.log.read_text(errors="replace") if self.log.exists() else ""

    @property
    def last_words(self) -> str:
        """The last line that it said."""
        return (self.words.strip().splitlines() or [""])[-1]


def _die_with_the_starter() -> None:
    _LIBC.prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)
