"""Rays at meshes: distances, containment of points, and walls too thin for the simulator."""

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from qdgrasp_assets.geometry.mesh import Floats, Mesh
from qdgrasp_assets.geometry.surface_points import sample_surface

RAY_RESTART = np.float32(1e-6)  # Offset behind a hit triangle at which the rest of a ray begins [m]
MOST_HITS = 256  # Most triangles of a ray that are counted
SKEW_DIRECTION = np.array([0.5403, 0.2919, 0.7891])
"""Direction of rays; oblique, so that it is hardly parallel to edges of a drawing."""


def ray_distance(mesh: Mesh, points: Floats, directions: Floats) -> NDArray[np.float32]:
    """Return the distances (n,) [m] from points (n, 3) to the mesh along unit directions (n, 3)."""
    middle = mesh.reference_point
    distances: NDArray[np.float32] = ray_scene(mesh.corners - middle).run(
        (points - middle).astype(np.float32), directions.astype(np.float32), query="DISTANCE"
    )
    return distances


def inside_count(mesh: Mesh, points: Floats, directions: Floats = SKEW_DIRECTION) -> NDArray[np.int64]:
    """Return the times (n,) that points (n, 3) are inside a closed mesh; 0 outside.

    That is how much more often a ray from each, in unit directions (n, 3) or (3,), leaves it than enters it;
    walls nearer to each other than a micrometre count as one.
    """
    middle = mesh.reference_point
    scene, normals = ray_scene(mesh.corners - middle), mesh.crosses
    found, left = np.zeros(len(points), dtype=np.int64), np.arange(len(points))
    origins = (points - middle).astype(np.float32)
    ways = np.broadcast_to(directions, points.shape).astype(np.float32)
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


def ray_scene(corners: Floats) -> Any:
    """Return embree's scene of triangles (n, 3, 3) [m], for casting rays."""
    from embreex import rtcore_scene
    from embreex.mesh_construction import TriangleMesh

    scene = rtcore_scene.EmbreeScene(robust=True)
    TriangleMesh(scene, corners.astype(np.float32))
    return scene


PART_MARGIN = 1e-3  # Distance outside its surface at which a convex part is met, in both engines [m]
THINNEST = 2 * PART_MARGIN
"""Walls thinner than this consist mostly of the margins of the convex parts on both sides [m]."""
SMALLEST_SIDE = 0.01  # Side of the cells by which archives tell poses apart [m]
MOST_THIN = 0.1  # Share of the surface above which walls are said to be thin; edges of solids have less
WALL_POINTS = 10_000  # Points of the surface at which walls are measured
INWARD = 1e-6  # Offset below the surface at which rays begin, so that they do not meet it again [m]


def resolution_notes(mesh: Mesh) -> Iterator[str]:
    """Yield what of a closed mesh is too thin or small for the simulator to resolve."""
    points, drawn = sample_surface(mesh, WALL_POINTS, seed=0)
    inward = -mesh.normals[drawn]
    thin = float((ray_distance(mesh, points + INWARD * inward, inward) < THINNEST).mean())
    if thin > MOST_THIN:
        yield (
            f"{100 * thin:.0f} % of its surface is of walls thinner than {1000 * THINNEST:g} mm, and the "
            f"simulator meets its parts {1000 * PART_MARGIN:g} mm outside their surface: these walls are met "
            "more than twice as thick as they are"
        )
    if (largest := float(mesh.extents.max())) < SMALLEST_SIDE:
        met = largest + 2 * PART_MARGIN
        yield (
            f"it is {1000 * largest:.1f} mm large, smaller than the cells of {1000 * SMALLEST_SIDE:g} mm by "
            f"which grasps are told apart, and the simulator meets it as if it were {1000 * met:.1f} mm large"
        )
