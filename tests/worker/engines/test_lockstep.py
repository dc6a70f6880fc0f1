"""Batches in lockstep: the control law, rows as one by one, worlds that have ended, buffers that overflow."""

from functools import partial

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from tests.worker.engines.looped_worlds import LoopedWorlds
from tests.worker.genomes import draw

from qdgrasp_assets.catalog import build_scene
from qdgrasp_assets.genes import layout
from qdgrasp_assets.scene import Scene
from qdgrasp_protocol.errors import InputError
from qdgrasp_protocol.spec import RunSpec
from qdgrasp_worker.engines.lockstep import FingerControls
from qdgrasp_worker.engines.lockstep_evaluator import LockstepEvaluator
from qdgrasp_worker.evaluator import Evaluator, make_evaluator
from qdgrasp_worker.finger_drive import FingerControl, FingerDrive

JOINTS, WORLDS, LOOKS = 3, 4, 5
NUMBERS = st.floats(-2.0, 2.0)


def drive(number: int, draw) -> FingerDrive:
    values = {name: draw(NUMBERS) for name in ("opened", "closed")}
    values |= {name: draw(st.floats(0.01, 3.0)) for name in ("limit", "stiffness", "damping", "inertia")}
    values |= {name: draw(st.floats(0.001, 1.0)) for name in ("lead", "speed", "rest_speed")}
    bounds = draw(st.sampled_from([(-np.inf, np.inf), (-1.5, 1.5)]))
    return FingerDrive(name=f"joint_{number}", lowest=bounds[0], highest=bounds[1], **values)


@given(data=st.data(), is_coupled=st.booleans())
def test_the_control_of_many_worlds_is_the_control_of_each(data, is_coupled):
    drives = [drive(number, data.draw) for number in range(JOINTS)]
    places = st.lists(st.lists(NUMBERS, min_size=JOINTS, max_size=JOINTS), min_size=WORLDS, max_size=WORLDS)
    postures = np.array(data.draw(places))
    is_way = np.array([each.opened != each.closed for each in drives])
    flags = st.lists(st.booleans(), min_size=WORLDS * JOINTS, max_size=WORLDS * JOINTS)
    closing = np.array(data.draw(flags)).reshape(WORLDS, JOINTS) & is_way
    together = FingerControls(drives, postures, closing, is_coupled=is_coupled)
    alone = [FingerControl(drives, is_coupled=is_coupled) for _ in range(WORLDS)]
    for world, control in enumerate(alone):
        control.start(postures[world].tolist(), [each.name for each in np.array(drives)[closing[world]]])
    before = postures
    for look in range(LOOKS):
        positions = np.array(data.draw(places))
        rows = np.flatnonzero(data.draw(st.lists(st.booleans(), min_size=WORLDS, max_size=WORLDS)))
        walked = together.walk(rows, positions[rows], 0.05)
        expected = [alone[row].walk(positions[row].tolist(), 0.05) for row in rows]
        assert walked.tolist() == [list(each) for each in expected]
        rests = together.rests(before, positions, 0.05).tolist()
        assert rests == [
            each.rests(then.tolist(), now.tolist(), 0.05)
            for each, then, now in zip(alone, before, positions, strict=True)
        ]
        before = positions
        if look == LOOKS - 2:
            together.stop()
            for control in alone:
                control.stop()
    assert together.targets.tolist() == [control.targets for control in alone]


def physical(hand: str = "panda", target: str = "rubiks_cube", protocol: str = "physical") -> Scene:
    base = "physical" if protocol == "robust" else "paper"
    return build_scene(
        RunSpec(gripper=hand, object=target, protocol=protocol, base=base, engine="mujoco-warp")
    )


@pytest.mark.parametrize(
    ("scene", "prior"),
    [
        (physical(), "approach"),
        (physical(), "aimed"),
        (physical("allegro", "mug"), "contact"),
        (physical(protocol="robust"), "approach"),
        (physical(protocol="robust"), "aimed"),
    ],
    ids=["panda", "candidates", "synergies", "trials", "candidates-in-trials"],
)
def test_rows_in_lockstep_are_those_of_one_by_one(scene, prior):
    genomes = draw(24, len(layout(scene, prior)), near=12 if prior == "approach" else 0)
    trials = np.arange(24, dtype=np.uint16) % 3 if scene.protocol == "robust" else np.zeros(24, np.uint16)
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
