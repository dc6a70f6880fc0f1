"""Faults of a hand's URDF or file are described in words, all of them at once."""

import random
import xml.etree.ElementTree as ET

import numpy as np
import pytest
import trimesh
from tests.assets.example_hands import BOX, INERTIA, JAW_URDF, LINKAGE_URDF, write_arch
from tests.assets.special_files import PLACES, make_places

from qdgrasp_assets.asset_report import examine, examine_urdf
from qdgrasp_assets.catalog import build_scene
from qdgrasp_protocol.errors import AssetError
from qdgrasp_protocol.spec import RunSpec

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
        ('<limit lower="-0.04" upper="0" effort="60" velocity="0.2"/>', "", "'slide' is prismatic and has"),
        ('axis xyz="0 1 0"', 'axis xyz="0 0 0"', "the joint 'slide' has the axis '0 0 0'; an axis has a"),
        ('axis xyz="0 1 0"', 'axis xyz="0 up 0"', "must hold 3 numbers"),
        ('xyz="0 0 0.03"', 'xyz="0 0 nan"', "holds a number that is not finite; correct it"),
        ('<mimic joint="slide"', '<mimic multiplier="x" joint="slide"', "mimics another by what is no"),
        ('mimic joint="slide"', 'mimic joint="sled"', "the joint 'other' mimics 'sled', which is no other"),
        ('mass value="0.1"', 'mass value="0"', "the links 'left', 'right' are of mass 0, with all that"),
        ('mass value="0.1"', 'mass value="-1"', "are of a negative mass: give it in kg"),
        ('mass value="0.1"', 'mass value="100 g"', "are of a mass that is no number: give it in kg"),
        ('mass value="0.5"', 'mass value="500"', "it weighs 500.2 kg, which looks like grams"),
        (f'<inertial><mass value="0.5"/>{INERTIA}</inertial>', "", "'palm' is without <inertial>, for"),
        ('<mass value="0.1"/>', "", "with an <inertial> that lacks <mass> or <inertia>, which the simulator"),
        (f'<mass value="0.1"/>{INERTIA}', '<mass value="0.1"/>', "lacks <mass> or <inertia>"),
        (BOX, '<mesh filename="pad.stl"/>', "the mesh 'pad.stl' of the links 'left', 'right' does not"),
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


PAD = (
    f'<link name="pad"><inertial><mass value="0"/>{INERTIA}</inertial></link>'
    '<joint name="tip" type="fixed"><parent link="left"/><child link="pad"/></joint></robot>'
)


def test_a_frame_of_no_mass_that_is_fixed_to_a_link_with_one_is_no_fault(jaw_toml, jaw_urdf, edit):
    edit(jaw_urdf, "</robot>", PAD)
    assert faults(jaw_toml) == ()
    edit(jaw_urdf, 'mass value="0.1"', 'mass value="0"')
    (fault,) = faults(jaw_toml)
    assert fault.startswith("the links 'left', 'right', 'pad' are of mass 0")


@pytest.mark.parametrize("inertial", ['<mass value="0"/>' + INERTIA, '<mass value="0.1"/>', ""])
def test_masses_that_a_check_refuses_are_refused_by_a_run_in_the_same_words(
    jaw_toml, jaw_urdf, edit, inertial
):
    whole = f"<inertial>{inertial}</inertial>" if inertial else ""
    edit(jaw_urdf, f'<inertial><mass value="0.1"/>{INERTIA}</inertial>', whole)
    (fault,) = faults(jaw_toml)
    with pytest.raises(AssetError) as error:
        build_scene(RunSpec(gripper=str(jaw_toml), object="mug"))
    assert str(error.value) == f"The URDF '{jaw_urdf}' cannot be used as it is: {fault}."


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
    assert (found.joints, found.followers, found.fingers) == (2, 1, 2)
    assert found.mass == pytest.approx(0.7)


def test_all_that_is_wrong_is_told_at_once(jaw_toml, jaw_urdf, edit):
    edit(jaw_urdf, 'mass value="0.5"', 'mass value="0"')
    edit(jaw_urdf, 'lower="-0.04" upper="0"', 'lower="0" upper="-0.04"')
    edit(jaw_urdf, BOX, '<mesh filename="pad.stl"/>')
    edit(jaw_toml, "[joints.other]", "[joints.another]")
    assert len(faults(jaw_toml)) == 5


