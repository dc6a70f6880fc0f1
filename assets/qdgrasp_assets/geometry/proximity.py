"""Proximity queries on meshes: ray casts, containment of points, surface distance.

The distance of two surfaces is looked at ever more finely, where they may be nearest.
"""

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from qdgrasp_assets.geometry.mesh import Floats, Mesh

RAY_RESTART = np.float32(1e-6)  # Offset behind a hit triangle at which the rest of a ray begins [m]
FAR_FROM_ORIGIN = 1.0  # Distance from its origin beyond which a mesh is moved before rays are cast [m]
MOST_HITS = 256  # Most triangles of a ray that are counted
SKEW_DIRECTION = np.array([0.5403, 0.2919, 0.7891])
"""Direction of rays; oblique, so that it is hardly parallel to edges of a drawing."""


def ray_distance(mesh: Mesh, points: Floats, directions: Floats) -> NDArray[np.float32]:
    """Return the distances (n,) [m] from points (n, 3) to the mesh along unit directions (n, 3)."""
    middle = _mesh_middle(mesh)
    distances: NDArray[np.float32] = ray_scene(mesh.corners - middle).run(
        (points - middle).astype(np.float32), directions.astype(np.float32), query="DISTANCE"
    )
    return distances


def inside_count(mesh: Mesh, points: Floats, directions: Floats) -> NDArray[np.int64]:
    """Return the times (n,) that points (n, 3) are inside a closed mesh; 0 outside.

    That is how much more often a ray from each, in unit directions (n, 3), leaves it than enters it; walls
    nearer to each other than a micrometre count as one.
    """
    middle = _mesh_middle(mesh)
    scene, normals = ray_scene(mesh.corners - middle), mesh.crosses
    found, left = np.zeros(len(points), dtype=np.int64), np.arange(len(points))
    origins, ways = (points - middle).astype(np.float32), directions.astype(np.float32)
    for _ in range(MOST_HITS):
        hit = scene.run(origins, ways, query="INTERSECT", output=True)
        met = hit["primID"] >= 0
        if not met.any():
            break
        left, ways = left[met], ways[met]
        origins = origins[met] + (hit["tfar"][met, None] + RAY_RESTART) * ways
        leaving = np.einsum("ij,ij->i", normals[hit["primID"][met]], ways)
        found[left] += np.sign(leaving).astype(np.int64)
    return found


def _mesh_middle(mesh: Mesh) -> Floats:
    """Return the offset (3,) [m] of a mesh far from its origin, as rays have single precision."""
    middle: Floats = np.mean(mesh.bounds, axis=0)
    return middle if np.abs(middle).max() > FAR_FROM_ORIGIN else np.zeros(3)


def ray_scene(corners: Floats) -> Any:
    """Return embree's scene of triangles (n, 3, 3) [m], for casting rays."""
    from embreex import rtcore_scene
    from embreex.mesh_construction import TriangleMesh

    scene = rtcore_scene.EmbreeScene(robust=True)
    TriangleMesh(scene, corners.astype(np.float32))
    return scene


MOST_PIECES = 200_000  # Most pieces of triangles in `come_within`, which is undecided with more
ENOUGH_PIECES = 50_000  # Most pieces in `surface_distance`, which is not refined further
FINEST_PIECE = 1e-6  # Size of the smallest pieces [m]
ACCURACY = 0.3  # Relative accuracy of a distance
SLACK = 0.1  # Relative error allowed in the search for the nearest piece, for speed


def come_within(first: Floats, second: Floats, distance: float) -> bool:
    """Return whether two surfaces of triangles (n, 3, 3) [m] come within a distance [m].

    True also where they are a little farther apart over so large a surface that it stays undecided.
    """
    for least, most in _distance_bounds(first, second, MOST_PIECES, limit=distance):
        if most <= distance:
            return True
        if least > distance:
            return False
    return True


def surface_distance(first: Floats, second: Floats) -> float:
    """Return the distance of two surfaces that do not touch [m], or a little more."""
    found = np.inf
    for least, most in _distance_bounds(first, second, ENOUGH_PIECES, slack=SLACK):
        found = most
        if most - least <= ACCURACY * most:
            break
    return found


def _distance_bounds(
    first: Floats, second: Floats, pieces: int, *, limit: float = np.inf, slack: float = 0.0
) -> Iterator[tuple[float, float]]:
    """Yield ever closer bounds of the distance [m], until more than `pieces` are left.

    Surfaces are cut into pieces that are small enough for the next bounds, and those left out that are
    farther from the other surface than the two are from each other, or than `limit`, beyond which
    distances are infinite.
    """
    size = float(max(np.ptp(each.reshape(-1, 3), axis=0).max() for each in (first, second)))
    is_open = True
    while is_open:
        size /= 2
        first, second = _cut(first, size), _cut(second, size)
        one, other = first.mean(axis=1), second.mean(axis=1)
        error = _piece_radius(first) + _piece_radius(second)
        far = (1 + slack) * (limit + error)
        there, back = _away(one, other, slack, far), _away(other, one, slack, far)
        most = float(min(there.min(), back.min()))
        yield max(0.0, most / (1 + slack) - error), most
        far = (1 + slack) * (min(most, limit) + error)
        first, second = first[there <= far], second[back <= far]
        is_open = len(first) + len(second) <= pieces and size > FINEST_PIECE


def _away(points: Floats, others: Floats, slack: float, far: float) -> Floats:
    """Return the distances (n,) [m] from points to the nearest of others, infinite beyond `far`."""
    from scipy.spatial import KDTree

    return np.asarray(KDTree(others).query(points, eps=slack, distance_upper_bound=far)[0])


def _piece_radius(pieces: Floats) -> float:
    """Return the largest distance of a point of a piece from the piece's middle [m]."""
    return float(np.linalg.norm(pieces - pieces.mean(axis=1, keepdims=True), axis=2).max())


def _cut(triangles: Floats, size: float) -> Floats:
    """Return the surface (n, 3, 3) in triangles whose edges are no longer than `size`."""
    small = []
    while len(triangles):
        edges = np.linalg.norm(np.roll(triangles, -1, axis=1) - triangles, axis=2)
        is_small = edges.max(axis=1) <= size
        small.append(triangles[is_small])
        large, longest = triangles[~is_small], edges[~is_small].argmax(axis=1)
        a, b, c = (large[np.arange(len(large)), (longest + turn) % 3] for turn in range(3))
        middle = (a + b) / 2  # of the longest edge, where each is cut in two
        triangles = np.concatenate([np.stack([a, middle, c], axis=1), np.stack([middle, b, c], axis=1)])
    return np.concatenate(small)
