"""Which links may overlap, and which ratings cannot be true."""

import pytest
from tests.assets.example_hands import LID

from qdgrasp_assets.asset_report import examine
from qdgrasp_assets.catalog import GRIPPERS, REFERENCE, find_gripper
from qdgrasp_assets.gripper_setup.posture_checks import (
    STRONGEST_FINGER,
    HandPostures,
    fingertip_arm,
    overlapping_pairs,
    posture_notes,
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


def test_every_joint_that_closes_has_ratings_that_can_be_true_and_their_source(hand):
    assert hand.file.ratings_source != "not stated"
    for joint in hand.closing.closed:
        table = hand.file.joints[joint]
        assert table.rated_effort is not None
        assert table.rated_velocity is not None
        assert 1.0 < table.rated_effort / fingertip_arm(hand, joint) < STRONGEST_FINGER
    assert not [note for note in posture_notes(hand) if "rated" in note]


def test_neighbours_by_joint_and_links_that_meet_only_when_closed_are_left_out(jaw_toml, edit):
    edit(jaw_toml.with_suffix(".urdf"), 'size="0.06 0.14 0.04"', 'size="0.06 0.14 0.06"')  # the palm
    for joint in ("slide", "other"):
        edit(jaw_toml, f"[joints.{joint}]\nopen = 0.0", f"[joints.{joint}]\nopen = -0.01")
    edit(jaw_toml.with_suffix(".urdf"), 'xyz="0 0.045 0.041"', 'xyz="0 0.035 0.041"')
    assert pairs_of(jaw_toml) == ()


def test_links_that_overlap_when_open_may_overlap(jaw_toml, edit):
    edit(jaw_toml.with_suffix(".urdf"), "0 -0.045 0.041", "0 0.04 0.041")
    assert pairs_of(jaw_toml) == (("left", "right"),)


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


def test_links_of_one_rigid_piece_that_overlap_may_overlap(jaw_toml, edit):
    edit(jaw_toml.with_suffix(".urdf"), "</robot>", f"{LID}</robot>")
    assert pairs_of(jaw_toml) == (("palm", "lid"),)


@pytest.mark.parametrize(
    ("rating", "sentence"),
    [
        (
            "rated_effort = 301.0",
            "the rated_effort of slide cannot be true: the end of its finger would press with 301 N",
        ),
        (
            "rated_velocity = 3.1",
            "the rated_velocity of slide cannot be true: the end of its finger would move",
        ),
    ],
)
def test_a_rating_that_cannot_be_true_is_noted_in_a_sentence(jaw_toml, edit, rating, sentence):
    assert not any("cannot be true" in note for note in examine(jaw_toml, "jaw").notes)
    edit(jaw_toml, "[joints.slide]", f"[joints.slide]\n{rating}")
    (note,) = (note for note in examine(jaw_toml, "jaw").notes if "cannot be true" in note)
    assert note.startswith(sentence)


def test_the_arm_of_a_joint_reaches_to_the_far_corner_of_its_finger(claw):
    hand = postures(read_gripper(claw, "claw", "claw.toml"))
    assert fingertip_arm(hand, "bend") == pytest.approx((0.06**2 + 0.005**2) ** 0.5)
