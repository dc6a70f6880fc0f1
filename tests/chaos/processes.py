"""The processes of one job on loopback: started, killed, stopped, started again, and ended."""

import ctypes
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from copy import copy
from pathlib import Path
from types import TracebackType
from typing import Self

from tests.chaos.plan import HEAD
from tests.chaos.simulator import ROW_SECONDS_VARIABLE
from tests.common import PATIENCE, own_endpoint
from tests.system.commands import COORDINATOR, RECORDER, ROUTER, rows_recorded

from qdgrasp_coordinator.scheduler.run_plan import prepare_scene
from qdgrasp_coordinator.storage.run_folder import RunFolder
from qdgrasp_protocol.spec import RunSpec

ROOT = Path(__file__).resolve().parents[2]
_PR_SET_PDEATHSIG = 1
_LIBC = ctypes.CDLL(None)


class Process:
    """Successive processes of one command, `python -m module`; `log` has all their output."""

    def __init__(
        self, name: str, module: str, arguments: Sequence[object], log: Path, **environment: str
    ) -> None:
        self.name = name
        self.log = log
        self.is_stopped = False
        self._command = [sys.executable, "-m", *module.split(), *map(str, arguments)]
        path = os.pathsep.join([str(ROOT), *filter(None, [os.environ.get("PYTHONPATH")])])
        self._environment = {**os.environ, "PYTHONPATH": path, **environment}
        self._process: subprocess.Popen[bytes] | None = None

    @property
    def has_started(self) -> bool:
        """It was started at least once."""
        return self._process is not None

    @property
    def pid(self) -> int:
        """Id of the process that is there, or was last."""
        assert self._process is not None
        return self._process.pid

    @property
    def exit_code(self) -> int | None:
        """Its exit code; None while it is there. Negative: the signal that killed it."""
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
        """The whole log under this name."""
        return self.log.read_text(errors="replace") if self.log.exists() else ""

    @property
    def last_words(self) -> str:
        """The last line that it said."""
        return (self.words.strip().splitlines() or [""])[-1]


def _die_with_the_starter() -> None:
    _LIBC.prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)


JOB = "chaos"


class JobProcesses:
    """A router, a coordinator, a recorder and workers of one run; a context manager that ends them all.

    The run is in `home/run`, their output in `home/logs`. A row takes `row_seconds` seconds at least; the
    options are those of the workers, the environment is that of all.
    """

    def __init__(
        self,
        home: Path,
        spec: RunSpec,
        *,
        workers: int,
        row_seconds: float = 0.0,
        options: Sequence[object] = (),
        **environment: str,
    ) -> None:
        self.home = home
        self.run = home / "run"
        self.endpoint = own_endpoint()
        cache = {"QDGRASP_CACHE": str(home / "cache")}
        self._environment = {ROW_SECONDS_VARIABLE: str(row_seconds), **cache, **environment}
        RunFolder.create(self.run, spec, prepare_scene(spec).bundle, job=JOB)
        there = ["--connect", self.endpoint]
        self._members: dict[str, Process] = {}
        self.add("router", ROUTER, "--listen", self.endpoint)
        self.add("coordinator", COORDINATOR, self.run, *there)
        self.add("recorder", RECORDER, "--job", JOB, "--out", self.run, *there)
        for number in range(workers):
            self.add_worker(f"worker-{number}", self.endpoint, *options)

    def add(self, name: str, module: str, *arguments: object, **environment: str) -> Process:
        """Take another process in; it is not started yet."""
        log = self.home / "logs" / f"{name}.log"
        member = Process(name, module, arguments, log, **self._environment, **environment)
        self._members[name] = member
        return member

    def add_worker(self, name: str, endpoint: str, *options: object, **environment: str) -> Process:
        """Take another worker in that connects there; it is not started yet."""
        there = ["--job", JOB, "--connect", endpoint]
        return self.add(name, "tests.chaos.worker", *there, *options, **environment)

    def another(self, name: str) -> Process:
        """Take another process in with the command of one that is here; it is called `name-2`."""
        twin = self._members[f"{name}-2"] = self._members[name].twin(self.home / "logs" / f"{name}-2.log")
        return twin

    def __getitem__(self, name: str) -> Process:
        return self._members[name]

    def __iter__(self) -> Iterator[Process]:
        return iter(self._members.values())

    @property
    def workers(self) -> list[Process]:
        """All processes but the head."""
        return [member for member in self if member.name not in HEAD]

    @property
    def rows(self) -> int:
        """Number of recorded rows."""
        return rows_recorded(self.run)

    def start(self) -> None:
        """Start the processes that are not there."""
        for member in self:
            member.start()

    def end(self) -> list[str]:
        """Ask all to stop, and kill those that do not; gives their names."""
        for member in self:
            member.send(signal.SIGCONT)
            member.send(signal.SIGTERM)
        deadline = time.monotonic() + PATIENCE
        while any(member.is_there for member in self) and time.monotonic() < deadline:
            time.sleep(0.02)  # between two looks
        late = [member.name for member in self if member.is_there]
        for member in self:
            member.send(signal.SIGKILL)
        return late

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, _kind: type[BaseException] | None, _error: BaseException | None, _trace: TracebackType | None
    ) -> None:
        self.end()
