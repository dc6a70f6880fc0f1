"""Scenes and genomes that the worker's tests share, as building a scene takes long."""

from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from qdgrasp_assets.catalog import build_scene
from qdgrasp_assets.scene import Scene
from qdgrasp_protocol.spec import RunSpec
from qdgrasp_worker.evaluator import Evaluator

NEAR = (-1.0, -0.5)
"""Genes nu and d of genomes that look straight at the surface from near by."""


@cache
def scene_of(gripper: str, target: str, protocol: str) -> Scene:
    return build_scene(RunSpec(gripper=gripper, object=target, protocol=protocol))


@pytest.fixture(scope="session")
def make_scene() -> Callable[[str, str, str], Scene]:
    """Scenes by gripper, object and protocol."""
    return scene_of


@pytest.fixture(scope="session")
def cube() -> Scene:
    """The built-in Panda over the rubiks cube, protocol paper."""
    return scene_of("panda", "rubiks_cube", "paper")


@pytest.fixture
def asset_path(reference_data: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The reference data, found by the catalog; skips if it is not there."""
    monkeypatch.setenv("QDGRASP_ASSET_PATH", str(reference_data))
    return reference_data


@pytest.fixture(scope="module")
def evaluator(cube: Scene) -> Iterator[Evaluator]:
    with Evaluator(cube) as evaluator:
        yield evaluator


@pytest.fixture(scope="session")
def draw() -> Callable[..., NDArray[np.float32]]:
    """Genomes drawn uniformly; `near` of them look straight at the surface, often grasps."""

    def draw(n: int, genes: int = 7, seed: int = 0, near: int = 0) -> NDArray[np.float32]:
        genomes = np.random.default_rng(seed).uniform(-1.0, 1.0, (n, genes)).astype(np.float32)
        if near:
            genomes[:near, 3:5] = NEAR
        return genomes

    return draw
