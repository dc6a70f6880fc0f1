import os

import pytest

from qdgrasp_assets.gripper_file import read_gripper_file
from qdgrasp_assets.hands.source import read_source
from qdgrasp_protocol.errors import AssetError

XACRO = '<robot name="r" xmlns:xacro="http://www.ros.org/wiki/xacro">{}<link name="a"/></robot>'


def refused(path, content):
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    with pytest.raises(AssetError) as error:
        read_source(path)
    assert "\n" not in str(error.value)
    return str(error.value)


def test_a_urdf_is_read(jaw_urdf):
    assert len(read_source(jaw_urdf).findall("link")) == 3


@pytest.mark.parametrize(
    "content",
    ['<xacro:include filename="b.xacro"/>', '<link name="${side}_finger"/>', '<link name="$(arg x)"/>'],
)
def test_a_xacro_file_is_told_with_the_command_that_makes_a_urdf_of_it(tmp_path, content):
    told = refused(tmp_path / "hand.urdf.xacro", XACRO.format(content))
    assert "run `xacro hand.urdf.xacro > hand.urdf`" in told


def test_a_xacro_file_is_told_by_what_is_in_it(tmp_path):
    assert "> hand_plain.urdf`" in refused(tmp_path / "hand.urdf", '<robot><xacro:hand side="left"/></robot>')


def test_what_xacro_left_behind_makes_no_xacro_file(tmp_path):
    urdf = tmp_path / "hand.urdf"
    urdf.write_text(XACRO.format('<!-- <xacro:hand side="$(arg side)"/> -->'))
    assert read_source(urdf).tag == "robot"


@pytest.mark.parametrize(
    ("name", "content", "sentence"),
    [
        ("hand.urdf", "this is no XML", "is not XML"),
        ("hand.stl", bytes(range(128, 256)), "is not XML but binary data"),
        ("world.sdf", '<sdf version="1.6"/>', "is no URDF but an SDF file"),
        ("hand.xml", '<mujoco model="hand"/>', "is no URDF but a MuJoCo file"),
        ("hand.urdf", "<html/>", "whose root is <html>"),
    ],
)
def test_what_is_no_urdf_is_told_for_what_it_is(tmp_path, name, content, sentence):
    assert sentence in refused(tmp_path / name, content)


def test_a_file_that_is_not_there_is_told(tmp_path):
    with pytest.raises(AssetError, match=r"No URDF can be read at '.*hand.urdf': it does not exist; name"):
        read_source(tmp_path / "hand.urdf")


def test_a_pipe_is_not_waited_for(tmp_path):
    os.mkfifo(tmp_path / "hand.urdf")
    os.mkfifo(tmp_path / "hand.toml")
    for read, name in ((read_source, "hand.urdf"), (read_gripper_file, "hand.toml")):
        with pytest.raises(AssetError, match=f"{name}': it is no ordinary file; name"):
            read(tmp_path / name)
