"""Rays at a mesh: how far it is, and how often they leave it and enter it."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from qdgrasp_assets.mesh import Floats, Mesh

BEHIND = np.float32(1e-6)
"""How far behind a triangle the rest of a ray begins [m]."""
FAR = 1.0
"""A mesh is far from its origin from here on [m]."""
DEEPEST = 256
"""So many triangles of a ray are counted, at most."""
SKEW = np.array([0.5403, 0.2919, 0.7891])
"""A direction along which no drawing has its edges."""


def ahead(mesh: Mesh, points: Floats, directions: Floats) -> NDArray[np.float32]:
    """How far it is from points (n, 3) to the mesh in directions (n, 3), unit: (n,) [m]; far if nowhere."""
    middle = _middle(mesh)
    distances: NDArray[np.float32] = _scene(mesh, middle).run(
        (points - middle).astype(np.float32), directions.astype(np.float32), query="DISTANCE"
    )
    return distances


def within(mesh: Mesh, points: Floats, directions: Floats) -> NDArray[np.int64]:
    """How many times over points (n, 3) are inside a closed mesh: (n,); 0 outside.

    Counted is how much more often a ray from each, in directions (n, 3), unit, leaves it than enters it;
    walls nearer to each other than a micrometre count as one.
    """
    middle = _middle(mesh)
    scene, normals = _scene(mesh, middle), mesh.crosses
    found, left = np.zeros(len(points), dtype=np.int64), np.arange(len(points))
    origins, ways = (points - middle).astype(np.float32), directions.astype(np.float32)
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


def _middle(mesh: Mesh) -> Floats:
    """(3,) [m]: what a mesh that lies far from its origin is moved by, as rays have single precision."""
    middle: Floats = np.mean(mesh.bounds, axis=0)
    return middle if np.abs(middle).max() > FAR else np.zeros(3)


def _scene(mesh: Mesh, middle: Floats) -> Any:
    from embreex import rtcore_scene
    from embreex.mesh_construction import TriangleMesh

    scene = rtcore_scene.EmbreeScene(robust=True)
    TriangleMesh(scene, (mesh.corners - middle).astype(np.float32))
    return scene
