"""Commands as a user types them, in processes of their own."""

import json
import os
import resource
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import msgspec
from tests.patience import PATIENCE

from qdgrasp_coordinator.campaigns.summary import summary
from qdgrasp_coordinator.folders.digest import digest
from qdgrasp_coordinator.folders.folder import RunFolder
from qdgrasp_protocol.errors import FolderError

SMALL = ("--gripper", "panda", "--object", "tennis_ball", "--population", "60")
LONG = (*SMALL, "--evaluations", "320")


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

    def __call__(self, *arguments: object, **environment: str) -> Done:
        process = self.start(*arguments, **environment)
        out, err = process.communicate(timeout=PATIENCE)
        return Done(process.returncode, out, err)

    def start(
        self, *arguments: object, module: str = "qdgrasp", file_size: int | None = None, **environment: str
    ) -> subprocess.Popen[str]:
        """Start a command; no file that it or its processes write may be longer than `file_size`."""
        command = [sys.executable, "-m", module, *map(str, arguments)]
        process = subprocess.Popen(
            command,
            cwd=self.home,
            env={**os.environ, "QDGRASP_CACHE": str(self.home / "cache"), **environment},
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            preexec_fn=None if file_size is None else lambda: _limit_files(file_size),
        )
        self._started.append(process)
        return process

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


def wait_for(condition: Callable[[], bool], what: str) -> None:
    """Look again and again until something holds; the test fails when it takes too long."""
    deadline = time.monotonic() + PATIENCE
    while not condition():
        assert time.monotonic() < deadline, f"waited in vain for {what}"
        time.sleep(0.02)  # between two looks; nothing depends on how long it is


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
    children = Path(f"/proc/{starter}/task/{starter}/children")
    if not children.exists():
        return {}
    found = {}
    for number, pid in enumerate(children.read_text().split()):
        title = Path(f"/proc/{pid}/cmdline").read_bytes().split(b"\0")[0].decode()
        found[f"{title.split()[0]}-{number}" if title else str(number)] = int(pid)
    return found


def kill(pid: int) -> None:
    os.kill(pid, signal.SIGKILL)


def is_alive(pid: int) -> bool:
    """A process is there and not a zombie."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()[0] != "Z"
    except FileNotFoundError:
        return False
