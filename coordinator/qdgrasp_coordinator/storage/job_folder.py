"""The folder of a job: name, epoch and files, and the lock of the process that writes in it.

A run of its own is a job of one run: its folder is the job's too. A campaign's folder holds `campaign.toml`
(on a recorder's machine it need not), and below `runs/` a folder for each of its runs.

* `job.json`      the job's name and identity, and the epoch of its last coordinator
* `endpoint`      where the coordinator's router listens, while it does
* `lock`          locked by the recorder; the kernel frees it when that process dies
* `supervised`    locked by the command that started the job's processes
* `logs/`         logs of the job's processes
"""

import fcntl
import os
import secrets
import time
from collections.abc import Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager, suppress
from pathlib import Path
from types import MappingProxyType
from typing import IO

import msgspec

from qdgrasp_coordinator.storage import outputs
from qdgrasp_coordinator.storage.outputs import (
    CAMPAIGN,
    ENDPOINT,
    JOB,
    LOCK,
    LOGS,
    RUNS,
    SUPERVISED,
)
from qdgrasp_protocol.errors import FolderError
from qdgrasp_protocol.keys import Keys, job_name
from qdgrasp_protocol.messages import JobId
from qdgrasp_protocol.process import open_no_link

LOCK_PATIENCE = 1.0  # seconds; a process that checks whether a folder is in use holds its lock for an instant
LOCK_INTERVAL = 0.05  # seconds between two tries


@contextmanager
def hold_lock(folder: Path, name: str = LOCK, patience: float = LOCK_PATIENCE) -> Iterator[None]:
    """Hold the lock `name` of the folder; raise `FolderError` if another process holds it."""
    deadline = time.monotonic() + patience
    with outputs.writing(folder):
        file = open(folder / name, "a+", opener=open_no_link)  # noqa: SIM115  # closed below
    with file:
        while True:
            try:
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
                break
            except BlockingIOError:
                if time.monotonic() > deadline:
                    raise _in_use(folder, file) from None
            time.sleep(LOCK_INTERVAL)  # trying does not wait: sleep between two tries
        with suppress(OSError):  # on a full disk the lock holds all the same; it only has no name
            file.truncate(0)
            file.write(str(os.getpid()))
            file.flush()
        yield


def _in_use(folder: Path, file: IO[str]) -> FolderError:
    file.seek(0)
    pid = file.read().strip()
    return FolderError(f"{folder} is in use{f' by process {pid}' if pid else ''}; wait for it or stop it.")


RUN = "run"  # The name of the run in a job that has only one; its folder is the job's


