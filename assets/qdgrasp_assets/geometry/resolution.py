"""Thin walls and small objects, which the simulator and the archives do not resolve."""

from collections.abc import Iterator

import numpy as np

from qdgrasp_assets.geometry.mesh import Floats, Mesh
from qdgrasp_assets.geometry.proximity import ray_distance
from qdgrasp_assets.geometry.surface_points import sample_surface

PART_MARGIN = 1e-3  # Distance outside its surface at which a convex part is met, in both engines [m]
THINNEST = 2 * PART_MARGIN
"""Walls thinner than this consist mostly of the margins of the convex parts on both sides [m]."""
SMALLEST_SIDE = 0.01  # Side of the cells by which archives tell poses apart [m]
MOST_THIN = 0.1  # Share of the surface above which walls are said to be thin; edges of solids have less
WALL_POINTS = 10_000  # Points of the surface at which walls are measured
INWARD = 1e-6  # Offset below the surface at which rays begin, so that they do not meet it again [m]


def thin_share(mesh: Mesh) -> float:
    """Return the share of a closed mesh's surface whose wall is thinner than `THINNEST`."""
    points, drawn = sample_surface(mesh, WALL_POINTS, seed=0)
    inward = -mesh.normals[drawn]
    walls = ray_distance(mesh, points + INWARD * inward, inward)
    return float((walls < THINNEST).mean())


def resolution_notes(extents: Floats, thin: float) -> Iterator[str]:
    """Yield what is said of an object of these extents (3,) [m] with a share of thin walls."""
    if thin > MOST_THIN:
        yield (
            f"{100 * thin:.0f} % of its surface is of walls thinner than {1000 * THINNEST:g} mm, and the "
            f"simulator meets its parts {1000 * PART_MARGIN:g} mm outside their surface: these walls are met "
            "more than twice as thick as they are"
        )
    if (largest := float(np.max(extents))) < SMALLEST_SIDE:
        met = largest + 2 * PART_MARGIN
        yield (
            f"it is {1000 * largest:.1f} mm large, smaller than the cells of {1000 * SMALLEST_SIDE:g} mm by "
            f"which grasps are told apart, and the simulator meets it as if it were {1000 * met:.1f} mm large"
        )
