"""Faults of a hand's URDF or file are described in words, all of them at once."""

import random
import xml.etree.ElementTree as ET

import pytest
from tests.assets.example_hands import BOX, INERTIA, JAW_URDF, LINKAGE_URDF

from qdgrasp_assets.asset_report import examine, examine_urdf

LOOP = '<joint name="loop" type="fixed"><parent link="left"/><child link="right"/></joint></robot>'
CIRCLE = (
    '<link name="a"/><link name="b"/>'
    '<joint name="ab" type="fixed"><parent link="a"/><child link="b"/></joint>'
    '<joint name="ba" type="fixed"><parent link="b"/><child link="a"/></joint></robot>'
)


def faults(toml):
    found = examine(toml, "jaw")
    assert all("\n" not in fault for fault in found.faults)
    return found.faults


@pytest.mark.parametrize(
    ("old", "new", "sentence"),
    [
        ('<link name="right">', '<link name="left">', "the link 'left' is named more than once; give each"),
        ('<joint name="other"', '<joint name="slide"', "the joint 'slide' is named more than once; give"),
        ('<joint name="other"', "<joint", "a joint has no name; give each its own"),
        ('<child link="right"/>', "", "the joint 'other' has no child link; correct"),
        ('<child link="right"/>', '<child link="thumb"/>', "names the child link 'thumb', which does not"),
        ("</robot>", LOOP, "the link 'right' is the child of two joints: it closes a loop"),
        ("</robot>", '<link name="camera"/></robot>', r"it has 2 roots ('palm', 'camera'), and a URDF has"),
        ("</robot>", CIRCLE, "the links 'a', 'b' are carried by itself in a circle of joints; cut the"),
        ('type="prismatic"', 'type="floating"', "the joint 'slide' is a floating one, which no motor drives"),
        ('type="prismatic"', 'type="planar"', "the joint 'slide' is a planar one, which no motor drives"),
        ('type="prismatic"', 'type="hinge"', "the joint 'slide' is of the type 'hinge', and URDF knows"),
        ('lower="-0.04" upper="0"', 'lower="0" upper="-0.04"', "limited the wrong way round, lower above"),
        ('lower="-0.04" upper="0"', 'lower="0" upper="0"', "are limited to one place, lower equal to upper"),
        ('upper="0"', 'upper="1e16"', "are limited so far that it has no limits: give those of the hand"),
        ('<limit lower="-0.04" upper="0" effort="60" velocity="0.2"/>', "", "'slide' is prismatic and has"),
        ('axis xyz="0 1 0"', 'axis xyz="0 0 0"', "the joint 'slide' has the axis '0 0 0'; an axis has a"),
        ('axis xyz="0 1 0"', 'axis xyz="0 up 0"', "must hold 3 numbers"),
        ('xyz="0 0 0.03"', 'xyz="0 0 nan"', "holds a number that is not finite; correct it"),
        ('<mimic joint="slide"', '<mimic multiplier="x" joint="slide"', "mimics another by what is no"),
        ('mimic joint="slide"', 'mimic joint="sled"', "the joint 'other' mimics 'sled', which is no other"),
        ('mass value="0.1"', 'mass value="0"', "the links 'left', 'right' are of mass 0, with all that"),
        ('mass value="0.1"', 'mass value="-1"', "are without a mass and an inertia that can be"),
        ('mass value="0.1"', 'mass value="100 g"', "are without a mass and an inertia that can be"),
        ('mass value="0.5"', 'mass value="500"', "it weighs 500.2 kg, which looks like grams"),
        (f'<inertial><mass value="0.5"/>{INERTIA}</inertial>', "", "'palm' is without a mass and an inertia"),
        ('<mass value="0.1"/>', "", "without a mass and an inertia"),
        (f'<mass value="0.1"/>{INERTIA}', '<mass value="0.1"/>', "without a mass and an inertia"),
        (BOX, '<mesh filename="pad.stl"/>', "the mesh 'pad.stl' does not"),
        (BOX, '<mesh filename="package://robotiq/pad.stl"/>', "put the ROS package 'robotiq' there, or"),
        (BOX, '<capsule radius="0.01" length="0.02"/>', "a collision shape <capsule>, and URDF knows mesh,"),
        (BOX, '<box size="0.02 -0.01 0.06"/>', "a collision shape <box> of the size '0.02 -0.01 0.06': it"),
        (BOX, '<sphere radius="big"/>', "of the size 'big': it takes radius, 1 in all, greater than 0"),
        (f"<geometry>{BOX}</geometry>", "", "has no shape in its <geometry>"),
    ],
)
def test_what_is_wrong_with_a_urdf_is_one_sentence(jaw_toml, jaw_urdf, edit, old, new, sentence):
    edit(jaw_urdf, old, new)
    assert any(sentence in fault for fault in faults(jaw_toml))
    told, _ = examine_urdf(jaw_urdf, "jaw")
    assert any(sentence in fault for fault in told.faults)


