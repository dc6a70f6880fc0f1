"""Targets: which reference set the positions of a scene are compared with, or why with none."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from qdgrasp_assets.files import on_asset_path
from qdgrasp_assets.scene import Scene
from qdgrasp_coordinator.analysis.harvest import SCAN, identity
from qdgrasp_coordinator.analysis.reference import ReferenceSet, is_stand_in, read_references
from qdgrasp_coordinator.analysis.released import ReleasedArchive, reference_hand, released_archive
from qdgrasp_protocol.errors import InputError

PUBLISHED = "reference/S_G_{hand}.npz"
"""Where the published sets lie on the asset path."""


@dataclass(frozen=True)
class Target:
    """What a scene's positions are compared with."""

    reference: ReferenceSet | None = None
    """Never empty; None: there is nothing to compare with."""
    archive: ReleasedArchive | None = None
    """The released code's archive; None for a hand that it does not have, and for a set of one's own."""
    stand_in: bool = False
    """Whether the scene's object only stands in for the scan that the set was made with."""
    why: str = ""
    """Why there is no set, in words."""

    @property
    def size(self) -> int:
        """How many entries the set has; 0 without one."""
        return 0 if self.reference is None else len(self.reference)


class Targets:
    """Finds the target of each scene.

    Parameters
    ----------
    files
        Reference sets that are looked at before the published ones on the asset path. A file that does not
        say which hand it is for says it by its name, `S_G_<hand>.npz`.
    """

    def __init__(self, files: Sequence[Path] = ()) -> None:
        self._own = [(path, read_references(path)) for path in files]

    def of(self, scene: Scene, run_object: str) -> Target:
        """The target of a scene whose object a run's spec calls `run_object`."""
        hand, body = reference_hand(scene.gripper.name), identity(scene.object)
        name = scene.object.name.removeprefix(SCAN)
        for known in self._candidates(hand, scene.gripper.name, body, name):
            try:
                stand_in = is_stand_in(run_object, body, known)
            except InputError:
                continue
            if len(known):
                archive = released_archive(scene) if known.origin is None else None
                return Target(known, archive, stand_in)
            return Target(why=f"S_G of {hand} and {name} is empty")
        return Target(why=f"no S_G of {hand} and {name}")

    def _candidates(self, hand: str, gripper: str, body: str, name: str) -> Iterator[ReferenceSet]:
        for path, sets in self._own:
            for known in sets.values():
                origin = known.origin
                hers = path.stem.endswith(f"_{hand}") if origin is None else origin.gripper == gripper
                if hers and (known.object == name or (origin is not None and origin.identity == body)):
                    yield known
        published = on_asset_path(PUBLISHED.format(hand=hand))
        if published is not None:
            yield from _named(name, _read(published).values())


def _named(name: str, sets: Iterable[ReferenceSet]) -> Iterator[ReferenceSet]:
    return (known for known in sets if known.object == name)


@cache
def _read(path: Path) -> dict[str, ReferenceSet]:
    return read_references(path)
