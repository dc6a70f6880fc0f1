"""Scenes of two engines: grasps that hold in the first are tried in the second."""

import msgspec
import numpy as np
import pytest
from tests.worker.genomes import encoded, evaluated, facing, outcomes, results

from qdgrasp_assets.catalog import build_scene
from qdgrasp_assets.scene import Scene, pack_scene
from qdgrasp_protocol.engines import engine_names
from qdgrasp_protocol.errors import InputError
from qdgrasp_protocol.rows import GIVEN, Outcome
from qdgrasp_protocol.spec import RunSpec, from_toml, run_spec, to_toml
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
    rows = evaluated(asked, "aimed", encoded(asked, facing(asked, POSES, candidates=16)))
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


def test_an_evaluation_in_two_engines_forgets():
    asked = scene("mujoco,bullet")
    genomes = encoded(asked, facing(asked, POSES, candidates=16))
    whole = evaluated(asked, "aimed", genomes)
    assert results(evaluated(asked, "aimed", genomes[::-1].copy(), batch=3)[::-1]) == results(whole)


def test_a_trial_is_passed_where_both_engines_hold():
    more = {"protocol": "robust", "base": "physical"}
    asked = scene("mujoco,bullet", **more)
    genomes = encoded(asked, facing(asked, POSES, candidates=16))
    nominal = evaluated(scene("mujoco"), "aimed", genomes)
    poses = nominal["base_to_object"][nominal["outcome"] == Outcome.HELD]
    trials = np.resize([1, 2, 3], len(poses))
    both = evaluated(asked, GIVEN, poses, trials)
    each = [evaluated(scene(name, **more), GIVEN, poses, trials) for name in ("mujoco", "bullet")]
    held = [rows["outcome"] == Outcome.HELD for rows in each]
    np.testing.assert_array_equal(both["outcome"] == Outcome.HELD, held[0] & held[1])
    np.testing.assert_array_equal(both["fitness"], np.where(held[0], each[1]["fitness"], each[0]["fitness"]))
    assert held[0].sum() > held[1].sum()


@pytest.mark.parametrize(
    "engine", ["bullet,bullet", "mujoco,mujoco", "bullet,other", "bullet,mujoco,bullet", ""]
)
def test_what_names_no_engines_is_refused_with_what_does(engine):
    with pytest.raises(InputError, match=r"engine must be one of .*'bullet,mujoco', 'mujoco,bullet', got"):
        run_spec(HAND | {"engine": engine})


@pytest.mark.parametrize("order", ORDERS)
def test_the_order_of_engines_is_part_of_spec_and_scene(order):
    spec = run_spec(HAND | {"engine": order})
    assert from_toml(to_toml(spec)) == spec
    assert spec.protocol_words == f"physical in {' then '.join(engine_names(order))}"
    others = [None, "mujoco", *ORDERS]
    digests = {pack_scene(msgspec.structs.replace(scene(order), engine=name)).digest for name in others}
    assert len(digests) == len(others)
