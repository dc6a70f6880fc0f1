"""Batches in lockstep: the control law, rows as one by one, worlds that have ended, buffers that overflow."""

from functools import partial

import numpy as np
import pytest
from msgspec import structs
from tests.worker.engines.looped_worlds import LoopedWorlds
from tests.worker.genomes import draw

from qdgrasp_assets.catalog import build_scene
from qdgrasp_assets.genes import layout
from qdgrasp_assets.geometry.mesh import box, parts_to_obj
from qdgrasp_assets.scene import Scene
from qdgrasp_protocol.errors import InputError
from qdgrasp_protocol.spec import RunSpec
from qdgrasp_worker.engines.lockstep import LockstepEvaluator
from qdgrasp_worker.evaluator import Evaluator, make_evaluator


def physical(hand: str = "panda", target: str = "rubiks_cube", protocol: str = "physical") -> Scene:
    base = "physical" if protocol == "robust" else "paper"
    return build_scene(
        RunSpec(gripper=hand, object=target, protocol=protocol, base=base, engine="mujoco-warp")
    )


BESIDE = parts_to_obj([box((0.4, 0.4, 0.01)).moved((0.0, 0.0, -0.035))])


@pytest.mark.parametrize(
    ("scene", "prior"),
    [
        (physical(), "approach"),
        (physical("allegro", "mug"), "contact"),
        (physical(protocol="robust"), "approach"),
        (structs.replace(physical(), neighbours=BESIDE), "approach"),
    ],
    ids=["panda", "synergies", "trials", "neighbours"],
)
def test_rows_in_lockstep_are_those_of_one_by_one(scene, prior):
    genomes = draw(24, len(layout(scene, prior)), near=12 if prior == "approach" else 0)
    trials = (
        np.arange(24, dtype=np.uint16) % 4 * (40 if scene.protocol == "robust" else 0)
    )  # the last is hard
    expected = Evaluator(scene).evaluate(prior, genomes, trials)
    evaluator = LockstepEvaluator(scene, LoopedWorlds)
    found = evaluator.evaluate(prior, genomes, trials)
    assert len({*expected.rows["outcome"].tolist()}) > 1
    for name in expected.rows.dtype.names:
        assert found.rows[name].tobytes() == expected.rows[name].tobytes(), name
    assert found.failures == expected.failures == []
    assert evaluator.redone == 0


def test_rows_whose_worlds_overflow_are_evaluated_in_mujoco():
    scene, genomes = physical(protocol="robust"), draw(12, near=12)
    trials = np.arange(1, 13, dtype=np.uint16)
    expected = Evaluator(scene).evaluate("approach", genomes, trials)

    def fails(friction) -> bool:
        return bool(friction[0] > scene.object.lateral_friction)

    evaluator = LockstepEvaluator(scene, partial(LoopedWorlds, failing=fails, garbage=True))
    found = evaluator.evaluate("approach", genomes, trials)
    assert found.rows.tobytes() == expected.rows.tobytes()
    assert 0 < evaluator.redone < 12


def test_a_worker_without_a_device_refuses_such_a_scene():
    with pytest.raises(InputError, match="no device for the engine mujoco-warp: start it as qdgrasp-worker"):
        make_evaluator(physical())
