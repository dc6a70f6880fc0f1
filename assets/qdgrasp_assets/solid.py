"""Solids: closed surfaces in metres, read from mesh files, put right where that takes no guess."""

import logging
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from qdgrasp_assets.mesh import Mesh
from qdgrasp_assets.mesh_file import read_mesh_file
from qdgrasp_assets.repair import repaired
from qdgrasp_assets.solidity import MOST, faults
from qdgrasp_assets.units import check_stated
from qdgrasp_protocol.errors import AssetError

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Draft:
    """A mesh file as an object would be made of it."""

    mesh: Mesh
    """In metres, repaired."""
    geometries: int
    """Of the file; they are one object."""
    repairs: tuple[str, ...]
    """What was done to it, in words."""
    faults: tuple[str, ...]
    """What is wrong with it all the same; empty where it can be used."""

    @classmethod
    def unread(cls, why: str) -> "Draft":
        """That of a file that cannot be read."""
        nothing = Mesh(np.zeros((0, 3)), np.zeros((0, 3), dtype=np.int64))
        return cls(nothing, 0, (), (why.rstrip("."),))


def read_draft(path: Path, scale: float | None = None, *, fill_holes: bool = False) -> Draft:
    """A mesh file as an object would be made of it.

    Parameters
    ----------
    scale
        Metres to a unit of the file; None: 1, unless the file says another unit.
    fill_holes
        Whether small holes are filled.

    Raises
    ------
    AssetError
        It is not there, no mesh, empty, or says another unit than it is read in.
    """
    file = read_mesh_file(path)
    check_stated(str(path), file.unit, scale)
    mesh = file.mesh if scale is None else file.mesh.scaled(scale)
    if len(mesh.faces) > MOST:
        return Draft(mesh, file.geometries, (), faults(mesh))
    mesh, repairs = repaired(mesh, fill_holes=fill_holes)
    return Draft(mesh, file.geometries, repairs, faults(mesh))


def read_solid(path: Path, scale: float | None = None) -> Mesh:
    """A closed surface from any mesh file that is read here, in metres; one or several bodies.

    What had to be repaired is told of in a warning.

    Parameters
    ----------
    scale
        Metres to a unit of the file; None: 1.

    Raises
    ------
    AssetError
        As in `read_draft`, or it is of no hand's size, open, wound both ways or flat.
    """
    draft = read_draft(path, scale)
    if draft.faults:
        raise AssetError(f"The mesh '{path}' cannot be used: {'; and '.join(draft.faults)}.")
    if draft.repairs:
        log.warning("The mesh '%s' was repaired: %s.", path, "; ".join(draft.repairs))
    return draft.mesh
