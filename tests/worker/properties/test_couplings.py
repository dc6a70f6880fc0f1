"""Joints that follow others stay with their leaders in both engines, and grasps hold in both alike."""

import re

import numpy as np
from tests.assets.example_hands import LINKAGE_URDF
from tests.worker.genomes import evaluated

from qdgrasp_assets.catalog import build_scene
from qdgrasp_assets.gripper_setup.draft import DraftOverrides, draft_gripper, draft_toml
from qdgrasp_assets.grippers.hand_model import followers
from qdgrasp_assets.grippers.urdf import read_urdf, scene_robot
from qdgrasp_protocol.rows import Outcome
from qdgrasp_protocol.spec import RunSpec

RIGHT_PAD = '<mimic joint="knuckle" multiplier="1"/></joint>'
CHAINED = '<mimic joint="other" multiplier="-1"/></joint>'
SWAPPED = {"-0.7": 'lower="0" upper="0.7"', "0": 'lower="-0.7" upper="0"'}
"""Limits of the joint turned round, by the lower one."""


def test_followers_also_of_followers_stay_with_their_leader_in_grasps_that_hold(tmp_path):
    urdf, toml, held = tmp_path / "hand.urdf", tmp_path / "hand.toml", []
    text = LINKAGE_URDF.replace(RIGHT_PAD, CHAINED).replace('axis xyz="1 0 0"', 'axis xyz="-1 0 0"')
    text = re.sub('lower="(-0.7|0)" upper="(0|0.7)"', lambda found: SWAPPED[found[1]], text)
    urdf.write_text(text)
    toml.write_text(draft_toml(draft_gripper(read_urdf(urdf), urdf.name, DraftOverrides()), toml.name))
    genomes = np.random.default_rng(1).uniform(-1, 1, (60, 4)).astype(np.float32)
    for engine in ("bullet", "mujoco"):
        scene = build_scene(
            RunSpec(gripper=str(toml), object="rubiks_cube", protocol="physical", engine=engine)
        )
        rows = evaluated(scene, "antipodal", genomes)
        held.append(rows["outcome"].ravel() == Outcome.HELD)
        names = [joint.name for joint in scene.gripper.joints]
        joints = dict(zip(names, rows["joints"][held[-1]].T, strict=True))
        found = followers(scene_robot(scene.gripper))
        off = [joints[name] - each.position(joints[each.leader]) for name, each in found.items()]
        assert len(found) == 3
        assert np.abs(off).max() < 0.005
    assert held[0].sum() > 30
    assert (held[0] == held[1]).mean() > 0.9
