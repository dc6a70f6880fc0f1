"""Genomes of a scene, and their decoded poses and rows."""

from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from tests.common import PATIENCE

from qdgrasp_assets.geometry.object_surface import ObjectSurface
from qdgrasp_assets.scene import Scene
from qdgrasp_protocol.rows import RESULT, Outcome, Rows, pack
from qdgrasp_worker.decoder import DecodedGrasps, Decoder
from qdgrasp_worker.evaluator import Evaluator

Genomes = NDArray[np.float32]
T = TypeVar("T")
NEAR = (-1.0, -0.5)
"""Genes nu and d of genomes that look straight at the surface from near by."""
HANDS = ["panda", "barrett", "allegro", "shadow", "robotiq_2f"]


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


def side_of(scene: Scene) -> NDArray[np.float64]:
    """The normal (3,) of an upright side of a cube."""
    normals = scene.surface_normals.astype(np.float64)
    side: NDArray[np.float64] = normals[np.abs(normals[:, 2]).argmin()]
    return side


def above(
    scene: Scene, along: float = 0.0, aside: float = 0.0, height: float = 0.1, roll: float = 0.0
) -> list[float]:
    """The Panda's pose over a cube, looking down: its fingers are before a side and the opposite one.

    It is moved from the middle along the line of its fingers, or aside, or rolled [m, rad].
    """
    x, y, _ = side_of(scene)
    turn = Rotation.from_euler("z", np.arctan2(x, -y) + roll) * Rotation.from_euler("x", np.pi)
    return [along * x - aside * y, along * y + aside * x, height, *turn.as_quat().tolist()]
