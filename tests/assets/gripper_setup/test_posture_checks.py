"""Links that may overlap."""

import pytest

from qdgrasp_assets.catalog import GRIPPERS, REFERENCE, find_gripper
from qdgrasp_assets.gripper_setup.posture_checks import HandPostures, overlapping_pairs
from qdgrasp_assets.grippers.hand_model import read_hand_model

NAMES = tuple(sorted(path.stem for path in GRIPPERS.glob("*.toml")))


def postures(gripper):
    """A gripper's hand with the postures of its file."""
    return HandPostures(gripper.file, read_hand_model(gripper.robot, gripper.file.base_link))


@pytest.fixture(params=NAMES)
def hand(request):
    """A hand of the catalog; those of the reference data are skipped where there is none."""
    if request.param.startswith(REFERENCE):
        request.getfixturevalue("asset_path")
    return postures(find_gripper(request.param))


def test_the_file_of_a_hand_has_the_pairs_that_its_shapes_give(hand):
    assert hand.file.disabled_collisions == overlapping_pairs(hand)
