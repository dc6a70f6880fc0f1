"""Coverage of reference sets, and which set belongs to a scene.

S_G and cvg are those of Huber et al. 2024, section IV.

A reference set holds the cells that are known to be graspable. It is an `.npz` file with, for each object,
`<object>.cm` (n, 3), hand positions in whole centimetres in the object's CoM frame, and `<object>.fitness`
(n,), the best fitness known there: 0, 1 or 2.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from qdgrasp_assets.asset_paths import on_asset_path
from qdgrasp_assets.scene import Scene
from qdgrasp_assets.ycb import PREFIX
from qdgrasp_coordinator.metrics.arrays import read_arrays
from qdgrasp_coordinator.metrics.successes import ROBUST
from qdgrasp_protocol.errors import AssetError

SAME_HAND = {"panda": "panda_2f", "barrett": "bh280"}
"""Models of our own, by the reference hand that they stand for."""


def reference_hand(gripper: str) -> str:
    """Return the reference hand that a gripper is or stands for; else its own name."""
    hand = gripper.removeprefix("ref_")
    return SAME_HAND.get(hand, hand)


EXPECTED_FILE = "expected an .npz file with '<object>.cm' and '<object>.fitness'"


@dataclass(frozen=True)
class ReferenceSet:
    """The graspable cells of one object."""

    object: str
    cells: NDArray[np.int64]
    """(n, 3), distinct, whole centimetres, CoM frame."""
    fitness: NDArray[np.uint8]
    """(n,), the best fitness known in each cell: 0, 1 or 2."""

    def __len__(self) -> int:
        return len(self.cells)

    @property
    def robust(self) -> "ReferenceSet":
        """The entries with fitness 2; runs with a success of fitness 2 there have found them."""
        chosen = self.fitness == ROBUST
        return replace(self, cells=self.cells[chosen], fitness=self.fitness[chosen])


def read_references(path: Path) -> dict[str, ReferenceSet]:
    """Return all sets in a file by object.

    Raises `InputError` where there is no npz file of plain arrays, and `AssetError` where it is no set.
    """
    arrays = read_arrays(path, "reference set")
    objects = [key.removesuffix(".cm") for key in arrays if key.endswith(".cm")]
    try:
        if not objects:
            raise ValueError(f"found {', '.join(arrays) or 'nothing'}")
        return {name: _reference_set(name, arrays) for name in objects}
    except (KeyError, ValueError) as error:
        raise AssetError(f"'{path}' holds no reference set: {EXPECTED_FILE}; {error}.") from None


def _reference_set(name: str, arrays: Mapping[str, NDArray[np.generic]]) -> ReferenceSet:
    cells, fitness = arrays[f"{name}.cm"].astype(np.int64), arrays[f"{name}.fitness"].astype(np.uint8)
    if cells.shape != (len(fitness), 3):
        raise ValueError(f"{name} has cells {cells.shape} and fitness {fitness.shape}")
    return ReferenceSet(name, cells, fitness)


PUBLISHED_SETS = "reference/S_G_{hand}.npz"  # Where the published sets lie on the asset path


@dataclass(frozen=True)
class CoverageTarget:
    """Reference set that a scene's positions are compared with."""

    reference: ReferenceSet | None = None
    """Never empty; None: there is nothing to compare with."""
    stand_in: bool = False
    """True if the scene's object only stands in for the scan that the set was made with."""
    why: str = ""
    """Reason why there is no set, in words."""

    @property
    def size(self) -> int:
        """Number of entries of the set; 0 without one."""
        return 0 if self.reference is None else len(self.reference)


class ReferenceLookup:
    """Finds the target of each scene.

    Sets in `files` come before the published ones on the asset path. The name of a file
    says which hand it is for: `S_G_<hand>.npz`.
    """

    def __init__(self, files: Sequence[Path] = ()) -> None:
        self._own = [(path, read_references(path)) for path in files]

    def of(self, scene: Scene, run_object: str) -> CoverageTarget:
        """The target of a scene whose object a run's spec calls `run_object`."""
        hand = reference_hand(scene.gripper.name)
        name = scene.object.name.removeprefix(PREFIX)
        known = next(self._candidates(hand, name), None) if run_object in (name, PREFIX + name) else None
        if known is not None and len(known):
            return CoverageTarget(known, stand_in=run_object == name)
        if known is not None:
            return CoverageTarget(why=f"S_G of {hand} and {name} is empty")
        return CoverageTarget(why=f"no S_G of {hand} and {name}")

    def _candidates(self, hand: str, name: str) -> Iterator[ReferenceSet]:
        for path, sets in self._own:
            if path.stem.endswith(f"_{hand}") and name in sets:
                yield sets[name]
        published = on_asset_path(PUBLISHED_SETS.format(hand=hand))
        if published is not None and name in (sets := _read_published(published)):
            yield sets[name]


_read_published = cache(read_references)