@pytest.mark.parametrize(
    ("old", "new", "sentence"),
    [
        ('["left", "right"]', "[]", "finger_links must name at least one link"),
        ('["left", "right"]', '["thumb"]', "finger_links names 'thumb', which"),
        (
            "closed = -0.04",
            "closed = 0.0",
            "the fingers do not close: their tips are 90 mm apart when open and 90",
        ),
        ("closed = -0.04\n", "", "no joint closes: give those of the fingers a closed position"),
        ("[0, 0, 1]", "[0, 0, -1]", "approach_axis points away from the fingers, which are toward [0, 0, 1]"),
        (
            "palm_offset = 0.04",
            "palm_offset = 0.4",
            "palm_offset is 0.4 m along the approach axis, and the fingers",
        ),
    ],
)
def test_what_cannot_be_meant_in_a_file_is_one_sentence(jaw_toml, edit, old, new, sentence):
    edit(jaw_toml, old, new)
    assert any(sentence in fault for fault in faults(jaw_toml))


def test_a_hand_without_faults_has_none(jaw_toml):
    found = examine(jaw_toml, "jaw")
    assert (found.faults, found.notes) == ((), ())
    assert [found.values[key] for key in ("joints", "followers", "fingers")] == [2, 1, 2]
    assert found.values["mass"] == pytest.approx(0.7)


def test_all_that_is_wrong_is_told_at_once(jaw_toml, jaw_urdf, edit):
    edit(jaw_urdf, 'mass value="0.5"', 'mass value="0"')
    edit(jaw_urdf, 'lower="-0.04" upper="0"', 'lower="0" upper="-0.04"')
    edit(jaw_urdf, BOX, '<mesh filename="pad.stl"/>')
    edit(jaw_toml, "[joints.other]", "[joints.another]")
    assert len(faults(jaw_toml)) == 5


def shape(tag, name):
    """A shape of a link, and its end."""
    return f'<{tag}><geometry><mesh filename="{name}"/></geometry></{tag}></link>'


@pytest.mark.parametrize(
    ("old", "new", "sentence"),
    [
        ("opening = 0.08", "opening = 0.04", "[jaw] axis = [0, 1, 0], opening = 0.08"),
        ("[0.0, 0.06]", "[0.0, 0.2]", "standoff goes to 0.2 m, and the fingers reach 0.061 m beyond the"),
        ("palm_offset = 0.04", "palm_offset = 0.0", "palm_offset is 0 m, and the palm's shapes end at 0.04"),
        ("closed = -0.04\n", "closed = -0.04\nvelocity = 0.05\n", "does not close wholly: slide needs 0.8 s"),
        ("[0, 0, 1]", "[1, 0, 0.9]", "approach_axis is 48 degrees from where the fingers close, [0, 0, 1]"),
    ],
)  # fmt: skip
def test_what_is_worth_a_thought_is_noted(jaw_toml, edit, old, new, sentence):
    edit(jaw_toml, old, new)
    found = examine(jaw_toml, "jaw")
    assert found.faults == ()
    assert any(sentence in note for note in found.notes)


ODD = ("", "x", "0", "-1", "1e9", "nan", "inf", "0 0", "0 0 0 0", "palm", "slide", "left")


def damaged(text, seed):
    """A URDF of which an element or an attribute is lost, doubled, or changed to something odd."""
    chance = random.Random(seed)  # noqa: S311
    robot = ET.fromstring(text)  # noqa: S314
    parent = chance.choice([each for each in robot.iter() if len(each)])
    child = chance.choice(list(parent))
    match chance.choice(("lose", "double", "drop", "change", "change", "change")):
        case "lose":
            parent.remove(child)
        case "double":
            parent.append(child)
        case "drop" if child.attrib:
            child.attrib.pop(chance.choice(sorted(child.attrib)))
        case _ if child.attrib:
            child.set(chance.choice(sorted(child.attrib)), chance.choice(ODD))
    return ET.tostring(robot, encoding="unicode")


@pytest.mark.parametrize("seed", range(0, 120, 20))
@pytest.mark.parametrize("text", [JAW_URDF, LINKAGE_URDF], ids=["jaw", "linkage"])
def test_damage_is_told_in_words_or_does_no_harm(tmp_path, text, seed):
    urdf = tmp_path / "hand.urdf"
    for turn in range(20):
        urdf.write_text(damaged(text, seed + turn))
        found, gripper = examine_urdf(urdf, "hand")
        assert gripper is not None or not found.facts, seed + turn
        assert all(fault and "\n" not in fault for fault in (*found.faults, *found.notes)), seed + turn
