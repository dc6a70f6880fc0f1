"""Scenes of two engines: grasps that hold in the first are tried in the second."""

import numpy as np
import pytest
from tests.worker.genomes import encoded, evaluated, facing, outcomes, results

from qdgrasp_assets.catalog import build_scene
from qdgrasp_assets.scene import Scene
from qdgrasp_protocol.rows import GIVEN, Outcome
from qdgrasp_protocol.spec import RunSpec
from qdgrasp_worker.episode import outcome_of

ORDERS = ("bullet,mujoco", "mujoco,bullet")
HAND = {"gripper": "panda", "object": "rubiks_cube", "protocol": "physical"}
SLIPPERY = 0.05
"""Friction at which MuJoCo holds an object that Bullet throws out of the jaw."""
POSES = 20


def scene(engine: str | None, friction: float | None = SLIPPERY, **more: str) -> Scene:
    return build_scene(
        RunSpec(**HAND | more, friction=friction, engine=None if engine == "bullet" else engine)
    )


@pytest.mark.parametrize(("order", "friction"), [(ORDERS[0], None), (ORDERS[1], SLIPPERY)])
def test_what_holds_in_the_first_engine_has_the_verdict_of_the_second(order, friction):
    asked = scene(order, friction)
    rows = evaluated(asked, "valued", encoded(asked, facing(asked, POSES, candidates=16)))
    poses = rows["base_to_object"]
    first, second = (evaluated(scene(name, friction), GIVEN, poses) for name in order.split(","))
    is_tried = first["outcome"] == Outcome.HELD
    assert is_tried.sum() > 3
    judged = ("outcome", "fitness")
    of_aimed = ("proposals", "descriptor", "surface_point", "nu")
    assert results(rows, *judged, *of_aimed) == results(first, *judged, *of_aimed)
    np.testing.assert_array_equal(rows["fitness"], np.where(is_tried, second["fitness"], first["fitness"]))
    expected = [outcome_of(int(each["fitness"]), 6) for each in second[is_tried]]
    assert outcomes(rows[is_tried]) == expected
    assert outcomes(rows[~is_tried]) == outcomes(first[~is_tried])
    assert (Outcome.DROPPED in expected) == (friction == SLIPPERY)
