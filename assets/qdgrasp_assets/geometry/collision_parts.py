"""Convex collision parts of a mesh: as few as leave a finger its clearance.

One hull where that will do, else parts by cuts (docs/decisions/0008-collision-decomposition.md). A finger
cannot reach space that the parts fill beyond the mesh: most grasps of a mug need its hollow and the eye of
its handle. The parts follow from the mesh alone.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from itertools import product

import numpy as np
from numpy.typing import NDArray

from qdgrasp_assets.geometry.convex_decomposition import cut_parts
from qdgrasp_assets.geometry.mesh import Floats, Mesh, heights, hull
from qdgrasp_assets.geometry.proximity import inside_count, ray_distance
from qdgrasp_assets.geometry.surface_points import sample_surface

CLEARANCE_POINTS = 10_000
AHEAD = 3e-3  # Distance in front of the surface at which free space is checked [m]
CLEAR = 2 * AHEAD  # Least free distance in front [m]: no finger enters a narrower gap
OFF = 2e-3  # Largest distance of a part's surface behind the mesh's [m]
LIFT = 1e-6  # Offset above the surface at which rays begin, so that they do not meet it again [m]
OUT = 1e-5  # Offset in front of the surface of the points tested for being inside [m]
FEW = 1e-3  # Share of the surface that seems to be inside below which it is rounding
PAIRS = 1 << 26  # Pairs of point and face that are compared at once: half a gigabyte
MOST = 0.01  # Largest share of the surface that is wrong in a good fit; a mug's handle, filled: 2 %
AIM = 0.004  # Share at which cutting ends: of fewer points, and before corners are left out


@dataclass(frozen=True)
class PartsFit:
    """Quality of convex parts as a stand-in for a mesh, in shares of its surface."""

    filled: float
    """Share in front of which the parts fill free space."""
    bare: float
    """Share that is outside all parts."""

    @property
    def is_good(self) -> bool:
        """True if the parts change few outcomes."""
        return max(self.filled, self.bare) <= MOST


class FingerClearance:
    """The free space in front of the surface of a mesh."""

    def __init__(self, mesh: Mesh) -> None:
        self._mesh = mesh
        self._points, drawn = sample_surface(mesh, CLEARANCE_POINTS, seed=0)
        self._normals = mesh.normals[drawn]

    def fit(self, parts: tuple[Mesh, ...]) -> PartsFit:
        """Return the fit of convex `parts`, in the frame of the mesh."""
        covered = np.any([is_within(part, self._points, OFF) for part in parts], axis=0)
        return PartsFit(self.filled(parts), float(1.0 - covered.mean()))

    def filled(self, parts: tuple[Mesh, ...]) -> float:
        """Return the share of the free space in front of the surface that convex `parts` fill."""
        is_filled = np.any([is_within(part, self.free[0], 0.0) for part in parts], axis=0)
        return float(is_filled.mean()) if len(is_filled) else 0.0

    @property
    def inside(self) -> float:
        """Share of the surface that is inside the mesh, where it cuts itself or bodies overlap."""
        share = float(self._inside.mean())
        return share if share > FEW else 0.0

    @cached_property
    def _inside(self) -> NDArray[np.bool_]:
        """(n,): True for points that have the mesh's inside in front of them."""
        return inside_count(self._mesh, self._points + OUT * self._normals, self._normals) > 0

    @cached_property
    def free(self) -> tuple[Floats, Floats]:
        """Points (n, 3) [m] `AHEAD` of the surface in free space, and its normals there."""
        clear = ray_distance(self._mesh, self._points + LIFT * self._normals, self._normals) > CLEAR
        if self.inside:
            clear &= ~self._inside
        normals = self._normals[clear]
        return self._points[clear] + AHEAD * normals, normals


def is_within(part: Mesh, points: Floats, margin: float) -> NDArray[np.bool_]:
    """Return a mask (n,) of the points within `margin` [m] of a convex part, by its planes."""
    low, high = part.bounds
    within: NDArray[np.bool_] = np.all((points >= low - margin) & (points <= high + margin), axis=1)
    near = points[within]
    rows = max(1, PAIRS // len(part.faces))
    blocks = [near[start : start + rows] for start in range(0, len(near), rows)] or [near]
    within[within] = np.concatenate([(heights(part, block) <= margin).all(axis=1) for block in blocks])
    return within


CORNER_TOLERANCE = 5e-4  # A corner that is not farther outside the hull of others is left out [m]
MOST_CORNERS = 128  # Most corners of a part
OUTWARD_DIRECTIONS = np.array([*np.eye(3), *-np.eye(3), *product((-1.0, 1.0), repeat=3)])
"""The directions in which a part keeps its extent, in the unit cube."""


def decompose(mesh: Mesh, space: FingerClearance, filled: float = AIM) -> tuple[Mesh, ...]:
    """Decompose a mesh into convex parts that together fill it, with few corners each.

    They are in the mesh's frame, and fill the room in front of about `filled` of its surface at most, of
    which `space` is the free space.
    """
    return tuple(simplify_part(hull(corners)) for corners in cut_parts(mesh, *space.free, filled))


def simplify_part(part: Mesh) -> Mesh:
    """Simplify a convex part so that no corner left out is farther outside than the tolerance.

    Greedy: it begins with the corners that are farthest in a few directions, and adds the one that is
    farthest outside the hull so far, until all are within the tolerance, or it has `MOST_CORNERS`.
    """
    corners, kept = part.vertices, _outermost(part.vertices)
    left = np.arange(len(corners))
    while True:
        found = hull(corners[kept])
        blocks = np.array_split(corners[left], 1 + len(left) * len(found.faces) // PAIRS)
        outside = np.concatenate([heights(found, block).max(axis=1) for block in blocks])
        is_outside = outside > CORNER_TOLERANCE
        if len(kept) >= MOST_CORNERS or not (is_outside.any() or len(left) < len(corners)):
            return found
        if is_outside.any():
            kept.append(int(left[outside.argmax()]))
        # most of the others stay within the tolerance while the hull grows: they are compared again at last
        left = left[is_outside] if is_outside.any() else np.arange(len(corners))


def _outermost(corners: Floats) -> list[int]:
    """Return the indices of some outermost corners of a solid (v, 3), not all in one plane."""
    places = (corners / np.ptp(corners, axis=0) @ OUTWARD_DIRECTIONS.T).argmax(axis=0)
    some = corners[places]
    across = corners @ np.linalg.svd(some - some.mean(axis=0))[2][-1]
    return sorted({*places.tolist(), int(across.argmin()), int(across.argmax())})


Tell = Callable[[str], None]


def ignore_progress(_sentence: str) -> None:
    """Ignore a progress message."""


def collision_parts(mesh: Mesh) -> tuple[str, tuple[Mesh, ...]]:
    """Return the source, "own hull" or "cuts", and the convex parts that stand for a mesh.

    `mesh` is a closed surface [m], one or several bodies. The parts are in its frame, and follow from the
    mesh alone. Where none fit, the finest are taken.
    """
    space, own = FingerClearance(mesh), hull(mesh.vertices)
    # convex for a finger: the hull leaves the same free space
    if space.filled((own,)) <= MOST:
        return "own hull", (simplify_part(own),)
    return "cuts", decompose(mesh, space)
