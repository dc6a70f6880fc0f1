"""Coverage of reference sets, and which set belongs to a scene.

S_G and cvg are those of Huber et al. 2024, section IV.

A reference set holds the cells that are known to be graspable. It is an `.npz` file with, for each object,
`<object>.cm` (n, 3), hand positions in whole centimetres in the object's CoM frame, and `<object>.fitness`
(n,), the best fitness known there: 0, 1 or 2.

`ReleasedArchive` is the outcome archive of the authors' released code, which keeps fewer successes than a
journal does: coverage is given in both countings.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from qdgrasp_assets.asset_paths import on_asset_path
from qdgrasp_assets.geometry.mesh import join, parse_parts
from qdgrasp_assets.geometry.surface_points import BULLET_MARGIN
from qdgrasp_assets.scene import Scene
from qdgrasp_assets.ycb import PREFIX
from qdgrasp_coordinator.metrics.arrays import read_arrays
from qdgrasp_coordinator.metrics.successes import ROBUST
from qdgrasp_protocol.errors import AssetError

ARCHIVE_BIN = 0.01  # The bins are this wide or a little wider [m]
HAND_EXTENT = {"panda_2f": 0.2084, "robotiq_2f": 0.1681, "bh280": 0.3393, "allegro": 0.2498, "shadow": 0.5415}
"""Largest extent of each reference hand's bounding box, added to that of the object [m]."""
SAME_HAND = {"panda": "panda_2f", "barrett": "bh280"}
"""Models of our own, by the reference hand that they stand for."""


@dataclass(frozen=True)
class ReleasedArchive:
    """The cube of the released code's archive, in the frame of the positions."""

    low: NDArray[np.float64]
    """(3,) [m]: the corner with the smallest coordinates."""
    side: float
    """Length of its edges [m]."""

    @property
    def bins(self) -> int:
        """Number of bins along each axis."""
        return int(self.side / ARCHIVE_BIN)

    def keys(self, positions: NDArray[np.floating]) -> NDArray[np.int64]:
        """The flattened bin of each position (n, 3) [m]; (n,), not clipped below, as released."""
        place = np.floor((positions.astype(np.float64) - self.low) / (self.side / self.bins)).astype(np.int64)
        place = np.where(place > self.bins, self.bins - 1, place)
        keys: NDArray[np.int64] = place @ np.array([1, self.bins, self.bins**2])
        return keys

    def gains(
        self, positions: NDArray[np.floating], fitness: NDArray[np.number], counts: NDArray[np.bool_]
    ) -> NDArray[np.int64]:
        """Return what each success (n,) adds to the number of elites that count: -1, 0 or 1, (n,).

        An elite is the first success of the greatest fitness in its cell; one that counts (n,) may be
        displaced by one that does not. `positions` (n, 3) [m], CoM frame, are in journal order.
        """
        cell = self.keys(positions)
        order = np.argsort(cell, kind="stable")
        place = np.unique(cell[order], return_inverse=True)[1]
        above = np.float64(1.0 + np.max(fitness, initial=0))
        best = np.maximum.accumulate(place * above + fitness[order])  # within a cell: earlier ones are less
        elite = order[np.diff(best, prepend=-1.0) > 0]
        is_same_cell = cell[elite][1:] == cell[elite][:-1]
        gains, worth = np.zeros(len(cell), dtype=np.int64), counts.astype(np.int64)
        gains[elite] = worth[elite]
        gains[elite[1:]] -= np.where(is_same_cell, worth[elite][:-1], 0)
        return gains


def released_archive(scene: Scene) -> ReleasedArchive | None:
    """Return the released code's archive for a scene; None: that code does not have this hand.

    The cube stands around the object's bounding box as it was while the mesh frame lay at the origin. The
    object is moved to its centre of mass afterwards, the cube is not.
    """
    extent = HAND_EXTENT.get(reference_hand(scene.gripper.name))
    if extent is None:
        return None
    hulls = join(parse_parts(scene.object.collision.decode())).vertices + np.array(scene.object.com_in_mesh)
    low, high = hulls.min(axis=0) - BULLET_MARGIN, hulls.max(axis=0) + BULLET_MARGIN
    side = extent + float((high - low).max())
    return ReleasedArchive((low + high) / 2 - side / 2, side)


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
    """Reference set and archive that a scene's positions are compared with."""

    reference: ReferenceSet | None = None
    """Never empty; None: there is nothing to compare with."""
    archive: ReleasedArchive | None = None
    """The released code's archive; None for a hand that it lacks."""
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
            return CoverageTarget(known, released_archive(scene), stand_in=run_object == name)
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
