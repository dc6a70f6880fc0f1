"""Links that may overlap."""

import pytest

from qdgrasp_assets.catalog import GRIPPERS, REFERENCE, find_gripper
from qdgrasp_assets.gripper_setup.posture_checks import (
    HandPostures,
    overlapping_pairs,
)
from qdgrasp_assets.grippers.gripper import read_gripper
from qdgrasp_assets.grippers.hand_model import read_hand_model

NAMES = tuple(sorted(path.stem for path in GRIPPERS.glob("*.toml")))


def postures(gripper):
    """A gripper's hand with the postures of its file."""
    return HandPostures(gripper.file, read_hand_model(gripper.robot, gripper.file.base_link))


def pairs_of(toml):
    return overlapping_pairs(postures(read_gripper(toml, "hand", toml.name)))


@pytest.fixture(params=NAMES)
def hand(request):
    """A hand of the catalog; those of the reference data are skipped where there is none."""
    if request.param.startswith(REFERENCE):
        request.getfixturevalue("asset_path")
    return postures(find_gripper(request.param))


def test_the_file_of_a_hand_has_the_pairs_that_its_shapes_give(hand):
    assert hand.file.disabled_collisions == overlapping_pairs(hand)


def test_links_that_overlap_nearly_wherever_they_are_may_overlap(jaw_toml, edit):
    urdf = jaw_toml.with_suffix(".urdf")
    edit(urdf, 'xyz="0 -0.045 0.041"', 'xyz="0 0.031 0.041"')  # 4 mm beside the left finger, which goes by
    edit(jaw_toml, "[joints.other]\nopen = 0.0\nclosed = -0.04", "[joints.other]\nopen = 0.0\nclosed = 0.0")
    assert pairs_of(jaw_toml) == ()
    edit(
        urdf,
        '<box size="0.02 0.01 0.06"/></geometry></collision></link>\n</robot>',
        '<box size="0.02 0.11 0.06"/></geometry></collision></link>\n</robot>',
    )
    edit(urdf, "0 0.031 0.041", "0 -0.019 0.041")
    assert pairs_of(jaw_toml) == (("left", "right"),)
