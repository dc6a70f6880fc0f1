"""Surface points S_c: points on an object with normals (Huber et al. 2024, section III-B)."""

import numpy as np
from numpy.typing import NDArray

from qdgrasp_assets.geometry.mesh import Floats, Mesh
from qdgrasp_assets.scene import SurfacePoints, vector

POINTS_PER_METRE = 10_000  # "2000 points per 0.2 m of the diagonal of the object's bounding box"
BULLET_MARGIN = 0.004  # m: what Bullet adds on each side of a compound of convex hulls at load
CHUNK = 1 << 17  # pairs of point and triangle that are compared at once: about 100 MB


def packed_points(mesh: Mesh, points: Floats, normals: Floats, low: Floats, high: Floats) -> SurfacePoints:
    """Return points (n, 3) [m] on a mesh with their unit normals (n, 3), CoM frame.

    `low` and `high` (3,) [m] are the corners of the box that the contact point finder is drawn from.
    """
    object_low, object_high = mesh.bounds
    return SurfacePoints(
        points=points.astype("<f4").tobytes(),
        normals=normals.astype("<f4").tobytes(),
        finder_low=vector(low),
        finder_high=vector(high),
        object_low=vector(object_low),
        object_high=vector(object_high),
    )


def paper_surface(mesh: Mesh, parts: tuple[Mesh, ...], com_in_mesh: Floats, seed: int) -> SurfacePoints:
    """Sample the surface points as the paper describes.

    2000 points per 0.2 m of the diagonal of the bounding box, area-uniform, each with the normal of the
    triangle it was drawn from; the finder is drawn from the object's own bounding box. `mesh` and `parts`
    are in the CoM frame; `parts` and `com_in_mesh` play no role here.
    """
    low, high = mesh.bounds
    points, drawn = sample_surface(mesh, int(POINTS_PER_METRE * np.linalg.norm(high - low)), seed)
    return packed_points(mesh, points, mesh.normals[drawn], low, high)


def released_surface(mesh: Mesh, parts: tuple[Mesh, ...], com_in_mesh: Floats, seed: int) -> SurfacePoints:
    """Sample the surface points as the authors' code does, with our own seeded sampler.

    Their number of points follows from the norm of both corners of the box instead of its diagonal; normals
    are those of the nearest triangle of the collision mesh, faces between convex parts included; and the
    finder's box is the collision parts' in the *mesh* frame, although the points are in the CoM frame.
    """
    collision = [part.bounds for part in parts]
    low = np.min([corner for corner, _ in collision], axis=0) + com_in_mesh - BULLET_MARGIN
    high = np.max([corner for _, corner in collision], axis=0) + com_in_mesh + BULLET_MARGIN
    points, _ = sample_surface(mesh, int(POINTS_PER_METRE * np.sqrt(low @ low + high @ high)), seed)
    triangles = np.concatenate([part.corners for part in parts])
    normals = np.concatenate([part.normals for part in parts])
    return packed_points(mesh, points, normals[nearest_triangle(points, triangles)], low, high)


SURFACES = dict.fromkeys(("paper", "robust", "physical", "lift"), paper_surface) | {
    "released": released_surface
}


def sample_surface(mesh: Mesh, n: int, seed: int) -> tuple[Floats, NDArray[np.int64]]:
    """Draw `n` points (n, 3) [m] uniformly by area, with the face (n,) that each is from."""
    random = np.random.default_rng(seed)
    cumulated = np.cumsum(mesh.areas)
    drawn = np.searchsorted(cumulated[:-1], random.random(n) * cumulated[-1], side="right")
    root, share = np.sqrt(random.random(n)), random.random(n)
    weights = np.stack([1 - root, root * (1 - share), root * share], axis=1)
    points: Floats = np.einsum("nk,nkc->nc", weights, mesh.corners[drawn])
    return points, drawn


def nearest_triangle(points: Floats, triangles: Floats) -> NDArray[np.int64]:
    """Return the triangle nearest to each point, exactly; the first of equals.

    `points` (n, 3), `triangles` (t, 3, 3); the result (n,) are indices of triangles.
    """
    from trimesh.triangles import closest_point  # slow to import

    rows, nearest = max(1, CHUNK // len(triangles)), []
    for start in range(0, len(points), rows):
        block = points[start : start + rows].repeat(len(triangles), axis=0)
        tiled = np.tile(triangles, (len(block) // len(triangles), 1, 1))
        offsets = block - closest_point(tiled, block)  # type: ignore[no-untyped-call]  # of trimesh
        nearest.append(np.einsum("nc,nc->n", offsets, offsets).reshape(-1, len(triangles)).argmin(axis=1))
    return np.concatenate(nearest)
