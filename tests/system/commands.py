"""Commands as a user types them, in processes of their own."""

import json
import os
import resource
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TypeVar

import msgspec
from tests.patience import PATIENCE
from tests.system import forked

from qdgrasp_coordinator.campaigns.summary import summary
from qdgrasp_coordinator.folders.digest import digest
from qdgrasp_coordinator.folders.folder import RunFolder
from qdgrasp_protocol.errors import FolderError

Found = TypeVar("Found")
SMALL = ("--gripper", "panda", "--object", "tennis_ball", "--population", "60")
BUDGET = 160
"""Evaluations of a run of which the last are aimed, and that takes long enough to disturb it."""
LONG = (*SMALL, "--evaluations", BUDGET)


@dataclass(frozen=True)
class Done:
    """A command that ended."""

    code: int
    out: str
    err: str

    @property
    def json(self) -> dict:
        return json.loads(self.out)


class Commands:
    """Runs `qdgrasp` in a folder of its own."""

    def __init__(self, home: Path) -> None:
        self.home = home
        self._started: list[subprocess.Popen[str]] = []

    def __call__(self, *arguments: object, entry: str = "qdgrasp", **environment: str) -> Done:
        """Run one of the commands, named by its function in `qdgrasp.entry`, to its end."""
        with TemporaryDirectory() as folder:
            out, err = said = [Path(folder) / name for name in ("out", "err")]
            words = [entry, *map(str, arguments)]
            code = forked.run(words, self.home, self._environment(environment), said)
            return Done(code, out.read_text(), err.read_text())

    def start(
        self, *arguments: object, module: str = "qdgrasp", file_size: int | None = None, **environment: str
    ) -> subprocess.Popen[str]:
        """Start a command; no file that it or its processes write may be longer than `file_size`."""
        command = [sys.executable, "-m", module, *map(str, arguments)]
        process = subprocess.Popen(
            command,
            cwd=self.home,
            env=self._environment(environment),
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            preexec_fn=None if file_size is None else lambda: _limit_files(file_size),
        )
        self._started.append(process)
        return process

    def _environment(self, more: dict[str, str]) -> dict[str, str]:
        return {**os.environ, "QDGRASP_CACHE": str(self.home / "cache"), **more}

    def digest(self, folder: str | Path) -> str:
        """What `qdgrasp digest` prints, without a process for it."""
        with RunFolder.open(self.home / folder).journal() as journal:
            return digest(journal)

    def info(self, folder: str | Path) -> dict:
        """What `qdgrasp info --json` prints, without a process for it."""
        return json.loads(msgspec.json.encode(summary(RunFolder.open(self.home / folder))))

    def end_all(self) -> None:
        for process in self._started:
            if process.poll() is None:
                process.terminate()
                process.communicate(timeout=PATIENCE)


def _limit_files(size: int) -> None:
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, resource.RLIM_INFINITY))


def wait_for(look: Callable[[], Found], what: str) -> Found:
    """Look again and again until something is found, and give it; the test fails when it takes too long."""
    deadline = time.monotonic() + PATIENCE
    while not (found := look()):
        assert time.monotonic() < deadline, f"waited in vain for {what}"
        time.sleep(0.02)  # between two looks; nothing depends on how long it is
    return found


def says(process: subprocess.Popen[str], words: str) -> None:
    """Wait for a line on standard error."""
    assert process.stderr is not None
    while words not in (line := process.stderr.readline()):
        assert line, f"it ended without saying {words!r}"


def rows_recorded(folder: Path) -> int:
    """How many rows are on disk; 0 while there is no journal."""
    if not (folder / "run.sqlite").exists():
        return 0
    try:
        with RunFolder.open(folder).journal() as journal:
            return journal.count
    except FolderError:  # its tables are being made
        return 0


def processes_of(starter: int) -> dict[str, int]:
    """The processes that a command started: their names and pids."""
    found = {}
    for number, pid in enumerate(_told(f"{starter}/task/{starter}/children").split()):
        title = _told(f"{pid}/cmdline").partition("\0")[0].split()
        found[f"{title[0]}-{number}" if title else str(number)] = int(pid)
    return found


def pids(process: subprocess.Popen[str], role: str) -> list[int]:
    """The processes of a role that a command started, as far as they have taken their names."""
    return [pid for name, pid in processes_of(process.pid).items() if name.startswith(f"qdgrasp-{role}")]


def kill(pid: int) -> None:
    os.kill(pid, signal.SIGKILL)


@contextmanager
def held(*stopped: int) -> Iterator[None]:
    """Processes that stand still meanwhile, so that what waits for them does not come to its end."""
    for pid in stopped:
        os.kill(pid, signal.SIGSTOP)
    try:
        yield
    finally:
        for pid in filter(is_alive, stopped):
            os.kill(pid, signal.SIGCONT)


def is_alive(pid: int) -> bool:
    """A process is there and not a zombie."""
    told = _told(f"{pid}/stat")
    return bool(told) and told.rsplit(")", 1)[1].split()[0] != "Z"


def _told(name: str) -> str:
    """What /proc tells of a process; nothing if it is not there, or goes just now."""
    try:
        return Path("/proc", name).read_text()
    except (FileNotFoundError, ProcessLookupError):
        return ""
