"""RepairedHand copies of hands can be used, and hollow links are found."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh
from tests.assets import synthetic_hands
from tests.assets.example_hands import BOX, INERTIA, write_arch

from qdgrasp_assets.asset_report import examine
from qdgrasp_assets.gripper_setup import closing_motion
from qdgrasp_assets.gripper_setup.draft import DraftOverrides, draft_gripper, draft_toml, original_base
from qdgrasp_assets.gripper_setup.repaired_copy import repaired_copy, repaired_meshes, repaired_urdf
from qdgrasp_assets.grippers.gripper_file import OriginalBase, read_gripper_file
from qdgrasp_assets.grippers.urdf import read_urdf
from qdgrasp_assets.grippers.urdf_checks import hand_faults

EYE = (
    '<link name="eye"/><joint name="j" type="floating">'
    '<parent link="palm"/><child link="eye"/></joint></robot>'
)
FINGER = f'<collision><origin xyz="0 0 0.03"/><geometry>{BOX}</geometry></collision>'
SOLID = trimesh.creation.box((0.02, 0.01, 0.06))


def repaired(urdf, *, may_centre=True):
    """The copy of the jaw from its palm on, after it was seen to be usable."""
    target = urdf.parent / "own.toml"
    with repaired_copy(read_urdf(urdf), "palm", target, lambda _: None, may_centre=may_centre) as copy:
        assert hand_faults(copy.robot.subtree(copy.base)) == ()
    file = draft_gripper(copy.robot, copy.robot.path.name, DraftOverrides(base_link=copy.base))
    target.write_text(draft_toml(file, target.name))
    assert examine(target, "own").faults == ()
    return copy


def test_a_hand_that_needs_no_mending_is_left_as_it_is(jaw_urdf):
    before = jaw_urdf.read_bytes()
    copy = repaired(jaw_urdf)
    assert (copy.changes, copy.base) == ((), "palm")
    assert jaw_urdf.read_bytes() == before
    assert not repaired_meshes(jaw_urdf.parent / "own.toml").exists()


@pytest.mark.parametrize(
    ("old", "new", "sentence"),
    [
        (f'<inertial><mass value="0.5"/>{INERTIA}</inertial>', "", "the link 'palm' is given a mass,"),
        ('mass value="0.1"', 'mass value="0"', "the links 'left', 'right' are given a mass"),
        (f'<mass value="0.1"/>{INERTIA}', '<mass value="0.1"/>', "the links 'left', 'right' are given"),
        ('lower="-0.04" upper="0"', 'lower="0" upper="-0.04"', "limited the right way round"),
        ("</robot>", EYE, "the joint 'j' is fixed, as no motor drives what floats"),
        (FINGER, FINGER.replace("collision", "visual"), "the links 'left', 'right' are given the visual"),
        ("</robot>", "</robot>", ""),
    ],
)
def test_what_can_be_mended_is_and_is_told(jaw_urdf, edit, old, new, sentence):
    edit(jaw_urdf, old, new)
    assert any(sentence in change for change in repaired(jaw_urdf).changes) or not sentence


def test_limits_that_forbid_what_a_joint_mimics_are_widened_and_warned_of(jaw_urdf, edit):
    edit(jaw_urdf, '<mimic joint="slide"/>', '<mimic joint="slide" multiplier="-1"/>')
    edit(jaw_urdf, '<axis xyz="0 -1 0"/>', '<axis xyz="0 1 0"/>')
    before = draft_gripper(read_urdf(jaw_urdf), jaw_urdf.name, DraftOverrides())
    assert before.file.joints["other"].closed is None
    assert any("--repair takes those of the <mimic>" in words for words in before.warnings)
    assert "the joint 'other' is limited to where <mimic> takes it" in repaired(jaw_urdf).changes[0]
    assert read_gripper_file(jaw_urdf.parent / "own.toml").joints["other"].closed == 0.04


@pytest.mark.parametrize("kind", ["ply", "glb", "stl"])
def test_a_mesh_that_the_simulator_does_not_read_becomes_a_hull(jaw_urdf, edit, kind):
    text = SOLID.export(file_type="stl_ascii" if kind == "stl" else kind)
    (jaw_urdf.parent / f"pad.{kind}").write_bytes(text.encode() if isinstance(text, str) else text)
    edit(jaw_urdf, BOX, f'<mesh filename="pad.{kind}"/>')
    assert "was made a convex hull, as the simulator reads no such file" in repaired(jaw_urdf).changes[0]
    assert sorted(path.name for path in repaired_meshes(jaw_urdf.parent / "own.toml").iterdir()) == [
        "pad.obj"
    ]


def test_a_mesh_in_millimetres_is_written_in_metres(jaw_urdf, edit):
    trimesh.creation.box((20, 10, 60)).export(jaw_urdf.parent / "pad.stl")
    edit(jaw_urdf, BOX, '<mesh filename="pad.stl"/>')
    assert "was 60 m large, and is taken for millimetres" in repaired(jaw_urdf).changes[0]
    written = trimesh.load_mesh(repaired_meshes(jaw_urdf.parent / "own.toml") / "pad.obj")
    assert written.extents == pytest.approx((0.02, 0.01, 0.06))


def test_a_hollow_mesh_is_split_into_parts_that_leave_its_room(jaw_urdf, edit):
    write_arch(jaw_urdf.parent / "arch.stl")
    edit(jaw_urdf, BOX, '<mesh filename="arch.stl"/>')
    assert "was split into" in repaired(jaw_urdf).changes[0]
    assert examine(jaw_urdf.parent / "own.toml", "own").notes == ()


def test_fingers_beside_the_line_of_approach_get_a_base_link_in_their_middle(jaw_urdf, edit):
    for side in ("0.045", "-0.045"):
        edit(jaw_urdf, f'xyz="0 {side} 0.041"', f'xyz="0.08 {side} 0.041"')
    assert repaired(jaw_urdf, may_centre=False).base == "palm"
    copy = repaired(jaw_urdf)
    assert copy.base == "palm_centre"
    assert copy.robot.forward({})["palm"][:3, 3] == pytest.approx((-0.08, 0, 0))
    assert "a new one at (0.08 0 0) m in the frame of 'palm'" in copy.changes[-1]
    moved = OriginalBase(link="palm", position=(-0.08, 0.0, 0.0))
    assert original_base(copy.base, copy.robot) == moved


@pytest.mark.parametrize(
    "told",
    [{}, {"closed": {"thumb_curl": 0.2}}, {"approach_axis": (0.0, 0.8, -0.6)}],
    ids=["guessed", "closed", "approach axis"],
)
def test_the_base_link_is_where_the_fingers_of_the_file_close(tmp_path, told):
    urdf, target, overrides = tmp_path / "hand.urdf", tmp_path / "own.toml", DraftOverrides(**told)
    urdf.write_text(synthetic_hands.THUMB_HAND)
    arguments = read_urdf(urdf), "palm", target, lambda _: None
    with repaired_copy(*arguments, may_centre=True, overrides=overrides) as copy:
        draft = draft_gripper(copy.robot, "own.urdf", replace(overrides, base_link=copy.base))
    assert copy.base == "palm_centre"
    assert closing_motion.axis_offset(draft.closing, np.array(draft.file.approach_axis)) < 1e-3


def with_mesh(jaw_urdf, edit, kind="ply"):
    SOLID.export(jaw_urdf.parent / f"pad.{kind}")
    edit(jaw_urdf, BOX, f'<mesh filename="pad.{kind}"/>')


def test_an_older_copy_is_replaced_and_a_failed_one_is_removed(jaw_urdf, edit):
    with_mesh(jaw_urdf, edit)
    repaired(jaw_urdf)
    target = jaw_urdf.parent / "own.toml"
    assert [path.name for path in repaired_meshes(target).iterdir()] == ["pad.obj"]
    repaired(jaw_urdf)
    arguments = read_urdf(jaw_urdf), "palm", target, lambda _: None
    with pytest.raises(KeyError), repaired_copy(*arguments, may_centre=True):
        raise KeyError
    assert not repaired_urdf(target).exists()
    assert not repaired_meshes(target).exists()
