"""Commands as a user types them, in processes of their own."""

import json
import multiprocessing
import os
import resource
import signal
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Self

import msgspec
from tests.common import PATIENCE, own_endpoint, wait_for

from qdgrasp import entry
from qdgrasp_coordinator.storage.run_folder import RunFolder, journal_digest
from qdgrasp_protocol.errors import FolderError
from qdgrasp_tools.report.run_report import run_summary

COORDINATOR, RECORDER, ROUTER = (
    f"qdgrasp_tools.cli.job_processes {name}" for name in ("coordinator", "recorder", "router")
)
MONITOR = "qdgrasp_tools.cli.job_commands"
WORKER = "qdgrasp_worker.cli"
LOADED = ["qdgrasp_tools.cli.main", MONITOR, "qdgrasp_coordinator.scheduler.run_plan", "trimesh"]
_FORKS = multiprocessing.get_context("forkserver")
_FORKS.set_forkserver_preload(LOADED)


def run(words: Sequence[str], home: Path, environment: dict[str, str], said: Sequence[Path]) -> int:
    """Run a command in a folder; gives its exit code.

    The first word is the function of `qdgrasp.entry`; what it says goes to the two files of `said`.
    """
    process = _FORKS.Process(target=_enter, args=(words, home, environment, said))
    process.start()
    process.join(PATIENCE)
    if process.exitcode is None:
        process.terminate()
        raise TimeoutError(f"{' '.join(words)} takes more than {PATIENCE:.0f} s")
    return process.exitcode


def _enter(words: Sequence[str], home: Path, environment: dict[str, str], said: Sequence[Path]) -> None:
    os.chdir(home)
    os.environ.clear()
    os.environ.update(environment)
    for descriptor, path in enumerate(said, start=1):
        with path.open("wb") as file:
            os.dup2(file.fileno(), descriptor)
    sys.argv = [*words]
    getattr(entry, words[0])()


SMALL = ("--gripper", "panda", "--object", "tennis_ball", "--set", "population=60")
BUDGET = 160
"""Evaluations of a run of which the last are aimed, and that takes long enough to disturb it."""
LONG = (*SMALL, "--evaluations", BUDGET)
LISTENING = ("run", "campaign", "resume", "rerank")
"""Commands that carry out a job and listen for its workers."""


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
    """Runs `qdgrasp` in a folder of its own; a context manager that ends what it started."""

    def __init__(self, home: Path) -> None:
        self.home = home
        self._started: list[subprocess.Popen[str]] = []

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.end_all()

    def __call__(self, *arguments: object, entry: str = "qdgrasp", **environment: str) -> Done:
        """Run one of the commands, named by its function in `qdgrasp.entry`, to its end."""
        with TemporaryDirectory() as folder:
            out, err = said = [Path(folder) / name for name in ("out", "err")]
            words = [entry, *map(str, self._with_port(arguments) if entry == "qdgrasp" else arguments)]
            code = run(words, self.home, self._environment(environment), said)
            return Done(code, out.read_text(), err.read_text())

    def succeed(self, *arguments: object, **how: str) -> Done:
        """Run one of the commands, which is to end well."""
        done = self(*arguments, **how)
        assert done.code == 0, done.err + done.out
        return done

    def start(
        self, *arguments: object, module: str = "qdgrasp", file_size: int | None = None, **environment: str
    ) -> subprocess.Popen[str]:
        """Start a command; no file that it or its processes write may be longer than `file_size`."""
        words = self._with_port(arguments) if module == "qdgrasp" else arguments
        return self.begin("-m", *module.split(), *words, file_size=file_size, **environment)

    def begin(
        self, *words: object, file_size: int | None = None, **environment: str
    ) -> subprocess.Popen[str]:
        """Start Python with these arguments."""
        process = subprocess.Popen(
            [sys.executable, *map(str, words)],
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

    def _with_port(self, arguments: tuple[object, ...]) -> tuple[object, ...]:
        """Have a job listen on a port of its own: others may take the default one while it is restarted."""
        if arguments and arguments[0] in LISTENING and "--listen" not in arguments:
            return (*arguments, "--listen", own_endpoint())
        return arguments

    def _environment(self, more: dict[str, str]) -> dict[str, str]:
        return {**os.environ, "QDGRASP_CACHE": str(self.home / "cache"), **more}

    def digest(self, folder: str | Path) -> str:
        return digest_of(self.home / folder)

    def info(self, folder: str | Path) -> dict:
        """The output of `qdgrasp info --json`, without a process for it."""
        return json.loads(msgspec.json.encode(run_summary(RunFolder.open(self.home / folder))))

    def end_all(self) -> None:
        """End all processes that are still there."""
        for process in self._started:
            if process.poll() is None:
                process.terminate()
                process.communicate(timeout=PATIENCE)


def digest_of(run: Path) -> str:
    """The output of `qdgrasp digest`, without a process for it."""
    with RunFolder.open(run).journal() as journal:
        return journal_digest(journal)


def _limit_files(size: int) -> None:
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, resource.RLIM_INFINITY))


def end_of(process: subprocess.Popen[str], code: int = 0) -> tuple[str, str]:
    """Wait for the end of a command, which is to be this one; gives what it said."""
    out, err = process.communicate(timeout=PATIENCE)
    assert process.returncode == code, err
    return out, err


def stop(process: subprocess.Popen[str], number: int) -> tuple[str, str, float]:
    """Stop a command with all its processes; gives what it said, and the seconds until it ended."""
    started, asked = list(processes_of(process.pid).values()), time.monotonic()
    process.send_signal(number)
    out, err = end_of(process, 128 + number)
    took = time.monotonic() - asked
    assert "Traceback" not in err
    wait_for(lambda: not any(map(is_alive, started)), "the end of its processes")
    return out, err, took


def has_rows(process: subprocess.Popen[str], folder: Path, rows: int) -> None:
    """Wait until a job that goes on has so many rows on disk."""
    wait_for(lambda: rows_recorded(folder) >= rows or process.poll() is not None, f"{rows} rows")
    assert process.poll() is None, process.communicate()


def says(process: subprocess.Popen[str], words: str) -> None:
    """Wait for a line on standard error."""
    assert process.stderr is not None
    while words not in (line := process.stderr.readline()):
        assert line, f"it ended without saying {words!r}"


def rows_recorded(folder: Path) -> int:
    """Number of rows of a run or a campaign on disk; 0 while there is no journal."""
    if (folder / "runs").exists():
        return sum(map(rows_recorded, (folder / "runs").glob("[!.]*")))
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
    """Stop processes for a while, so that others that wait for them do not end."""
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
    """The text of a process in /proc; empty if it is not there, or ends just now."""
    try:
        return Path("/proc", name).read_text()
    except (FileNotFoundError, ProcessLookupError):
        return ""
