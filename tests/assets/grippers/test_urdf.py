import sys

import numpy as np
import pytest

from qdgrasp_assets.grippers.gripper_file import read_gripper_file
from qdgrasp_assets.grippers.urdf import read_robot_element, read_urdf
from qdgrasp_protocol.errors import AssetError


@pytest.fixture
def robot(claw):
    return read_urdf(claw.parent / "claw.urdf")


def test_links_lie_where_origins_and_joints_put_them(robot):
    frames = robot.forward({"bend": np.pi / 2})
    assert robot.root == "mount"
    assert frames["palm"][:3, 3] == pytest.approx([0, 0, 0.1])
    assert frames["finger"][:3, 3] == pytest.approx([0, 0.02, 0.15])
    assert frames["finger"][:3, 0] == pytest.approx([-1, 0, 0])  # yaw of 90 deg, then the joint's own


def test_a_subtree_has_its_links_only(robot):
    hand = robot.subtree("palm")
    assert hand.root == "palm"
    assert hand.links == ("palm", "finger")
    assert [joint.name for joint in hand.joints] == ["bend"]
    assert hand.mass == pytest.approx(0.6)
    assert len(robot.element.findall("link")) == 3
    assert robot.mass == pytest.approx(1.6)  # the mount has none, and counts as Bullet has it


def test_the_bundle_keeps_all_but_visuals_and_mesh_paths(robot):
    element, meshes = robot.bundled()
    assert set(meshes) == {"0_palm.stl"}
    assert not list(element.iter("visual"))
    assert [limit.attrib for limit in element.iter("limit")] == [
        limit.attrib for limit in robot.element.iter("limit")
    ]
    assert list(robot.element.iter("visual"))


@pytest.mark.parametrize("name", ["ISO-8859-1", "windows-1251", "GBK", "Shift_JIS", "UTF-16", "utf-8"])
def test_a_file_is_read_in_the_encoding_that_it_declares(claw, name):
    urdf, comment = claw.parent / "claw.urdf", "é".encode(name, "ignore").decode(name)
    before, text = read_urdf(urdf), urdf.read_text().replace("bend", f"bend_{comment}")
    text = text.replace("</robot>", f"<drake:filter_{comment}/></robot>")  # a prefix that is not declared
    urdf.write_bytes(f"<?xml version='1.0' encoding='{name}'?>\n{text}".encode(name))
    assert [joint.name for joint in read_urdf(urdf).joints] == ["flange", f"bend_{comment}"]
    assert read_urdf(urdf).links == before.links
    claw.write_bytes(claw.read_bytes().replace(b"bend", b'"bend_%b"' % comment.encode()))
    claw.write_text(claw.read_text(), encoding="utf-8-sig")
    assert "finger" in read_gripper_file(claw).finger_links


def test_a_mesh_of_a_ros_package_is_found_in_ros_package_path(claw, monkeypatch, tmp_path_factory):
    robot, folder = read_urdf(claw.parent / "claw.urdf"), tmp_path_factory.mktemp("ros") / "claw_description"
    (folder / "meshes").mkdir(parents=True)
    (folder / "meshes" / "palm.stl").write_bytes(b"mesh")
    for place in (folder.parent, folder):
        monkeypatch.setenv("ROS_PACKAGE_PATH", f"/nowhere:{place}")
        assert robot.mesh("package://claw_description/meshes/palm.stl") == b"mesh"


XACRO = """<robot name="{name}" xmlns:xacro="http://www.ros.org/wiki/xacro">
<xacro:include filename="$(find {package})/urdf/finger.xacro"/><link name="palm"/>
<xacro:finger name="left" upper="${{2 * 0.02}}"/></robot>"""
FINGER = """<robot xmlns:xacro="http://www.ros.org/wiki/xacro"><xacro:macro name="finger" params="name upper">
<link name="${name}"/>
<joint name="${name}_slide" type="prismatic"><parent link="palm"/><child link="${name}"/>
<axis xyz="1 0 0"/><limit lower="0" upper="${upper}" effort="1" velocity="1"/></joint>
</xacro:macro></robot>"""


def test_a_xacro_file_is_expanded_with_packages_from_ros_package_path(tmp_path, monkeypatch):
    hand, package = tmp_path / "hand" / "hand.urdf.xacro", tmp_path / "ros" / "claw_description" / "urdf"
    for file, text in ((hand, XACRO), (package / "finger.xacro", FINGER)):
        file.parent.mkdir(parents=True)
        file.write_text(text.format(name="claw", package="claw_description") if file == hand else text)
    assert "package 'claw_description' is needed" in refused(hand, hand.read_bytes())
    monkeypatch.setenv("ROS_PACKAGE_PATH", str(tmp_path / "ros"))
    robot = read_urdf(hand)
    assert [(joint.name, joint.upper) for joint in robot.joints] == [("left_slide", 0.04)]
    assert "makes no URDF" in refused(hand, XACRO.format(name="claw", package="claw_description")[:-9])
    monkeypatch.setitem(sys.modules, "xacro", None)
    assert "`pip install xacro`" in refused(hand, hand.read_bytes())


def refused(path, content):
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    with pytest.raises(AssetError) as error:
        read_robot_element(path)
    assert "\n" not in str(error.value)
    return str(error.value)


@pytest.mark.parametrize(
    ("name", "content", "sentence"),
    [
        ("hand.urdf", "this is no XML", "is not XML"),
        ("deep.urdf", f"<robot>{3000 * '<a>'}{3000 * '</a>'}</robot>", "nests elements too deeply"),
        ("hand.stl", bytes(range(128, 256)), "is not XML but binary data"),
        ("world.sdf", '<sdf version="1.6"/>', "is no URDF but an SDF file"),
        ("hand.xml", '<mujoco model="hand"/>', "is no URDF but a MuJoCo file"),
        ("hand.urdf", '<robot><xacro:hand side="left"/></robot>', "> hand_plain.urdf`"),
    ],
)
def test_what_is_no_urdf_is_told_for_what_it_is(tmp_path, name, content, sentence):
    assert sentence in refused(tmp_path / name, content)
