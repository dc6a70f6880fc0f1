"""The built-in hands: alone, and beside the reference hands of the paper's experiment."""

from dataclasses import dataclass

import numpy as np
import pytest

from qdgrasp_assets.catalog import find_gripper
from qdgrasp_assets.grippers.gripper import Gripper
from qdgrasp_assets.grippers.urdf import Urdf

REFERENCES = {
    "allegro": "ref_allegro",
    "barrett": "ref_bh280",
    "panda": "ref_panda_2f",
    "robotiq_2f": "ref_robotiq_2f",
    "shadow": "ref_shadow",
}
POSTURES = 200
ALL_SYNERGIES = ["thumb_index", "thumb_mid", "thumb_index_mid", "all"]


@dataclass(frozen=True)
class Hand:
    """A gripper of the catalog, and its URDF from the base link on."""

    gripper: Gripper
    robot: Urdf


@dataclass(frozen=True)
class Pair:
    """A built-in hand and the reference."""

    own: Hand
    reference: Hand

    def postures(self, count):
        """Random joint positions within the limits; merged joints stand as in the open hand."""
        random = np.random.default_rng(0)
        merged = {name: table.open for name, table in self.reference.gripper.file.joints.items()}
        for _ in range(count):
            yield {
                **merged,
                **{j.name: random.uniform(j.lower, j.upper) for j in self.own.robot.joints if j.moves},
            }


def find_hand(name):
    gripper = find_gripper(name)
    return Hand(gripper, gripper.robot.subtree(gripper.file.base_link))


@pytest.fixture(params=REFERENCES)
def pair(request, asset_path):
    return Pair(find_hand(request.param), find_hand(REFERENCES[request.param]))


@pytest.mark.parametrize("name", ["allegro", "shadow"])
def test_a_hand_with_a_thumb_has_the_synergies_of_the_paper(name):
    own = find_gripper(name)
    assert [synergy.name for synergy in own.file.synergies] == ALL_SYNERGIES
    closing = {joint for joint, table in own.file.joints.items() if table.closed is not None}
    assert set(own.file.synergies[-1].joints) == closing


def test_a_hand_grasps_as_the_reference_is_told_to(pair):
    own, reference = (hand.gripper.on_carrier("paper") for hand in (pair.own, pair.reference))
    assert own.approach_axis == reference.approach_axis
    assert (own.palm_offset, own.standoff) == (reference.palm_offset, reference.standoff)
    assert own.synergies == reference.synergies
    assert own.free_joints == reference.free_joints
    told = {joint.name: joint for joint in reference.joints}
    for joint in own.joints:
        assert (joint.opened, joint.closed) == (told[joint.name].opened, told[joint.name].closed)
        assert joint.velocity == told[joint.name].velocity
    assert {name for name, joint in told.items() if joint.driven} <= {joint.name for joint in own.joints}


def test_links_stand_where_those_of_the_reference_do_in_any_posture(pair):
    probes = np.vstack([np.zeros(3), 0.05 * np.eye(3)])  # the frame, and points beyond any fingertip
    for posture in pair.postures(POSTURES):
        own, reference = (hand.robot.forward(posture) for hand in (pair.own, pair.reference))
        for link in pair.own.gripper.file.finger_links:
            np.testing.assert_allclose(placed(probes, own[link]), placed(probes, reference[link]), atol=1e-3)


def placed(points, frame):
    return points @ frame[:3, :3].T + frame[:3, 3]
