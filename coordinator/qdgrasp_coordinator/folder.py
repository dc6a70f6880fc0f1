"""The folder of a run: what it holds, how it is begun, and who may write in it.

* `spec.toml`     the full spec: `qdgrasp run DIR/spec.toml --out OTHER` repeats the run
* `scene.bundle`  the scene, as workers fetch it
* `run.sqlite`    the journal, once a recorder has opened it
* `job.json`      the job's name, and the epoch of its last coordinator
* `endpoint`      where the coordinator's router listens, while it does
* `lock`          locked by the recorder; the kernel frees it when that process dies
* `supervised`    locked by the command that started the run's processes
* `logs/`         what the run's processes said
"""

import hashlib
import os
import shutil
from contextlib import AbstractContextManager
from pathlib import Path

import msgspec

from qdgrasp_assets.scene import Bundle, Scene, unpack_scene
from qdgrasp_coordinator import disk, journal_format, lock
from qdgrasp_coordinator.journal import Journal
from qdgrasp_coordinator.journal_format import Identity
from qdgrasp_protocol.errors import FolderError, MessageError
from qdgrasp_protocol.keys import job_name
from qdgrasp_protocol.rows import Shape
from qdgrasp_protocol.spec import RunSpec, read_run_spec, run_spec, to_toml

SPEC, SCENE, JOB, ENDPOINT, LOGS = "spec.toml", "scene.bundle", "job.json", "endpoint", "logs"
SUPERVISED = "supervised"


class Job(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """What `job.json` holds."""

    job: str
    epoch: int
    """Of the last coordinator; 0 before the first."""


class RunFolder:
    """A run's folder; made by `create` or `open`."""

    def __init__(self, path: Path) -> None:
        self.path = path

    @classmethod
    def create(
        cls, path: Path, spec: RunSpec, bundle: Bundle | None, *, job: str | None = None
    ) -> "RunFolder":
        """Begin a run's folder; it appears whole or not at all.

        Parameters
        ----------
        bundle
            The scene; None: it is added later (`add_bundle`).
        job
            The job's name; None: the folder's name, reduced to the allowed characters.

        Raises
        ------
        FolderError
            The folder holds another run or other files, or cannot be made.
        """
        cls.check_free(path)
        whole = path.absolute()
        part = whole.with_name(f".{whole.name}.{os.getpid()}.part")
        try:
            with disk.writing(path):
                part.mkdir(parents=True)
                disk.write(part / SPEC, to_toml(spec).encode())
                disk.write(part / JOB, msgspec.json.encode(Job(job or job_name(whole.name), 0)))
                if bundle is not None:
                    disk.write(part / SCENE, bundle.payload)
                (part / LOGS).mkdir()
                part.rename(path)  # replaces an empty folder, and nothing else
                disk.sync(whole.parent)
        finally:
            shutil.rmtree(part, ignore_errors=True)
        return cls(path)

    @classmethod
    def open(cls, path: Path) -> "RunFolder":
        """The folder of a run that was begun.

        Raises
        ------
        FolderError
            There is no such folder, or no run in it.
        """
        if not path.is_dir():
            raise FolderError(
                f"There is no folder {path}; `qdgrasp run --out {path}` would begin a run there."
            )
        if not cls.is_run(path):
            raise FolderError(
                f"{path} holds no run: there is no {JOB} and {SPEC} in it; name a run's folder."
            )
        return cls(path)

    @staticmethod
    def is_run(path: Path) -> bool:
        """Whether a run was begun in this folder."""
        return (path / JOB).is_file() and (path / SPEC).is_file()

    @staticmethod
    def check_free(path: Path) -> None:
        """Check that a run can be begun at `path`: nothing is there, or an empty folder.

        Raises
        ------
        FolderError
            Something is there.
        """
        if RunFolder.is_run(path):
            raise FolderError(
                f"{path} holds a run already: `qdgrasp resume {path}` goes on with it; "
                "for a new run name another folder with --out."
            )
        if path.exists() and not path.is_dir():
            raise FolderError(f"{path} is a file; name a folder with --out.")
        names = sorted(entry.name for entry in path.iterdir()) if path.exists() else []
        if names:
            some = ", ".join(names[:3]) + (" ..." if len(names) > 3 else "")
            raise FolderError(f"{path} holds other files ({some}); name a new or empty folder with --out.")

    @property
    def spec(self) -> RunSpec:
        """The full spec."""
        return run_spec(read_run_spec(self.path / SPEC), str(self.path / SPEC))

    def rewrite_spec(self, spec: RunSpec) -> None:
        """Replace the spec."""
        self._write(SPEC, to_toml(spec).encode())

    @property
    def job(self) -> str:
        """The job's name on the bus."""
        return self._job.job

    @property
    def epoch(self) -> int:
        """The epoch of the job's last coordinator; 0 before the first."""
        return self._job.epoch

    def set_epoch(self, epoch: int) -> None:
        """Store an epoch; it is on the disk when this returns."""
        self._write(JOB, msgspec.json.encode(Job(self.job, epoch)))

    def bundle(self) -> Bundle:
        """The scene as bytes, with its digest."""
        payload = self._read(SCENE)
        return Bundle(payload, hashlib.sha256(payload).hexdigest())

    def has_bundle(self) -> bool:
        """Whether the scene is here; a recorder on another machine begins without."""
        return (self.path / SCENE).is_file()

    def add_bundle(self, payload: bytes) -> None:
        """Store the scene."""
        self._write(SCENE, payload)

    def scene(self) -> Scene:
        """The scene.

        Raises
        ------
        FolderError
            It is missing or damaged.
        """
        try:
            return unpack_scene(self._read(SCENE))
        except MessageError as error:
            raise FolderError(
                f"{self.path / SCENE} cannot be read: {error}; "
                "use the version of qdgrasp that wrote it, or restore the file from a copy."
            ) from None

    def journal(self) -> Journal:
        """The journal as it is now, for a with-block; empty before a recorder opened the run."""
        if (self.path / journal_format.FILE).exists():
            return Journal.open(self.path)
        scene = self.bundle().digest if self.has_bundle() else ""
        return Journal.empty(Identity("run", to_toml(self.spec), scene, Shape(0, 0)))

    @property
    def endpoint(self) -> str | None:
        """Where the coordinator's router listens; None: nowhere that is known."""
        file = self.path / ENDPOINT
        return file.read_text().strip() or None if file.is_file() else None

    def write_endpoint(self, endpoint: str) -> None:
        """Note where the router listens."""
        self._write(ENDPOINT, f"{endpoint}\n".encode())

    def forget_endpoint(self) -> None:
        """Note that no router listens."""
        (self.path / ENDPOINT).unlink(missing_ok=True)

    @property
    def logs(self) -> Path:
        """The folder of the processes' logs."""
        return self.path / LOGS

    def lock(self) -> AbstractContextManager[None]:
        """Be the only process that writes the journal in this folder; see `lock.exclusive`."""
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
            return msgspec.json.decode(self._read(JOB), type=Job)
        except msgspec.MsgspecError as error:
            raise disk.damaged(self.path / JOB, str(error)) from None

    def _read(self, name: str) -> bytes:
        try:
            return (self.path / name).read_bytes()
        except OSError as error:
            raise FolderError(f"{self.path / name} cannot be read: {disk.reason(error)}.") from None

    def _write(self, name: str, payload: bytes) -> None:
        with disk.writing(self.path):
            disk.write(self.path / name, payload)
