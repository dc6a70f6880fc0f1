"""Reference sets: the cells that are known to be graspable, S_G of Huber et al. 2024, section IV.

A set is an `.npz` file with, for each object, `<object>.cm` (n, 3), hand positions in whole centimetres in
the object's CoM frame, and `<object>.fitness` (n,), the best fitness known there: 0, 1 or 2. Sets that were
built here also say of what (`BuiltFrom`): `gripper`, and for each object `<object>.made_with`, `.identity`
and `.protocols`.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from qdgrasp_coordinator.counts.arrays import read_arrays
from qdgrasp_coordinator.counts.scores import ROBUST
from qdgrasp_protocol.errors import AssetError, InputError, UnknownName

EXPECTED = "expected an .npz file with '<object>.cm' and '<object>.fitness'"
ORIGIN = ("made_with", "identity", "protocols")
"""What a set that was built here says of each object, beside its gripper."""


@dataclass(frozen=True)
class BuiltFrom:
    """What a set was built from."""

    gripper: str
    object: str
    """The object of its runs: a name of the catalog or that of a mesh file."""
    identity: str
    """`harvest.identity` of that object."""
    protocols: tuple[str, ...]
    """The evaluation protocols of its runs, sorted."""


@dataclass(frozen=True)
class ReferenceSet:
    """The graspable cells of one object."""

    object: str
    cells: NDArray[np.int64]
    """(n, 3), distinct, whole centimetres, CoM frame."""
    fitness: NDArray[np.uint8]
    """(n,), the best fitness known in each cell: 0, 1 or 2."""
    origin: BuiltFrom | None = None
    """None: of the published scans, and the file does not say more."""

    def __len__(self) -> int:
        return len(self.cells)

    @property
    def robust(self) -> "ReferenceSet":
        """The entries with fitness 2."""
        chosen = self.fitness == ROBUST
        return replace(self, cells=self.cells[chosen], fitness=self.fitness[chosen])


def read_reference(path: Path, name: str) -> ReferenceSet:
    """The set of the object `name` in a file.

    Raises
    ------
    InputError
        There is no such file, or it is no npz file of plain arrays.
    AssetError
        It is not a reference set.
    UnknownName
        The file has no set for this object; those it has are named.
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
            f"'{path}' holds no reference set: {EXPECTED}, found {', '.join(arrays) or 'nothing'}."
        )
    return {name: _checked(path, name, arrays) for name in objects}


def is_stand_in(run_object: str, identity: str, reference: ReferenceSet) -> bool:
    """Whether a run's object only stands in for the scan that a set was made with.

    Parameters
    ----------
    run_object
        The object as the run's spec names it.
    identity
        Its `harvest.identity`.
    reference
        The set. One that does not say what it was built from was made with the scan.

    Raises
    ------
    InputError
        The run is neither on the object that the set was made with nor, where that is the scan, on its
        stand-in, so that its positions mean something else.
    """
    name, origin = reference.object, reference.origin
    if origin is not None and origin.identity == identity:
        return False
    if origin is not None and origin.object != f"ycb_{name}":
        raise InputError(
            f"The set of '{name}' was built from runs on '{origin.object}', but this run is on "
            f"'{run_object}', whose mesh or centre of mass is another."
        )
    if run_object not in (name, f"ycb_{name}"):
        raise InputError(
            f"The set of '{name}' compares with runs on 'ycb_{name}' or on the stand-in '{name}', "
            f"but this run is on '{run_object}'; name the run's object with --object."
        )
    return run_object == name


def _checked(path: Path, name: str, arrays: Mapping[str, NDArray[np.generic]]) -> ReferenceSet:
    found, fitness = arrays[f"{name}.cm"], arrays.get(f"{name}.fitness")
    if found.dtype.kind not in "iu" or found.ndim != 2 or found.shape[1] != 3:
        raise AssetError(f"'{name}.cm' in '{path}' must be whole numbers (n, 3), got {_form(found)}.")
    if fitness is None or fitness.shape != (len(found),):
        form = "nothing" if fitness is None else _form(fitness)
        raise AssetError(f"'{name}.fitness' in '{path}' must be ({len(found)},), got {form}.")
    cells = found.astype(np.int64)
    if len(np.unique(cells, axis=0)) != len(cells):
        raise AssetError(f"'{name}.cm' in '{path}' names a cell more than once.")
    return ReferenceSet(name, cells, fitness.astype(np.uint8), _origin(name, arrays))


def _origin(name: str, arrays: Mapping[str, NDArray[np.generic]]) -> BuiltFrom | None:
    said = [arrays.get(key) for key in ("gripper", *(f"{name}.{part}" for part in ORIGIN))]
    gripper, made_with, identity, protocols = said
    if gripper is None or made_with is None or identity is None or protocols is None:
        return None
    return BuiltFrom(str(gripper), str(made_with), str(identity), tuple(map(str, protocols.ravel())))


def _form(array: NDArray[np.generic]) -> str:
    return f"{array.dtype} {array.shape}"
