"""The folder of a run: what it holds, and how it is begun.

* `spec.toml`     the full spec: `qdgrasp run DIR/spec.toml --out OTHER` repeats the run
* `scene.bundle`  the scene, as workers fetch it
* `run.sqlite`    the journal, once a recorder has opened it

Beside them are the files of its job (`job_folder`), unless it is one of a campaign's.
"""

import hashlib
from collections.abc import Iterable
from pathlib import Path

from qdgrasp_assets.scene import Bundle, Scene, unpack_scene
from qdgrasp_coordinator.folders import disk
from qdgrasp_coordinator.folders.job_folder import RUN, Job, JobFolder
from qdgrasp_coordinator.folders.journal import Journal
from qdgrasp_coordinator.folders.journal_format import Identity
from qdgrasp_coordinator.folders.names import JOB, JOURNAL, LOGS, RUNS, SCENE, SPEC
from qdgrasp_coordinator.folders.outputs import OutFolder
from qdgrasp_protocol import codec
from qdgrasp_protocol.errors import FolderError, MessageError, OtherRun
from qdgrasp_protocol.phrases import few
from qdgrasp_protocol.rows import Shape
from qdgrasp_protocol.spec import RunSpec, differences, read_run_spec, run_spec, to_toml

SHOWN, LONGEST = 3, 40
"""Keys, and characters of a value, that are told where two files are of different runs."""