class JobRecord(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The content of `job.json`."""

    job: str
    epoch: int = 0
    """Epoch of the last coordinator; 0 before the first."""
    identity: JobId = ""
    """Unique id that tells the job from others of its name."""


def new_job(path: Path, name: str | None = None) -> dict[str, bytes]:
    """Return `job.json` of a new folder at `path`.

    Without a name the job is called after the folder. A name that is not of the allowed characters raises
    `ImpossibleValue`.
    """
    name = job_name(path.absolute().name) if name is None else Keys(name).job
    return {JOB: msgspec.json.encode(JobRecord(name, identity=secrets.token_hex(16)))}


class JobFolder:
    """The existing folder of a job."""

    def __init__(self, path: Path) -> None:
        self.path = path

    @classmethod
    def open(cls, path: Path) -> "JobFolder":
        """Return the folder of a job that was begun; raise `FolderError` without one."""
        outputs.check_folder(path)
        if not cls.is_job(path):
            raise FolderError(f"{path} holds no run and no campaign: there is no {JOB} in it.")
        return cls(path)

    @classmethod
    def create(cls, path: Path, name: str, files: Mapping[str, bytes] = MappingProxyType({})) -> "JobFolder":
        """Begin a campaign's folder with these files beside its own; it appears whole or not at all.

        Raises `FolderError` or `DiskFull` where the folder holds other files, or cannot be made.
        """
        outputs.create_folder(path, new_job(path, name) | dict(files), folders=[LOGS, RUNS])
        return cls(path)

    @staticmethod
    def is_job(path: Path) -> bool:
        """Return whether a job was begun in this folder."""
        return outputs.is_file(path / JOB)

    def check_there(self) -> None:
        """Raise `FolderError` if the folder of a job that goes on is not there any more."""
        if not self.is_job(self.path):
            raise FolderError(
                f"{self.path} was deleted or moved while its job ran: put it back and give the command again "
                "that goes on with it, or begin anew."
            )

    def no_coordinator(self) -> FolderError:
        """Return the error that no coordinator of the job is there now."""
        return FolderError(
            f"No coordinator of {self.path} is there now; `{self.resume_command}` goes on with a job that is "
            f"not finished, and `qdgrasp info {self.path}` says how far it is."
        )

    @property
    def is_campaign(self) -> bool:
        """True if its runs have folders of their own; a recorder elsewhere has no campaign file."""
        return (self.path / CAMPAIGN).is_file() or (self.path / RUNS).is_dir()

    @property
    def resume_command(self) -> str:
        """The command that goes on with the job."""
        return f"qdgrasp {'campaign' if self.is_campaign else 'resume'} {self.path}"

    def run_path(self, run: str) -> Path:
        """Return the path of a run's folder, which need not exist yet."""
        return self.path if run == RUN else self.path / RUNS / run

    @property
    def run_paths(self) -> list[Path]:
        """The folders of all its runs that are there."""
        if not self.is_campaign:
            return [self.path]
        return sorted(path for path in (self.path / RUNS).glob("[!.]*") if path.is_dir())

    @property
    def name(self) -> str:
        """The job's name on the bus."""
        return self._job.job

    @property
    def epoch(self) -> int:
        """The epoch of the job's last coordinator; 0 before the first."""
        return self._job.epoch

    @property
    def identity(self) -> str:
        """Unique id that tells the job from others of its name."""
        return self._job.identity

    def set_epoch(self, epoch: int) -> None:
        """Store an epoch; it is on the disk when this returns."""
        record = JobRecord(self.name, epoch, self.identity)
        outputs.replace(self.path / JOB, msgspec.json.encode(record))

    @property
    def endpoint(self) -> str | None:
        """Address on which the coordinator's router listens; None: it is not known."""
        with suppress(OSError, UnicodeDecodeError):
            return (self.path / ENDPOINT).read_text().strip() or None
        return None

    def write_endpoint(self, endpoint: str) -> None:
        """Note where the router listens."""
        outputs.replace(self.path / ENDPOINT, f"{endpoint}\n".encode())

    def forget_endpoint(self) -> None:
        """Note that no router listens; a disk that died keeps what is on it."""
        with suppress(OSError):
            (self.path / ENDPOINT).unlink()

    @property
    def logs(self) -> Path:
        """The folder of the processes' logs."""
        return self.path / LOGS

    def lock(self) -> AbstractContextManager[None]:
        """Lock the folder as the only process that writes its journals; see `hold_lock`."""
        return hold_lock(self.path)

    def supervise(self) -> AbstractContextManager[None]:
        """Lock the folder as the only command that starts processes for it; see `hold_lock`."""
        return hold_lock(self.path, SUPERVISED)

    def check_not_in_use(self) -> None:
        """Raise `FolderError` if a process writes in this folder."""
        for name in (SUPERVISED, LOCK):
            with hold_lock(self.path, name, patience=0.0):
                pass

    @property
    def _job(self) -> JobRecord:
        try:
            return msgspec.json.decode(outputs.read(self.path / JOB), type=JobRecord)
        except (ValueError, RecursionError) as error:  # ValueError: msgspec's too, and text that is not UTF-8
            raise outputs.damaged_file(self.path / JOB, str(error)) from None
