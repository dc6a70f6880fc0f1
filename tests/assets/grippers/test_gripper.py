import re
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest

from qdgrasp_assets.catalog import find_gripper
from qdgrasp_assets.grippers.gripper import CARRIERS, read_gripper
from qdgrasp_assets.grippers.urdf import parse_robot
from qdgrasp_protocol.errors import AssetError


def read(path):
    return read_gripper(path, "claw", "claw.toml")


def test_a_gripper_takes_what_its_toml_leaves_out_from_the_urdf(claw):
    hand = read(claw).on_carrier("paper")
    (joint,) = hand.joints
    assert (joint.opened, joint.closed, joint.effort, joint.velocity) == (0.0, 1.2, 10.0, 2.0)
    assert hand.approach_axis == (0.0, 0.0, 1.0)
    assert list(hand.meshes) == ["0_palm.stl"]
    assert "visual" not in hand.urdf
    assert 'filename="0_palm.stl"' in hand.urdf


PAIRS = "disabled_collisions = ["
HELD_BY = "carrier_hold_force must be greater than 0, got"
IN_TOML = (
    ('["finger"]', '["thumb"]', "finger_links names 'thumb', which"),
    ('"palm"', '"hand"', "base_link names 'hand', which"),
    ("[joints.bend]", "[free_joints.twist]\nlow=0\nhigh=1\n[joints.bend]", "names 'twist'"),
    ("[joints.bend]", '[[synergies]]\nname="a"\njoints=["b"]\n[joints.bend]', "synergy 'a'"),
    (
        "[joints.bend]\nopen = 0.0\nclosed = 1.2\n",
        "[joints]\n",
        "nothing about the joint 'bend' of '.*', which moves",
    ),
    ("closed = 1.2", "closed = 1.6", r"closed is 1.6, outside the URDF's limits 0 to 1.5"),
    ("closed = 1.2", "closed = 1.2\neffort = 0.0", "effort of the joint 'bend' must be greater"),
    (
        "closed = 1.2",
        "rated_effort = 0.0",
        r"joints\.bend\.rated_effort must be greater than 0, got 0; leave",
    ),
    ("palm_offset", f"{PAIRS}['palm', 'thumb']]\npalm_offset", "disabled_collisions names 'thumb', which"),
    ('finger_links = ["finger"]', "", "Object missing required field `finger_links`"),
    ("[0.0, 0.03]", "[0.05, 0.03]", r"standoff must be \[least, greatest\]"),
    ("[0, 0, 2]", "[0, 0, 0]", "approach_axis must not be zero"),
    ("palm_offset = 0.05", "palm_offset = inf", "numbers are finite, got inf"),
    ("palm_offset = 0.05", "palm_offset = -1", "palm_offset must be 0 or more"),
    ("palm_offset", "carrier_hold_force = 0.0\npalm_offset", f"{HELD_BY} 0"),
    ("standoff =", "standoff", "is no gripper's file"),
    ('"claw.urdf"', '"none.urdf"', "No URDF can be read at '.*none.urdf'"),
    ('"claw.urdf"', '"asset://none.urdf"', "needs 'none.urdf' of the reference data"),
)
JAW = "\n[jaw]\naxis = [0, 3, 0]\nopening = 0.08\n"
SYNERGY = '\n[[synergies]]\nname = "all"\njoints = ["bend"]\n'
FREE = "\n[free_joints.bend]\nlow = 1.5\nhigh = 0.0\n"
ADDED = (
    (JAW.replace("[0, 3, 0]", "[0, 3, 1]"), "right angles"),
    (JAW.replace("[0, 3, 0]", "[0, 0, 0]"), "right angles"),
    (JAW.replace("0.08", "0.0"), "greater than 0"),
    (JAW.replace("opening", "width"), "width|opening"),
    (SYNERGY.replace('"bend"', ""), "the synergy 'all' has no joints"),
    (f"driven = false{SYNERGY}", "the synergy 'all' names 'bend', which is not driven"),
    (FREE.replace("1.5", "-9"), r"free_joints\.bend\.low is -9, outside the URDF's limits 0 to 1\.5"),
    (FREE.replace("0.0", "9.0"), r"free_joints\.bend\.high is 9, outside the URDF's limits 0 to 1\.5"),
    (FREE.replace("0.0", "1.5"), r"free_joints\.bend has one place, 1\.5, for low and high"),
)
IN_URDF = (
    ('"mount"', '"${mount}"', "is a xacro file, of which a URDF is made"),
    ('xyz="0 0 0.1"', 'xyz="0 0 up"', r"must hold 3 numbers"),
    ('<child link="finger"/>', '<child link="palm"/>', "is not one tree"),
)


