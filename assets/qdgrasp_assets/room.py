"""The room around an object: where a finger finds space, and how much of it convex parts would fill.

Convex parts stand for a mesh in the simulator. What they fill beyond it, no finger can reach: the hollow of
a mug and the eye of its handle are what most of its grasps need
(docs/decisions/0008-collision-decomposition.md).
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from qdgrasp_assets.mesh import Floats, Mesh
from qdgrasp_assets.objects.solids import heights
from qdgrasp_assets.rays import ahead, within
from qdgrasp_assets.surface import sample

POINTS = 10_000
AHEAD = 3e-3
"""How far in front of the surface room is looked for [m]."""
CLEAR = 2 * AHEAD
"""The next surface in front must be as far as this [m]: no finger enters a narrower gap."""
OFF = 2e-3
"""A part's surface may be so far behind the mesh's [m]."""
LIFT = 1e-6
"""How far above the surface rays begin, so that they do not meet it again [m]."""
OUT = 1e-5
"""So far in front of the surface it is looked whether that is inside [m]."""
FEW = 1e-3
"""A smaller share of the surface that seems to be inside is rounding."""
PAIRS = 1 << 26
"""Pairs of point and face that are compared at once: half a gigabyte."""
MOST = 0.01
"""Of the surface; the eye of a mug's handle, filled, is 2 %."""


@dataclass(frozen=True)
class Fit:
    """How well convex parts stand for a mesh, in shares of its surface."""

    filled: float
    """In front of which there is room, and the parts fill it."""
    bare: float
    """That all parts are behind."""

    @property
    def is_good(self) -> bool:
        """Whether the parts change few verdicts."""
        return max(self.filled, self.bare) <= MOST


class Room:
    """The room in front of the surface of a mesh."""

    def __init__(self, mesh: Mesh) -> None:
        self._mesh = mesh
        self._points, drawn = sample(mesh, POINTS, seed=0)
        self._normals = mesh.normals[drawn]

    def fit(self, parts: tuple[Mesh, ...]) -> Fit:
        """How well convex `parts`, in the frame of the mesh, stand for it."""
        filled = np.any([is_within(part, self._free, 0.0) for part in parts], axis=0)
        covered = np.any([is_within(part, self._points, OFF) for part in parts], axis=0)
        return Fit(float(filled.mean()) if len(filled) else 0.0, float(1.0 - covered.mean()))

    @property
    def inside(self) -> float:
        """The share of the surface that is inside the mesh, where it cuts itself or bodies overlap."""
        share = float(self._inside.mean())
        return share if share > FEW else 0.0

    @cached_property
    def _inside(self) -> NDArray[np.bool_]:
        """(n,): which points have not room in front of them, but the mesh."""
        return within(self._mesh, self._points + OUT * self._normals, self._normals) > 0

    @cached_property
    def _free(self) -> Floats:
        """Points (n, 3) [m], `AHEAD` in front of the surface, where there is room."""
        clear = ahead(self._mesh, self._points + LIFT * self._normals, self._normals) > CLEAR
        if self.inside:
            clear &= ~self._inside
        free: Floats = self._points[clear] + AHEAD * self._normals[clear]
        return free


def is_within(part: Mesh, points: Floats, margin: float) -> NDArray[np.bool_]:
    """Which of the points (n, 3) are in a convex part or, by its planes, within `margin` of it [m]: (n,)."""
    low, high = part.bounds
    within: NDArray[np.bool_] = np.all((points >= low - margin) & (points <= high + margin), axis=1)
    near = points[within]
    rows = max(1, PAIRS // len(part.faces))
    blocks = [near[start : start + rows] for start in range(0, len(near), rows)] or [near]
    within[within] = np.concatenate([(heights(part, block) <= margin).all(axis=1) for block in blocks])
    return within