def test_a_closed_posture_that_opens_is_told_with_both_distances(jaw_toml, jaw_urdf, edit):
    edit(jaw_toml, "open = 0.0\nclosed = -0.04", "open = -0.04\nclosed = 0.0")
    (fault,) = faults(jaw_toml)
    assert "their tips are 10 mm apart when open and 90 mm when closed; swap open and closed" in fault


def test_a_follower_that_the_file_sends_elsewhere_is_told_where_it_should_be(jaw_toml):
    head, _, tail = jaw_toml.read_text().partition("[joints.other]")
    jaw_toml.write_text(head + "[joints.other]" + tail.replace("closed = -0.04", "closed = -0.02"))
    (fault,) = faults(jaw_toml)
    assert "joints.other is closed at -0.02, and by the URDF's <mimic> it is at -0.04 where slide is" in fault


def test_links_that_are_in_each_other_in_the_open_posture_are_told(jaw_toml, jaw_urdf, edit):
    wide = '<limit lower="-0.09" upper="0" effort="60" velocity="0.2"/>'
    edit(jaw_urdf, '<limit lower="-0.04" upper="0" effort="60" velocity="0.2"/>', wide)
    edit(jaw_toml, "open = 0.0\nclosed = -0.04", "open = -0.045\nclosed = -0.09")
    assert any(
        "'left' and 'right' are 10 mm in each other in the open posture" in fault
        for fault in faults(jaw_toml)
    )


def test_a_mesh_in_millimetres_is_told_with_the_scale_that_helps(jaw_toml, jaw_urdf, edit):
    trimesh.creation.box((20, 10, 60_000)).export(jaw_urdf.parent / "pad.stl")
    edit(jaw_urdf, BOX, '<mesh filename="pad.stl"/>')
    assert "is 6e+04 m large, so it looks like millimetres: write" in faults(jaw_toml)[0]
    edit(jaw_urdf, 'filename="pad.stl"', 'filename="pad.stl" scale="1e-3 1e-3 1e-6"')
    assert faults(jaw_toml) == ()


@pytest.mark.parametrize(
    ("name", "content", "sentence"),
    [
        ("pad.ply", b"ply", "is a .ply file, and the simulator reads .stl, .obj, .dae"),
        ("pad.stl", b"solid pad\nendsolid pad\n", "is no binary STL file, which alone the simulator reads"),
        ("pad.stl", bytes(84), "is empty: give it one with a surface"),
        ("pad.obj", b"v 0 0 0\nf 1 2 3\n", "cannot be read"),
    ],
)
def test_a_mesh_that_the_simulator_cannot_read_is_told(jaw_toml, jaw_urdf, edit, name, content, sentence):
    (jaw_urdf.parent / name).write_bytes(content)
    edit(jaw_urdf, BOX, f'<mesh filename="{name}"/>')
    assert sentence in faults(jaw_toml)[0]


def shape(tag, name):
    """A shape of a link, and its end."""
    return f'<{tag}><geometry><mesh filename="{name}"/></geometry></{tag}></link>'


@pytest.mark.parametrize("name", [*PLACES, "x" * 300 + ".stl"])
def test_a_mesh_that_is_no_ordinary_file_is_told_by_a_check_and_a_run(jaw_toml, jaw_urdf, edit, name):
    make_places(jaw_urdf.parent)
    edit(jaw_urdf, "</link>", shape("collision", name))
    (fault,) = faults(jaw_toml)
    assert f" {PLACES.get(name, 'cannot be looked at (File name too long)')}: there should be a mesh" in fault
    with pytest.raises(AssetError) as error:
        build_scene(RunSpec(gripper=str(jaw_toml), object="mug"))
    assert fault in str(error.value)


def test_meshes_of_a_kind_that_the_simulator_does_not_read_are_told_in_one_line(jaw_toml, jaw_urdf, edit):
    names = [f"pad{number}.glb" for number in range(13)]
    for name in names:
        (jaw_urdf.parent / name).write_bytes(b"glTF")
    shapes = "".join(shape("collision", name).removesuffix("</link>") for name in names)
    edit(jaw_urdf, '<link name="left">', f'<link name="left">{shapes}')
    (fault,) = faults(jaw_toml)
    assert fault == (
        "the meshes 'pad0.glb', 'pad1.glb', 'pad2.glb' and 10 more are .glb files, and the simulator reads "
        ".stl, .obj, .dae: save them as such, or use --mend"
    )


