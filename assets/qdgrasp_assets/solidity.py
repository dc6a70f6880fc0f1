"""Whether a mesh encloses a space: all that is wrong with it, in words."""

import numpy as np
from numpy.typing import NDArray

from qdgrasp_assets.mesh import FLATTEST, LARGEST, Mesh


def faults(mesh: Mesh) -> tuple[str, ...]:
    """All that is wrong with a mesh as a surface in metres; empty when nothing is."""
    if not np.isfinite(mesh.vertices).all():
        return ("it has vertices that are not finite",)
    checks = (_too_large(mesh), _open(mesh), _wound(mesh), _inside_out(mesh))
    return tuple(found for found in checks if found)


def _too_large(mesh: Mesh) -> str:
    largest = mesh.extents.max()
    if largest <= LARGEST:
        return ""
    return f"it is {largest:.4g} m large, which looks like millimetres: scale it by 0.001"


def _open(mesh: Mesh) -> str:
    _, times = np.unique(np.sort(_edges(mesh), axis=1), axis=0, return_counts=True)
    loose = int((times == 1).sum())
    if loose:
        return f"it is not watertight: {loose} edges have only one triangle; close its holes"
    crowded = int((times % 2 == 1).sum())
    return f"it is not watertight: {crowded} edges have an odd number of triangles" if crowded else ""


def _wound(mesh: Mesh) -> str:
    """Two neighbours wound alike run along their edge in opposite directions."""
    _, times = np.unique(_edges(mesh), axis=0, return_counts=True)
    twice = int((times > 1).sum())
    return (
        f"its triangles are wound both ways along {twice} edges; make all of them face outward"
        if twice
        else ""
    )


def _inside_out(mesh: Mesh) -> str:
    if abs(mesh.volume) < FLATTEST:
        return "it is flat: it encloses no volume"
    if mesh.volume < 0:
        return "it is inside out: its volume is negative (it is turned when it is used)"
    return ""


def _edges(mesh: Mesh) -> NDArray[np.int64]:
    """(3 f, 2): each triangle's edges, in its direction."""
    return np.concatenate([mesh.faces[:, [0, 1]], mesh.faces[:, [1, 2]], mesh.faces[:, [2, 0]]])
