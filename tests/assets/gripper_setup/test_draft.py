"""Drafts of hands, compared with files that people wrote."""

import pytest

from qdgrasp_assets.asset_report import examine
from qdgrasp_assets.catalog import find_gripper
from qdgrasp_assets.gripper_setup.draft import DraftOverrides, draft_gripper, draft_toml
from qdgrasp_assets.grippers.gripper import read_gripper
from qdgrasp_assets.grippers.hand_model import guess_base
from qdgrasp_assets.grippers.urdf import read_urdf
from qdgrasp_protocol.errors import AssetError, ImpossibleValue, UnknownName

BUILT_IN = ("allegro", "barrett", "panda", "robotiq_2f", "shadow")
ARM = """<link name="world"/><joint name="j0" type="revolute"><parent link="world"/><child link="arm"/>
<origin xyz="0 0 0.4"/><axis xyz="0 0 1"/><limit lower="-2" upper="2" effort="9" velocity="1"/></joint>
<link name="arm"/><joint name="j1" type="revolute"><parent link="arm"/><child link="flange"/>
<origin xyz="0 0 0.6"/><axis xyz="0 1 0"/><limit lower="-2" upper="2" effort="9" velocity="1"/></joint>
<link name="flange"/><joint name="mount" type="fixed"><parent link="flange"/><child link="palm"/></joint>
<link name="tool"/><joint name="tip" type="fixed"><parent link="palm"/><child link="tool"/></joint></robot>"""


def guessed(urdf, **told):
    return draft_gripper(read_urdf(urdf), urdf.name, DraftOverrides(**told))


def own_file(urdf):
    """The path of the file with the guesses."""
    target = urdf.parent / "own.toml"
    target.write_text(draft_toml(guessed(urdf), target.name))
    return target


def built_in(name):
    """A built-in hand's file as it was written, and as it is guessed of its URDF."""
    gripper = find_gripper(name)
    return gripper.file, draft_gripper(gripper.robot, gripper.file.urdf, DraftOverrides()).file


@pytest.fixture(params=BUILT_IN)
def pair(request):
    return built_in(request.param)


def test_base_link_and_approach_axis_of_a_built_in_hand_are_guessed(pair):
    known, found = pair
    assert (found.base_link, found.approach_axis) == (known.base_link, known.approach_axis)


def test_fingers_are_guessed_to_close_no_farther_than_they_were_told_to(pair):
    known, found = pair
    for name in (name for name in known.joints if not name.startswith("THJ") and known.joints[name].closed):
        way = found.joints[name].closed - found.joints[name].open
        told = known.joints[name].closed - known.joints[name].open
        assert 0 < way / told <= 1 + 1e-6


@pytest.mark.parametrize(("name", "thumb"), [("allegro", "joint_15"), ("shadow", "THJ1")])
def test_a_thumb_is_guessed_to_close_with_each_finger(name, thumb):
    synergies = built_in(name)[1].synergies
    assert all(thumb in synergy.joints for synergy in synergies)
    assert synergies[-1].name == "all"
    assert len(synergies) == len({synergy.joints for synergy in synergies})


def test_a_hand_at_the_end_of_an_arm_begins_where_its_fingers_hang(jaw_urdf, edit):
    edit(jaw_urdf, "</robot>", ARM)
    assert guess_base(read_urdf(jaw_urdf))[0] == "palm"


def test_a_follower_goes_where_its_leader_takes_it_and_is_driven(jaw_urdf, edit):
    edit(jaw_urdf, '<mimic joint="slide"/>', '<mimic joint="slide" multiplier="0.5" offset="-0.01"/>')
    found = guessed(jaw_urdf)
    assert (found.file.joints["other"].open, found.file.joints["other"].closed) == (-0.01, -0.03)
    assert found.file.joints["other"].driven
    assert "mimics slide (0.5 times it, plus -0.01)" in found.reasons["joints.other"]


def test_what_is_told_is_not_guessed(jaw_urdf):
    found = guessed(jaw_urdf, licence="CC0", approach_axis=(0.0, 1.0, 0.0), closed={"slide": -0.03})
    file = found.file
    assert (file.licence, file.approach_axis) == ("CC0", (0.0, 1.0, 0.0))
    assert file.joints["slide"].closed == file.joints["other"].closed == -0.03
    assert found.reasons["approach_axis"] == "as told"


@pytest.mark.parametrize(
    ("told", "error", "sentence"),
    [
        ({"base_link": "plam"}, UnknownName, "Unknown link 'plam'. Did you mean 'palm'"),
        ({"finger_roots": ("lef",)}, UnknownName, "Unknown link beyond the base link 'lef'. Did you mean"),
        ({"closed": {"slid": 0.0}}, UnknownName, "Unknown moving joint 'slid'. Did you mean 'slide'"),
        ({"closed": {"slide": 1.0}}, ImpossibleValue, "closed slide must be within the limits -0.04 to 0 of"),
        ({"opened": {"slide": -3.0}}, ImpossibleValue, "open slide must be within the limits -0.04 to 0 of"),
        ({"opened": {"other": 0.0}}, AssetError, "'other' follows 'slide': give --open for 'slide'"),
        ({"closed": {"other": 0.0}}, AssetError, "'other' follows 'slide': give --closed for 'slide'"),
        ({"not_closing": ("other",)}, AssetError, "'other' follows 'slide': give --not-closing for"),
        ({"approach_axis": (0.0, 0.0, 0.0)}, ImpossibleValue, "approach-axis must be a direction"),
        ({"base_link": "left"}, AssetError, "none of its joints moves; name another --base-link"),
    ],
)
def test_what_is_told_and_cannot_be_is_refused_in_a_sentence(jaw_urdf, told, error, sentence):
    with pytest.raises(error, match=sentence.replace("(", r"\(")):
        guessed(jaw_urdf, **told)


def test_the_file_that_is_written_says_what_was_guessed_and_can_be_used(jaw_urdf):
    target = own_file(jaw_urdf)
    assert read_gripper(target, "own", "own.toml").file == guessed(jaw_urdf).file
    assert examine(target, "own").faults == ()


def test_a_finger_that_is_fixed_opposite_to_the_one_that_moves_is_a_finger(jaw_urdf, edit):
    edit(jaw_urdf, '<joint name="other" type="prismatic">', '<joint name="other" type="fixed">')
    found = guessed(jaw_urdf)
    assert found.file.approach_axis == (0.0, 0.0, 1.0)
    assert (found.file.palm_offset, found.file.standoff) == (0.04, (0.0, 0.061))
    assert found.file.finger_links == ("left", "right")
    assert (found.file.joints["slide"].open, found.file.joints["slide"].closed) == (0.0, -0.04)
    assert "from the middle of the palm" in found.reasons["approach_axis"]
    assert examine(own_file(jaw_urdf), "own").faults == ()
