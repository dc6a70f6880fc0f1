"""Genomes of a scene, and what decoding and evaluating them finds."""

from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray
from tests.common import PATIENCE

from qdgrasp_assets.genes import layout
from qdgrasp_assets.scene import Scene
from qdgrasp_protocol.rows import RESULT, Outcome, Rows, pack
from qdgrasp_worker.decoder import DecodedGrasps, Decoder
from qdgrasp_worker.evaluator import Evaluator
from qdgrasp_worker.object_geometry import ObjectSurface

Genomes = NDArray[np.float32]
T = TypeVar("T")
NEAR = (-1.0, -0.5)
"""Genes nu and d of genomes that look straight at the surface from near by."""
HANDS = ["panda", "barrett", "allegro", "shadow", "robotiq_2f"]
REFERENCE = [f"ref_{name}" for name in ("panda_2f", "bh280", "allegro", "shadow", "robotiq_2f")]
LOOSENESS, CANDIDATES, WEIGHTS, CONSTANT = 7, 8, slice(9, 15), 14
"""Genes of the prior aimed."""


def draw(n: int, genes: int = 7, seed: int = 0, near: int = 0) -> Genomes:
    """Genomes drawn uniformly; `near` of them look straight at the surface, often grasps."""
    genomes = np.random.default_rng(seed).uniform(-1.0, 1.0, (n, genes)).astype(np.float32)
    if near:
        genomes[:near, 3:5] = NEAR
    return genomes


def decoded(scene: Scene, prior: str, genomes: Genomes) -> DecodedGrasps:
    return Decoder(scene, prior, ObjectSurface(scene))(genomes)


def evaluated(
    scene: Scene, prior: str, genomes: Genomes, trials: object = 0, batch: int = 1000, shortcuts: bool = True
) -> Rows:
    """The rows of genomes in their trials, evaluated in batches of that size; none fails."""
    trials = np.broadcast_to(np.asarray(trials, np.uint16), len(genomes))
    with Evaluator(scene, shortcuts=shortcuts) as evaluator:
        parts = [
            evaluator.evaluate(prior, genomes[i : i + batch], trials[i : i + batch])
            for i in range(0, len(genomes), batch)
        ]
    assert not any(part.failures for part in parts)
    return np.concatenate([part.rows for part in parts])


def results(rows: Rows, *but: str) -> dict[str, bytes]:
    """The bytes of all result columns but these."""
    return pack(rows, [column for column in RESULT if column.name not in but])


def outcomes(rows: Rows) -> list[Outcome]:
    return [Outcome(value) for value in rows["outcome"]]


def elsewhere(act: Callable[..., T], *arguments: object) -> T:
    """Call a function in a process of its own."""
    with ProcessPoolExecutor(1, get_context("spawn")) as pool:
        return pool.submit(act, *arguments).result(PATIENCE)


def encoded(scene: Scene, values: NDArray[np.float64]) -> Genomes:
    """Genomes (n, d) of the prior aimed that stand for `values` (n, d) [m or rad]."""
    genes = layout(scene, "aimed").genes
    low, high = np.array([gene.low for gene in genes]), np.array([gene.high for gene in genes])
    return ((values - low) / (high - low) * 2 - 1).astype(np.float32)


def facing(
    scene: Scene, n: int, *, candidates: int, looseness: float = 0.0, seed: int = 0
) -> NDArray[np.float64]:
    """Values (n, 15) of genomes of the prior aimed that look straight at surface points.

    Their hands are a third into the stand-off, at any roll, and their weights zero.
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
