"""Genomes of the prior aimed, written in metres and radians."""

import numpy as np
from numpy.typing import NDArray

from qdgrasp_assets.genes import layout
from qdgrasp_assets.scene import Scene

LOOSENESS, CANDIDATES, WEIGHTS, CONSTANT = 7, 8, slice(9, 15), 14


def encoded(scene: Scene, values: NDArray[np.float64]) -> NDArray[np.float32]:
    """Genomes (n, d) that stand for `values` (n, d)."""
    genes = layout(scene, "aimed").genes
    low, high = np.array([gene.low for gene in genes]), np.array([gene.high for gene in genes])
    return ((values - low) / (high - low) * 2 - 1).astype(np.float32)


def facing(
    scene: Scene, n: int, *, candidates: int, looseness: float = 0.0, seed: int = 0
) -> NDArray[np.float64]:
    """Values (n, 15) of genomes that look at surface points from straight above, any roll.

    Their hands are a third into the stand-off, and their weights zero.
    """
    random = np.random.default_rng(seed)
    chosen = random.integers(len(scene.surface_points), size=n)
    low, high = scene.gripper.standoff
    distance = scene.gripper.palm_offset + low + (high - low) / 3
    values = random.uniform(0.0, 1.0, (n, len(layout(scene, "aimed"))))
    values[:, 3:6] = scene.surface_points[chosen]
    values[:, :3] = values[:, 3:6] + distance * scene.surface_normals[chosen]
    values[:, 6] *= 2 * np.pi
    values[:, LOOSENESS], values[:, CANDIDATES], values[:, WEIGHTS] = looseness, candidates, 0.0
    return values