@pytest.mark.parametrize("name", [*PLACES, "package://jaw/pad.dae"])
def test_a_visual_mesh_is_neither_missed_nor_read_by_a_check_or_a_run(jaw_toml, jaw_urdf, edit, name):
    hand = build_scene(RunSpec(gripper=str(jaw_toml), object="mug")).gripper
    make_places(jaw_urdf.parent)
    edit(jaw_urdf, "</link>", shape("visual", name))
    found = examine(jaw_toml, "jaw")
    assert (found.faults, found.notes) == ((), ())
    assert examine_urdf(jaw_urdf, "jaw")[0].faults == ()
    assert build_scene(RunSpec(gripper=str(jaw_toml), object="mug")).gripper == hand


def test_a_hollow_mesh_is_noted(jaw_toml, jaw_urdf, edit):
    write_arch(jaw_urdf.parent / "arch.stl")
    edit(jaw_urdf, BOX, '<mesh filename="arch.stl"/>')
    (note,) = examine(jaw_toml, "jaw").notes
    assert "wraps each collision mesh in its convex hull" in note
    assert "left " in note


@pytest.mark.parametrize(
    ("old", "new", "sentence"),
    [
        ('[jaw]\naxis = [0, 1, 0]\nopening = 0.08\n', "", "no [jaw]: with axis = [0, 1, 0], opening = 0.08"),
        ("axis = [0, 1, 0]", "axis = [1, 0, 0]", "jaw.axis is [1, 0, 0], and the fingers oppose each other"),
        ("opening = 0.08", "opening = 0.04", "jaw.opening is 0.04 m, and between the shapes of the open"),
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


@pytest.mark.parametrize(("closed", "count"), [(-0.045, 1), (-0.0415, 0)])
def test_fingers_that_close_through_each_other_are_noted_and_those_that_touch_are_not(
    jaw_toml, jaw_urdf, edit, closed, count
):
    edit(jaw_urdf, 'lower="-0.04"', 'lower="-0.06"')
    edit(jaw_toml, "closed = -0.04", f"closed = {closed}")
    found = examine(jaw_toml, "jaw")
    notes = [note for note in found.notes if "close through each other" in note]
    assert (found.faults, len(notes)) == ((), count)
    where = "'left' and 'right', which are apart when open, meet at 95 % of the way and end 10 mm in"
    assert all(where in note for note in notes)


@pytest.mark.parametrize(("degrees", "is_away"), [(99, False), (101, True), (120, True)])
def test_an_axis_that_points_away_from_the_fingers_is_told(jaw_toml, edit, degrees, is_away):
    x, z = np.sin(np.radians(degrees)), np.cos(np.radians(degrees))
    edit(jaw_toml, "[0, 0, 1]", f"[{x:.6f}, 0, {z:.6f}]")
    assert any("approach_axis points away" in fault for fault in faults(jaw_toml)) == is_away


def test_fingers_that_close_beside_the_line_of_approach_are_noted(jaw_toml, jaw_urdf, edit):
    for side in ("0.045", "-0.045"):
        edit(jaw_urdf, f'xyz="0 {side} 0.041"', f'xyz="0.08 {side} 0.041"')
    assert any("the fingers close 80 mm beside the line" in note for note in examine(jaw_toml, "jaw").notes)


def test_a_mirrored_mesh_is_no_hollow_one(jaw_toml, jaw_urdf, edit):
    trimesh.creation.box((0.02, 0.01, 0.06)).export(jaw_urdf.parent / "pad.stl")
    edit(jaw_urdf, BOX, '<mesh filename="pad.stl" scale="1 -1 1"/>')
    assert examine(jaw_toml, "jaw").notes == ()


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


@pytest.mark.parametrize("seed", range(0, 240, 20))
@pytest.mark.parametrize("text", [JAW_URDF, LINKAGE_URDF], ids=["jaw", "linkage"])
def test_damage_is_told_in_words_or_does_no_harm(tmp_path, text, seed):
    urdf = tmp_path / "hand.urdf"
    for turn in range(20):
        urdf.write_text(damaged(text, seed + turn))
        found, gripper = examine_urdf(urdf, "hand")
        assert gripper is not None or not found.base_link, seed + turn
        assert all(fault and "\n" not in fault for fault in (*found.faults, *found.notes)), seed + turn
