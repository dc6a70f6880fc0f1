"""The folder of a job: whose it is, and who may write in it.

A run of its own is a job of one run: its folder is the job's too. A campaign's folder holds `campaign.toml`
(on a recorder's machine it need not), and below `runs/` a folder for each of its runs.

* `job.json`      the job's name and identity, and the epoch of its last coordinator
* `endpoint`      where the coordinator's router listens, while it does
* `lock`          locked by the recorder; the kernel frees it when that process dies
* `supervised`    locked by the command that started the job's processes
* `logs/`         what the job's processes said
"""

import secrets
from collections.abc import Mapping
from contextlib import AbstractContextManager
from pathlib import Path
from types import MappingProxyType

import msgspec

from qdgrasp_coordinator.folders import disk, lock
from qdgrasp_coordinator.folders.names import CAMPAIGN, ENDPOINT, JOB, LOGS, RUNS, SUPERVISED
from qdgrasp_coordinator.folders.outputs import OutFolder
from qdgrasp_protocol.errors import FolderError
from qdgrasp_protocol.keys import Keys, job_name
from qdgrasp_protocol.messages import JobId

RUN = "run"
"""The name of the run in a job that has only one; its folder is the job's."""


class Job(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """What `job.json` holds."""

    job: str
    epoch: int = 0
    """Of the last coordinator; 0 before the first."""
    identity: JobId = ""
    """What no other job has; empty in a folder of an earlier version, until its next coordinator's turn."""

    @classmethod
    def begun(cls, path: Path, name: str | None = None) -> "Job":
        """The job of a new folder at `path`; without a name it is called after the folder.

        Raises
        ------
        ImpossibleValue
            The name is not of the allowed characters.
        """
        name = job_name(path.absolute().name) if name is None else Keys(name).job
        return cls(name, identity=secrets.token_hex(16))

    def in_turn(self, epoch: int) -> "Job":
        """The same job in a coordinator's turn."""
        return Job(self.job, epoch, self.identity or secrets.token_hex(16))

    @property
    def file(self) -> dict[str, bytes]:
        """The file that says so, for a new folder."""
        return {JOB: msgspec.json.encode(self)}


class JobFolder:
    """A job's folder, that exists."""

    def __init__(self, path: Path) -> None:
        self.path = path

    @classmethod
    def open(cls, path: Path) -> "JobFolder":
        """The folder of a job that was begun.

        Raises
        ------
        NoFolder, FolderError
            There is no such folder, or no job in it.
        """
        disk.check_folder(path)
        if not cls.is_job(path):
            raise FolderError(f"{path} holds no run and no campaign: there is no {JOB} in it.")
        return cls(path)

    @classmethod
    def create(cls, path: Path, name: str, files: Mapping[str, bytes] = MappingProxyType({})) -> "JobFolder":
        """Begin the folder of a campaign, with these files beside its own; it appears whole or not at all.

        Raises
        ------
        FolderError, DiskFull
            The folder holds other files, or cannot be made.
        """
        OutFolder(path).check()
        disk.create(path, Job.begun(path, name).file | dict(files), folders=[LOGS, RUNS])
        return cls(path)

    @staticmethod
    def is_job(path: Path) -> bool:
        """Whether a job was begun in this folder."""
        return disk.is_file(path / JOB)

    @property
    def is_campaign(self) -> bool:
        """Whether its runs have folders of their own; a recorder elsewhere has no campaign file."""
        return (self.path / CAMPAIGN).is_file() or (self.path / RUNS).is_dir()

    @property
    def resume_command(self) -> str:
        """What goes on with the job."""
        return f"qdgrasp {'campaign' if self.is_campaign else 'resume'} {self.path}"

    def run_path(self, run: str) -> Path:
        """Where the folder of a run is, or is to be."""
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
        """What tells the job from others of its name; empty: not known yet."""
        return self._job.identity

    def set_epoch(self, epoch: int) -> None:
        """Store an epoch; it is on the disk when this returns."""
        disk.replace(self.path / JOB, msgspec.json.encode(self._job.in_turn(epoch)))

    @property
    def endpoint(self) -> str | None:
        """Where the coordinator's router listens; None: nowhere that is known."""
        file = self.path / ENDPOINT
        return file.read_text().strip() or None if file.is_file() else None

    def write_endpoint(self, endpoint: str) -> None:
        """Note where the router listens."""
        disk.replace(self.path / ENDPOINT, f"{endpoint}\n".encode())

    def forget_endpoint(self) -> None:
        """Note that no router listens."""
        (self.path / ENDPOINT).unlink(missing_ok=True)

    @property
    def logs(self) -> Path:
        """The folder of the processes' logs."""
        return self.path / LOGS

    def lock(self) -> AbstractContextManager[None]:
        """Be the only process that writes the journals in this folder; see `lock.exclusive`."""
        return lock.exclusive(self.path)

    def supervise(self) -> AbstractContextManager[None]:
        """Be the only command that starts processes for this folder; see `lock.exclusive`."""
        return lock.exclusive(self.path, SUPERVISED)

    def check_not_in_use(self) -> None:
        """Check that no process writes in this folder.

        Raises
        ------
        FolderError
            One does.
        """
        lock.check_free(self.path, SUPERVISED)
        lock.check_free(self.path)

    @property
    def _job(self) -> Job:
        try:
            return msgspec.json.decode(disk.read(self.path / JOB), type=Job)
        except msgspec.MsgspecError as error:
            raise disk.damaged(self.path / JOB, str(error)) from None
