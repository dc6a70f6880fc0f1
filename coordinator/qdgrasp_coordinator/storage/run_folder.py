"""The folder of a run: its files, how it is begun, and where its rows come from.

* `spec.toml`     the full spec: `qdgrasp run DIR/spec.toml --out OTHER` repeats the run
* `scene.bundle`  the scene, as workers fetch it
* `run.sqlite`    the journal, once a recorder has opened it

Beside them are the files of its job (`job_folder`), unless it is one of a campaign's.

The digest of a journal is equal for two runs of one spec, however they were carried out
(docs/reproducibility.md).
"""

import hashlib
from collections.abc import Mapping, Sequence
from itertools import chain
from pathlib import Path
from types import MappingProxyType
from typing import NamedTuple

from qdgrasp_assets.scene import Bundle, Scene, unpack_scene
from qdgrasp_coordinator.metrics.successes import Successes, TrialPlan, find_successes, join_successes
from qdgrasp_coordinator.storage import outputs
from qdgrasp_coordinator.storage.job_folder import RUN, JobFolder, new_job
from qdgrasp_coordinator.storage.journal import Journal, JournalIdentity
from qdgrasp_coordinator.storage.outputs import JOB, JOURNAL, LOGS, RUNS, SCENE, SPEC, OutFolder
from qdgrasp_protocol import messages
from qdgrasp_protocol.errors import FolderError, MessageError
from qdgrasp_protocol.rows import Outcome, RowShape
from qdgrasp_protocol.spec import RunSpec, read_run_spec, run_spec, to_toml

Files = Mapping[str, bytes]
"""Contents of files by name."""
NO_FILES: Files = MappingProxyType({})


class PreparedScene(NamedTuple):
    """The scene of a run, with its bytes."""

    scene: Scene
    bundle: Bundle


def journal_digest(journal: Journal) -> str:
    """The sha256 over the bytes of the journal's rows in order, 64 hex digits.

    Where the blocks that hold the rows begin, and what they cost, when, and on which host, is not in it
    (docs/reproducibility.md).
    """
    total = hashlib.sha256()
    for rows in journal.blocks():
        total.update(rows.tobytes())
    return total.hexdigest()


class RunFolder:
    """A run's folder; made by `create`, `add` or `open`."""

    def __init__(self, path: Path) -> None:
        self.path = path

    @classmethod
    def create(
        cls,
        path: Path,
        spec: RunSpec,
        bundle: Bundle | None,
        *,
        job: str | None = None,
        more: Files = NO_FILES,
    ) -> "RunFolder":
        """Begin the folder of a run that is a job of its own; it appears whole or not at all.

        It has `more` files. Without a bundle, the scene is added later (`add_bundle`); without a job's name,
        it is the folder's, reduced to the allowed characters. Raises `FolderError` where the folder holds
        another run or other files, or cannot be made.
        """
        cls.check_free(path)
        files = new_job(path, job) | run_files(spec, bundle) | dict(more)
        outputs.create_folder(path, files, folders=[LOGS])
        return cls(path)

    @classmethod
    def add(cls, job: JobFolder, run: str, spec: RunSpec, bundle: Bundle | None) -> "RunFolder":
        """Begin the folder of one of a campaign's runs; raises as `create`."""
        path = job.run_path(run)
        outputs.create_folder(path, run_files(spec, bundle))
        return cls(path)

    @classmethod
    def open(cls, path: Path) -> "RunFolder":
        """Return the folder of a run that was begun; raise `FolderError` without one."""
        outputs.check_folder(path)
        if not cls.is_run(path):
            raise FolderError(
                f"{path} holds no run, which has {SPEC} and {JOB}; name a run's folder, of a campaign one in "
                f"{path / RUNS}."
            )
        return cls(path)

    @staticmethod
    def is_run(path: Path) -> bool:
        """Return whether a run was begun in this folder."""
        return outputs.is_file(path / SPEC) and JobFolder.is_job(_job_path(path))

    @staticmethod
    def check_free(path: Path) -> None:
        """Check that a run of its own can be begun at `path`: nothing is there, or an empty folder.

        Raises `FolderError` where something is there, or on the way to it, or it is among the runs of a
        campaign or in another run.
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
        """Raise `FolderError` if `path` is in the folder of a run."""
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
        outputs.replace(self.path / SPEC, to_toml(spec).encode())

    def bundle(self) -> Bundle:
        """The scene as bytes, with its digest."""
        payload = outputs.read(self.path / SCENE)
        return Bundle(payload, hashlib.sha256(payload).hexdigest())

    def has_bundle(self) -> bool:
        """Return whether the scene is here; a recorder on another machine begins without it."""
        return (self.path / SCENE).is_file()

    def add_bundle(self, payload: bytes) -> None:
        """Store the scene."""
        outputs.replace(self.path / SCENE, payload)

    def scene(self) -> Scene:
        """Return the scene; raise `FolderError` if it is missing or damaged."""
        return self.prepared_scene().scene

    def prepared_scene(self) -> PreparedScene:
        """Return the scene with its bytes; raise `FolderError` if it is missing or damaged."""
        bundle = self.bundle()
        try:
            messages.check_bundle(bundle.payload)
            return PreparedScene(unpack_scene(bundle.payload), bundle)
        except MessageError as error:
            raise FolderError(
                f"{self.path / SCENE} cannot be read: {error}; "
                "use the version of qdgrasp that wrote it, or restore the file from a copy."
            ) from None

    def journal(self) -> Journal:
        """Return the journal as it is now, for a with-block; empty before a recorder opened the run.

        Raises `FolderError` where it cannot be read.
        """
        if (self.path / JOURNAL).exists():
            return Journal.open(self.path)
        scene = self.bundle().digest if self.has_bundle() else ""
        return Journal.empty(JournalIdentity(self.run, self.spec, scene, RowShape(0, 0)))

    def successes(self, least: Outcome = Outcome.DROPPED) -> Successes:
        """Return all successes as they are now, or all nominal rows of at least an outcome."""
        spec = self.spec
        with self.journal() as journal:
            blocks = chain([journal.shape.empty(0)], journal.blocks())
            return join_successes([*find_successes(blocks, TrialPlan.of(spec), spec.overlaps, least=least)])


def run_files(spec: RunSpec, bundle: Bundle | None) -> dict[str, bytes]:
    """The files of a new run."""
    scene = {} if bundle is None else {SCENE: bundle.payload}
    return {SPEC: to_toml(spec).encode()} | scene


def _job_path(path: Path) -> Path:
    is_part = not JobFolder.is_job(path) and path.absolute().parent.name == RUNS
    return path.absolute().parent.parent if is_part else path


class Provenance(NamedTuple):
    """A run that recorded rows."""

    run: str
    """The name of its folder."""
    spec: RunSpec
    platform: dict[str, str]
    """Platform that its rows were made on; empty where that is not known."""


def provenance(folder: RunFolder, journal: Journal) -> Provenance:
    """Return where the rows of a folder's journal come from."""
    return Provenance(folder.path.absolute().name, folder.spec, journal.platform)


def run_folders(directories: Sequence[Path]) -> list[RunFolder]:
    """Return the runs in folders of runs and campaigns, each once; raises FolderError."""
    found = []
    for directory in directories:
        is_campaign = JobFolder.is_job(directory) and JobFolder(directory).is_campaign
        paths = JobFolder(directory).run_paths if is_campaign else [directory]
        found += [RunFolder.open(path) for path in paths if not is_campaign or RunFolder.is_run(path)]
    return list({folder.path.resolve(): folder for folder in found}.values())
