"""Scenes of two engines: grasps that hold in the first are tried in the second."""

import numpy as np
import pytest
from tests.worker.genomes import draw, evaluated, outcomes, results

from qdgrasp_assets.catalog import build_scene
from qdgrasp_assets.scene import Scene
from qdgrasp_protocol.rows import Outcome
from qdgrasp_protocol.spec import RunSpec
from qdgrasp_worker.episode import outcome_of

ORDERS = ("bullet,mujoco", "mujoco,bullet")
HAND = {"gripper": "panda", "object": "rubiks_cube", "protocol": "physical"}
SLIPPERY = 0.05
"""Friction at which MuJoCo holds an object that Bullet throws out of the jaw."""
POSES = 60


def scene(engine: str | None, friction: float | None = SLIPPERY, **more: str) -> Scene:
    return build_scene(
        RunSpec(**HAND | more, friction=friction, engine=None if engine == "bullet" else engine)
    )


@pytest.mark.parametrize(("order", "friction"), [(ORDERS[0], None), (ORDERS[1], SLIPPERY)])
def test_what_holds_in_the_first_engine_has_the_verdict_of_the_second(order, friction):
    asked = scene(order, friction)
    genomes = draw(POSES, near=POSES)
    rows = evaluated(asked, "approach", genomes)
    first, second = (evaluated(scene(name, friction), "approach", genomes) for name in order.split(","))
    is_tried = first["outcome"] == Outcome.HELD
    assert is_tried.sum() > 3
    judged = ("outcome", "fitness")
    assert results(rows, *judged, "steps") == results(first, *judged, "steps")
    steps = first["steps"] + np.where(is_tried, second["steps"], 0)
    np.testing.assert_array_equal(rows["steps"], steps)
    np.testing.assert_array_equal(rows["fitness"], np.where(is_tried, second["fitness"], first["fitness"]))
    expected = [outcome_of(int(each["fitness"]), 6) for each in second[is_tried]]
    assert outcomes(rows[is_tried]) == expected
    assert outcomes(rows[~is_tried]) == outcomes(first[~is_tried])
    assert friction is None or Outcome.DROPPED in expected


def test_shorter_steps_of_mujoco_change_few_verdicts():
    genomes = draw(POSES, near=POSES)
    coarse, fine = (
        evaluated(scene(name, None), "approach", genomes)["outcome"] == Outcome.HELD
        for name in ("mujoco", "mujoco-fine")
    )
    assert coarse.sum() > 3
    assert (coarse == fine).mean() >= 0.95
