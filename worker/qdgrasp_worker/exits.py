"""Where rays leave a mesh: Möller and Trumbore 1997, for every ray and triangle, in float64.

Only products, sums and quotients of columns, whose bits are the same on every processor: rays of a library
in float32 could take another triangle elsewhere. It is done once for each surface point of a scene.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from qdgrasp_assets.rotation import Floats, dot

NEAREST = 1e-4  # m: an exit nearer than this is the surface that the ray starts on
EDGE = 1e-9  # how far beyond an edge still counts, so that no ray slips between two triangles
CHUNK = 1 << 17  # pairs of ray and triangle that are looked at at once: they fit in the cache


class Exits(NamedTuple):
    """Where rays leave a mesh for the last time."""

    distances: Floats
    """(n,) [m]; NaN where a ray does not leave it within the length."""
    triangles: NDArray[np.intp]
    """(n,): which triangle it leaves through; any where there is none."""


def last_exits(origins: Floats, directions: Floats, corners: Floats, length: float) -> Exits:
    """The last exits along rays from `origins` (n, 3) [m] in unit `directions` (n, 3).

    Parameters
    ----------
    corners
        (t, 3, 3) [m]: the triangles of a closed mesh, wound outward.
    length
        How far an exit may be [m].
    """
    rows = max(1, CHUNK // len(corners))
    starts = range(0, len(origins), rows)
    parts = [_last(origins[i : i + rows], directions[i : i + rows], corners, length) for i in starts]
    return Exits(
        np.concatenate([part.distances for part in parts]), np.concatenate([part.triangles for part in parts])
    )


def _last(origins: Floats, directions: Floats, corners: Floats, length: float) -> Exits:
    found = _exits(origins[:, None], directions[:, None], corners)
    found[~((found > NEAREST) & (found <= length))] = -np.inf
    triangles = found.argmax(axis=1)
    distances = found[np.arange(len(found)), triangles]
    return Exits(np.where(np.isfinite(distances), distances, np.nan), triangles)


def _exits(origins: Floats, directions: Floats, corners: Floats) -> Floats:
    """(n, t): how far along each ray (n, 1, 3) it leaves through each triangle; NaN where it does not."""
    first, second, third = np.moveaxis(corners, 1, 0)
    one, other = second - first, third - first
    across = cross(directions, other)
    volume = dot(across, one)  # negative where the ray goes with the normal: outward
    with np.errstate(divide="ignore", invalid="ignore"):
        offset = origins - first
        u = dot(offset, across) / volume
        around = cross(offset, one)
        v = dot(directions, around) / volume
        distances = dot(other, around) / volume
        through = (volume < 0) & (u >= -EDGE) & (v >= -EDGE) & (u + v <= 1 + EDGE)
    return np.where(through, distances, np.nan)


def cross(a: Floats, b: Floats) -> Floats:
    """The vector products of vectors (..., 3)."""
    (ax, ay, az), (bx, by, bz) = (np.moveaxis(vectors, -1, 0) for vectors in (a, b))
    return np.stack([ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx], axis=-1)