class RunFolder:
    """A run's folder; made by `create`, `add` or `open`."""

    def __init__(self, path: Path) -> None:
        self.path = path

    @classmethod
    def create(
        cls, path: Path, spec: RunSpec, bundle: Bundle | None, *, job: str | None = None
    ) -> "RunFolder":
        """Begin the folder of a run that is a job of its own; it appears whole or not at all.

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
        disk.create(path, Job.begun(path, job).file | files(spec, bundle), folders=[LOGS])
        return cls(path)

    @classmethod
    def add(cls, job: JobFolder, run: str, spec: RunSpec, bundle: Bundle | None) -> "RunFolder":
        """Begin the folder of one of a campaign's runs; raises as `create`."""
        path = job.run_path(run)
        OutFolder(path).check()
        disk.create(path, files(spec, bundle))
        return cls(path)

    @classmethod
    def open(cls, path: Path) -> "RunFolder":
        """The folder of a run that was begun.

        Raises
        ------
        NoFolder, FolderError
            There is no such folder, or no run in it.
        """
        disk.check_folder(path)
        if not cls.is_run(path):
            raise FolderError(_no_run(path))
        return cls(path)

    @staticmethod
    def is_run(path: Path) -> bool:
        """Whether a run was begun in this folder."""
        return disk.is_file(path / SPEC) and JobFolder.is_job(_job_path(path))

    @staticmethod
    def check_free(path: Path) -> None:
        """Check that a run of its own can be begun at `path`: nothing is there, or an empty folder.

        Raises
        ------
        FolderError
            Something is there, or on the way to it, or it is among the runs of a campaign or in another run.
        """
        OutFolder(path, force=True, is_kind=RunFolder.is_run).check()
        RunFolder.check_outside(path)
        owner = _job_path(path)
        if owner != path and JobFolder.is_job(owner):
            raise FolderError(
                f"{path} is for a run of a campaign: `qdgrasp campaign {owner}` goes on with its runs; "
                "for a new run name another folder with --out."
            )
        if RunFolder.is_run(path):
            raise FolderError(
                f"{path} holds a run already: `qdgrasp resume {path}` goes on with it; "
                "for a new run name another folder with --out."
            )

    @staticmethod
    def check_outside(path: Path) -> None:
        """Check that `path` is not in the folder of a run.

        Raises
        ------
        FolderError
            It is.
        """
        for folder in path.resolve().parents:
            if RunFolder.is_run(folder):
                raise FolderError(
                    f"{path} would lie in {folder}, the folder of a run; name another folder with --out."
                )

    @property
    def job(self) -> JobFolder:
        """The folder of the job that it belongs to: itself, or the campaign's."""
        return JobFolder(_job_path(self.path))

    @property
    def run(self) -> str:
        """Its name in its job."""
        return RUN if JobFolder.is_job(self.path) else self.path.absolute().name

    @property
    def spec(self) -> RunSpec:
        """The full spec."""
        return run_spec(read_run_spec(self.path / SPEC), str(self.path / SPEC))

    def rewrite_spec(self, spec: RunSpec) -> None:
        """Replace the spec."""
        disk.replace(self.path / SPEC, to_toml(spec).encode())

    def bundle(self) -> Bundle:
        """The scene as bytes, with its digest."""
        payload = disk.read(self.path / SCENE)
        return Bundle(payload, hashlib.sha256(payload).hexdigest())

    def has_bundle(self) -> bool:
        """Whether the scene is here; a recorder on another machine begins without."""
        return (self.path / SCENE).is_file()

    def add_bundle(self, payload: bytes) -> None:
        """Store the scene."""
        disk.replace(self.path / SCENE, payload)

    def scene(self) -> Scene:
        """The scene.

        Raises
        ------
        FolderError
            It is missing or damaged.
        """
        try:
            payload = disk.read(self.path / SCENE)
            codec.check_bundle(payload)
            return unpack_scene(payload)
        except MessageError as error:
            raise FolderError(
                f"{self.path / SCENE} cannot be read: {error}; "
                "use the version of qdgrasp that wrote it, or restore the file from a copy."
            ) from None

    def journal(self) -> Journal:
        """The journal as it is now, for a with-block; empty before a recorder opened the run.

        Raises
        ------
        FolderError
            It cannot be read.
        OtherRun
            It is of another run than the spec or the scene here.
        """
        if (self.path / JOURNAL).exists():
            journal = Journal.open(self.path)
            try:
                self._check_own(journal)
            except BaseException:
                journal.close()
                raise
            return journal
        scene = self.bundle().digest if self.has_bundle() else ""
        return Journal.empty(Identity(self.run, to_toml(self.spec), scene, Shape(0, 0)))

    def _check_own(self, journal: Journal) -> None:
        """Check that a journal is of this folder's spec, with any budget, and of its scene."""
        file = self.path / JOURNAL
        if journal.spec_text != disk.read(self.path / SPEC).decode(errors="replace"):
            found, told = journal.spec, self.spec
            if other := differences(found, told):
                raise OtherRun(file, self.path / SPEC, _in_words(found, other), _in_words(told, other))
        if self.has_bundle() and (digest := self.bundle().digest) != journal.scene:
            scene, spec = self.scene(), journal.spec
            raise OtherRun(
                file,
                self.path / SCENE,
                f"scene {journal.scene[:12]} ({spec.gripper} on {spec.object})",
                f"scene {digest[:12]} ({scene.gripper.name} on {scene.object.name})",
            )


def files(spec: RunSpec, bundle: Bundle | None) -> dict[str, bytes]:
    """The files of a new run."""
    scene = {} if bundle is None else {SCENE: bundle.payload}
    return {SPEC: to_toml(spec).encode()} | scene


def _job_path(path: Path) -> Path:
    """The folder of the job of a run's folder."""
    is_part = not JobFolder.is_job(path) and path.absolute().parent.name == RUNS
    return path.absolute().parent.parent if is_part else path


def _in_words(spec: RunSpec, keys: Iterable[str]) -> str:
    """A run by what it has otherwise than another one."""
    told = [f"{key} {str(getattr(spec, key))[:LONGEST]}" for key in keys]
    return f"a run with {few(told, SHOWN)}"


def _no_run(path: Path) -> str:
    """What is said of a folder that holds no run."""
    if JobFolder.is_job(path) and JobFolder(path).is_campaign:
        return f"{path} holds a campaign; name one of its runs, a folder in {path / RUNS}."
    there = [name for name in (SPEC, JOB) if disk.is_file(path / name)]
    if not there:
        return f"{path} holds no run: there is neither {SPEC} nor {JOB} in it; name a run's folder."
    (missing,) = {SPEC, JOB} - {*there}
    return f"{path} holds no whole run: it has {there[0]}, but no {missing}; restore that from a copy."
