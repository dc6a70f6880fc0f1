"""Scenes that the worker's tests share, as building a scene takes long."""

from collections.abc import Callable, Iterator
from functools import cache

import pytest

from qdgrasp_assets.catalog import build_scene
from qdgrasp_assets.scene import Scene
from qdgrasp_protocol.spec import RunSpec
from qdgrasp_worker.evaluator import Evaluator


@cache
def scene_of(gripper: str, target: str, protocol: str, engine: str | None = None) -> Scene:
    return build_scene(RunSpec(gripper=gripper, object=target, protocol=protocol, engine=engine))


@pytest.fixture(scope="session")
def make_scene() -> Callable[..., Scene]:
    """Scenes by gripper, object and protocol, and by engine where it is not Bullet."""
    return scene_of


@pytest.fixture(scope="session")
def cube() -> Scene:
    """The built-in Panda over the rubiks cube, protocol paper."""
    return scene_of("panda", "rubiks_cube", "paper")


@pytest.fixture
def named_scene(request: pytest.FixtureRequest) -> Callable[[str, str], Scene]:
    """Scenes by hand and object, in protocol paper; those of reference hands in released."""

    def find(hand: str, target: str) -> Scene:
        if not hand.startswith("ref_"):
            return scene_of(hand, target, "paper")
        request.getfixturevalue("asset_path")
        return scene_of(hand, f"ycb_{target}", "released")

    return find


@pytest.fixture(scope="module")
def evaluator(cube: Scene) -> Iterator[Evaluator]:
    with Evaluator(cube) as evaluator:
        yield evaluator
