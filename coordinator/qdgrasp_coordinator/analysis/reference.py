"""Reference sets: the cells that are known to be graspable, S_G of Huber et al. 2024, section IV.

A set is an `.npz` file with, for each object, `<object>.cm` (n, 3), hand positions in whole centimetres in
the object's CoM frame, and `<object>.fitness` (n,), the best fitness known there: 0, 1 or 2.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from qdgrasp_coordinator.arrays import read_arrays
from qdgrasp_protocol.errors import AssetError, InputError, UnknownName

EXPECTED = "expected an .npz file with '<object>.cm' and '<object>.fitness'"


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
        """The entries with fitness 2."""
        chosen = self.fitness == 2
        return ReferenceSet(self.object, self.cells[chosen], self.fitness[chosen])


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
    arrays = read_arrays(path, "reference set")
    objects = [key.removesuffix(".cm") for key in arrays if key.endswith(".cm")]
    if not objects:
        raise AssetError(
            f"'{path}' holds no reference set: {EXPECTED}, found {', '.join(arrays) or 'nothing'}."
        )
    if name not in objects:
        raise UnknownName(f"object of the reference set '{path}'", name, objects)
    return _checked(path, name, arrays)


def is_stand_in(run_object: str, name: str) -> bool:
    """Whether a run's object only stands in for the scan that the set of `name` was made with.

    Raises
    ------
    InputError
        The run is on neither the scan nor its stand-in, so that its positions mean something else.
    """
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
    return ReferenceSet(name, cells, fitness.astype(np.uint8))


def _form(array: NDArray[np.generic]) -> str:
    return f"{array.dtype} {array.shape}"
