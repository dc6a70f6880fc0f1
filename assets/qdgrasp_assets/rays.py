"""Rays at a mesh: how far it is, and how often they leave it and enter it."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from qdgrasp_assets.mesh import Floats, Mesh

BEHIND = np.float32(1e-6)
"""How far behind a triangle the rest of a ray begins [m]."""
DEEPEST = 256
"""So many triangles of a ray are counted, at most."""


def ahead(mesh: Mesh, points: Floats, directions: Floats) -> NDArray[np.float32]:
    """How far it is from points (n, 3) to the mesh in directions (n, 3), unit: (n,) [m]; far if nowhere."""
    distances: NDArray[np.float32] = _scene(mesh).run(
        points.astype(np.float32), directions.astype(np.float32), query="DISTANCE"
    )
    return distances


def within(mesh: Mesh, points: Floats, directions: Floats) -> NDArray[np.int64]:
    """How many times over points (n, 3) are inside a closed mesh: (n,); 0 outside.

    Counted is how much more often a ray from each, in directions (n, 3), unit, leaves it than enters it.
    """
    scene, normals = _scene(mesh), mesh.crosses
    found, left = np.zeros(len(points), dtype=np.int64), np.arange(len(points))
    origins, ways = points.astype(np.float32), directions.astype(np.float32)
    for _ in range(DEEPEST):
        hit = scene.run(origins, ways, query="INTERSECT", output=True)
        met = hit["primID"] >= 0
        if not met.any():
            break
        left, ways = left[met], ways[met]
        origins = origins[met] + (hit["tfar"][met, None] + BEHIND) * ways
        leaving = np.einsum("ij,ij->i", normals[hit["primID"][met]], ways)
        found[left] += np.sign(leaving).astype(np.int64)
    return found


def _scene(mesh: Mesh) -> Any:
    from embreex import rtcore_scene
    from embreex.mesh_construction import TriangleMesh

    scene = rtcore_scene.EmbreeScene(robust=True)
    TriangleMesh(scene, mesh.corners.astype(np.float32))
    return scene
