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

import msgspec
import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from qdgrasp_assets.asset_paths import on_asset_path
from qdgrasp_assets.geometry.mesh import join, parse_parts
from qdgrasp_assets.geometry.surface_points import BULLET_MARGIN
from qdgrasp_assets.scene import Scene
from qdgrasp_assets.ycb import PREFIX
from qdgrasp_coordinator.metrics.arrays import read_arrays
from qdgrasp_coordinator.metrics.cells import cell_keys, cells
from qdgrasp_coordinator.metrics.successes import ROBUST
from qdgrasp_protocol.errors import AssetError, InputError, UnknownName
from qdgrasp_protocol.text import counted

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


def read_reference(path: Path, name: str) -> ReferenceSet:
    """Return the set of the object `name` in a file.

    Raises `InputError` where there is no npz file of plain arrays, `AssetError` where it is not a reference
    set, and `UnknownName` where it has no set for this object; those it has are named.
    """
    sets = read_references(path)
    if name not in sets:
        raise UnknownName(f"object of the reference set '{path}'", name, sets)
    return sets[name]


def read_references(path: Path) -> dict[str, ReferenceSet]:
    """All sets in a file by object; raises as `read_reference`."""
    arrays = read_arrays(path, "reference set")
    objects = [key.removesuffix(".cm") for key in arrays if key.endswith(".cm")]
    if not objects:
        raise AssetError(
            f"'{path}' holds no reference set: {EXPECTED_FILE}, found {', '.join(arrays) or 'nothing'}."
        )
    return {name: _checked_set(path, name, arrays) for name in objects}


def is_stand_in(run_object: str, reference: ReferenceSet) -> bool:
    """Return whether a run's object only stands in for the scan that a set was made with.

    The object is given as the run's spec names it. Raises `InputError` where the run is neither on the scan
    nor on its stand-in: its positions mean something else.
    """
    name = reference.object
    if run_object not in (name, f"ycb_{name}"):
        raise InputError(
            f"The set of '{name}' compares with runs on 'ycb_{name}' or on the stand-in '{name}', "
            f"but this run is on '{run_object}'; name the run's object with --object."
        )
    return run_object == name


def _checked_set(path: Path, name: str, arrays: Mapping[str, NDArray[np.generic]]) -> ReferenceSet:
    found, fitness = arrays[f"{name}.cm"], arrays.get(f"{name}.fitness")
    if found.dtype.kind not in "iu" or found.ndim != 2 or found.shape[1] != 3:
        raise AssetError(f"'{name}.cm' in '{path}' must be whole numbers (n, 3).")
    is_known = fitness is not None and fitness.shape == (len(found),) and np.isin(fitness, (0, 1, 2)).all()
    if fitness is None or not is_known:
        raise AssetError(f"'{name}.fitness' in '{path}' must be {len(found)} whole numbers from 0 to 2.")
    cells = found.astype(np.int64)
    if len(np.unique(cells, axis=0)) != len(cells):
        raise AssetError(f"'{name}.cm' in '{path}' names a cell more than once.")
    return ReferenceSet(name, cells, fitness.astype(np.uint8))


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
        for known in self._candidates(hand, name):
            try:
                stand_in = is_stand_in(run_object, known)
            except InputError:
                continue
            if len(known):
                return CoverageTarget(known, released_archive(scene), stand_in)
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


class Coverage(Struct, frozen=True, kw_only=True):
    """Coverage of a reference set; None where the denominator of a ratio is 0."""

    coverage: float | None
    """`found` over `size`, 0 to 1."""
    robust: float | None
    """`robust_found` over `robust_size`, 0 to 1."""
    released: float | None
    """`released_found` over `size`: the authors' code counts elites, not positions."""
    released_robust: float | None
    """Elites of fitness 2 whose position is in the set, over `robust_size`; may exceed 1."""
    size: int
    """Entries of the set."""
    found: int
    """Distinct success positions, rounded to 1 cm, that are in the set."""
    outside: int
    """Distinct success positions, rounded to 1 cm, that are not."""
    robust_size: int
    """Entries of the set with fitness 2."""
    robust_found: int
    """Entries in which a success of fitness 2 was found."""
    released_found: int | None
    """Elites of the released code's archive in the set; None for a hand that it lacks."""
    sentence: str = ""
    """The result in words."""


def coverage(
    positions: NDArray[np.floating],
    fitness: NDArray[np.number],
    reference: ReferenceSet,
    archive: ReleasedArchive | None = None,
) -> Coverage:
    """Compare a run's successes with the reference set of the same object.

    `positions` (n, 3) [m] of the hand, CoM frame, and `fitness` (n,) are in journal order. Without the
    released code's archive for this scene, its figures are left out.
    """
    reached, robust = cells(positions), reference.robust
    distinct = np.unique(reached, axis=0)
    found = _common_cells(distinct, reference)
    robust_found = _common_cells(np.unique(reached[fitness == ROBUST], axis=0), robust)
    elites = robust_elites = None
    if archive is not None:
        shared = np.isin(cell_keys(reached), cell_keys(reference.cells))
        elites = int(archive.gains(positions, fitness, shared).sum())
        robust_elites = int(archive.gains(positions, fitness, shared & (fitness == ROBUST)).sum())
    result = Coverage(
        coverage=_ratio(found, len(reference)),
        robust=_ratio(robust_found, len(robust)),
        released=_ratio(elites, len(reference)),
        released_robust=_ratio(robust_elites, len(robust)),
        size=len(reference),
        found=found,
        outside=len(distinct) - found,
        robust_size=len(robust),
        robust_found=robust_found,
        released_found=elites,
    )
    return msgspec.structs.replace(result, sentence=_sentence(result, reference.object))


def _common_cells(positions: NDArray[np.int64], reference: ReferenceSet) -> int:
    """Count the `positions` (n, 3) that are cells of the set; repeated ones count repeatedly."""
    return int(np.isin(cell_keys(positions), cell_keys(reference.cells)).sum())


def _ratio(found: int | None, size: int) -> float | None:
    return None if found is None or size == 0 else found / size


def _sentence(result: Coverage, name: str) -> str:
    if result.coverage is None:
        return f"The reference set of '{name}' is empty, so that there is no coverage of it."
    words = (
        f"{result.found} of the {result.size} cells of '{name}' were found ({result.coverage:.2%}), "
        f"and {counted(result.outside, 'cell that is', 'cells that are')} not in the set."
    )
    if result.robust is not None:
        found = f"{result.robust_found} of the {result.robust_size} that have it in the set"
        words += f" With fitness 2 were found {found} ({result.robust:.2%})."
    if result.released is not None:
        found = f"{result.released_found} of the {result.size}"
        words += f" The released code counts {found} ({result.released:.2%})."
    return words
