"""What a run is, to a recorder: its name, spec and scene, and how wide its rows are."""

from dataclasses import dataclass, replace
from pathlib import Path

from qdgrasp_coordinator.folders.folder import RunFolder
from qdgrasp_coordinator.folders.journal import Journal
from qdgrasp_coordinator.folders.journal_format import Identity
from qdgrasp_protocol.errors import Refused
from qdgrasp_protocol.messages import OpenRun
from qdgrasp_protocol.rows import Shape
from qdgrasp_protocol.spec import RunSpec, differences, from_toml, to_toml


@dataclass(frozen=True)
class Subject:
    """A run, as a coordinator opens it or as a folder holds it."""

    run: str
    spec: RunSpec
    scene: str
    """sha256 of the scene bundle."""
    shape: Shape

    @classmethod
    def of(cls, asked: OpenRun) -> "Subject":
        """The run that a coordinator opens.

        Raises
        ------
        InputError
            Its spec is none.
        """
        spec = from_toml(asked.spec.decode(errors="replace"), "the coordinator's spec")
        return cls(asked.run, spec, asked.scene, Shape(asked.genes, asked.joints, asked.descriptors))

    @classmethod
    def recorded_in(cls, journal: Journal) -> "Subject":
        """The run of a journal, with its latest budget."""
        return cls(journal.run, journal.spec, journal.scene, journal.shape)

    def begun_in(self, folder: RunFolder) -> "Subject":
        """The same run, with what a folder without a journal holds of it."""
        scene = folder.bundle().digest if folder.has_bundle() else self.scene
        return replace(self, spec=folder.spec, scene=scene)

    @property
    def identity(self) -> Identity:
        """What its journal is begun with."""
        return Identity(self.run, to_toml(self.spec), self.scene, self.shape)


def check_same(path: Path, held: Subject, asked: Subject) -> None:
    """Check that the run that is asked for is the one that a folder holds, with any budget and goals.

    Raises
    ------
    Refused
        It is another one; what differs is named.
    """
    differ = differences(held.spec, asked.spec)
    if differ:
        raise Refused(f"{path} holds a run of another spec: {', '.join(differ)} differ; name another folder")
    if asked.scene != held.scene:
        raise Refused(
            f"{path} holds a run of scene {held.scene[:12]}, the coordinator has {asked.scene[:12]}"
        )
    if (asked.run, asked.shape) != (held.run, held.shape):
        raise Refused(f"{path} holds run '{held.run}' with rows of {held.shape}")