@pytest.mark.parametrize(
    ("file", "old", "new", "sentence"),
    [
        *(("claw.toml", *case) for case in IN_TOML),
        *(("claw.toml", "closed = 1.2\n", f"closed = 1.2\n{more}", words) for more, words in ADDED),
        *(("claw.urdf", *case) for case in IN_URDF),
    ],
)
def test_what_does_not_fit_is_refused_in_a_sentence_that_names_it(claw, edit, file, old, new, sentence):
    edit(claw.parent / file, old, new)
    with pytest.raises(AssetError, match=sentence) as refused:
        read(claw).on_carrier("paper")
    assert "\n" not in str(refused.value)


EMPTY = r"claw.urdf' has .* collision shape.*(no triangles|cannot be read).*\.$"
UNREADABLE = r"claw.urdf' has a collision shape that cannot be read: \w+Error: .*"


@pytest.mark.parametrize(
    ("kind", "content", "sentence"),
    [
        ("stl", bytes(84), EMPTY),
        ("stl", b"solid nothing\nendsolid nothing\n", EMPTY),
        ("obj", b"o nothing\nv 0 0 0\n", EMPTY),
        ("obj", b"v a b c\n", UNREADABLE),
        ("obj", b"v 0 0 0\nf 1 2 3\n", UNREADABLE),
    ],
)
def test_a_mesh_that_is_empty_or_cannot_be_read_is_one_sentence(claw, edit, kind, content, sentence):
    edit(claw.parent / "claw.urdf", "palm.stl", f"palm.{kind}")
    (claw.parent / f"palm.{kind}").write_bytes(content)
    with pytest.raises(AssetError, match=sentence):
        read(claw).on_carrier("paper")


def test_a_hand_in_which_nothing_closes_is_refused(claw, edit):
    edit(claw, re.search(r"closed = .*", claw.read_text()).group(), "")
    with pytest.raises(AssetError, match="gripper 'claw': no joint closes"):
        find_gripper(str(claw))


REFERENCE = ("ref_allegro", "ref_bh280", "ref_panda_2f", "ref_robotiq_2f", "ref_shadow")
RATED = "closed = 1.2\nrated_effort = 0.5\nrated_velocity = 1.5"


@pytest.mark.parametrize(
    ("protocol", "held"),
    [
        ("physical", (0.5, 1.5, (("palm", "finger"),))),
        ("robust", (0.0, 0.0, ())),
        ("released", (0.0, 0.0, ())),
    ],
)
def test_only_physical_is_given_the_ratings_and_the_links_that_may_overlap(claw, edit, protocol, held):
    edit(claw, "closed = 1.2", RATED)
    edit(claw, "palm_offset", f"{PAIRS}['palm', 'finger']]\npalm_offset")
    hand = read(claw).on_carrier(protocol)
    (joint,) = hand.joints
    assert (joint.effort, joint.velocity) == (10.0, 2.0)
    assert (joint.rated_effort, joint.rated_velocity, hand.disabled_collisions) == held


def carried(name: str, protocol: str):
    hand = find_gripper(name).on_carrier(protocol)
    return hand, parse_robot(Path(name), ElementTree.fromstring(hand.urdf))  # noqa: S314


@pytest.mark.parametrize("protocol", CARRIERS)
def test_the_hand_is_at_the_root_when_the_carrier_is_at_zero(protocol):
    hand, robot = carried("panda", protocol)
    assert robot.root != hand.base_link
    assert robot.forward({})[hand.base_link] == pytest.approx(np.eye(4))
    assert {joint.name for joint in hand.carrier} <= {joint.name for joint in robot.joints}


@pytest.mark.parametrize("protocol", sorted(CARRIERS.keys() - {"lift", "physical"}))
def test_shakes_move_the_hand_along_its_z_and_about_its_x(protocol):
    hand, robot = carried("panda", protocol)
    shaken = {joint.shake: joint.name for joint in hand.carrier if joint.shake}
    frame = robot.forward({shaken["z"]: 0.2, shaken["x"]: np.pi / 2})[hand.base_link]
    assert frame[:3, 3] == pytest.approx([0, 0, 0.2])
    assert frame[:3, 1] == pytest.approx([0, 0, 1])


def test_paper_pushes_every_hand_with_the_pandas_acceleration(asset_path):
    for name in REFERENCE:
        hand, robot = carried(name, "paper")
        force = next(joint.shake_force for joint in hand.carrier if joint.shake == "z")
        moved = robot.mass - 3.0  # the root does not move
        assert force / moved == pytest.approx(20.0 / 3.7, rel=1e-6)
