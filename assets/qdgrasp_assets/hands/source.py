"""The text of a robot: whether it is a URDF at all, with advice for what people take for one."""

import re
import xml.etree.ElementTree as ET
from pathlib import Path

from qdgrasp_assets.files import amiss
from qdgrasp_protocol.errors import AssetError

XACRO = re.compile(r"\{http[^}]*xacro\}|xacro:")
"""Tags that only a xacro file has."""
SUBSTITUTION = re.compile(r"\$[({]")
"""What xacro puts values in place of, in attributes."""
OTHERS = {
    "sdf": "an SDF file, which describes worlds for Gazebo; look for the robot's URDF, or export one from it",
    "mujoco": "a MuJoCo file (MJCF); look for the robot's URDF, or export one from it",
    "gripper": "the description of a gripper for another program; name the robot's URDF",
}
"""Root elements of what is no URDF, and what it is."""


def read_source(path: Path) -> ET.Element:
    """The `<robot>` element of a URDF.

    Raises
    ------
    AssetError
        It is not there, is a xacro file, is not XML, or describes something else than a robot.
    """
    text = _text(path)
    try:
        element = ET.fromstring(text)  # noqa: S314  # the user's own file; expat refuses entities that grow
    except ET.ParseError as error:
        if "<xacro:" in text:
            raise AssetError(_of_xacro(path)) from None
        raise AssetError(
            f"'{path}' is not XML ({error}), and a URDF is; name the robot's .urdf file."
        ) from None
    if path.suffix.lower() == ".xacro" or _is_xacro(element):
        raise AssetError(_of_xacro(path))
    if element.tag != "robot":
        told = OTHERS.get(element.tag, f"an XML file whose root is <{element.tag}>, and a URDF's is <robot>")
        raise AssetError(f"'{path}' is no URDF but {told}.")
    return element


def _text(path: Path) -> str:
    if why := amiss(path):
        raise AssetError(f"No URDF can be read at '{path}': it {why}; name the robot's .urdf file.")
    try:
        return path.read_text(encoding="utf-8")
    except OSError as error:
        raise AssetError(f"No URDF can be read at '{path}': {error.strerror or error}.") from None
    except UnicodeDecodeError:
        raise AssetError(f"'{path}' is not XML but binary data; name the robot's .urdf file.") from None


def _is_xacro(element: ET.Element) -> bool:
    """Whether there is something for xacro to do; comments are left aside."""
    return any(
        XACRO.match(each.tag) or any(SUBSTITUTION.search(value) for value in each.attrib.values())
        for each in element.iter()
    )


def _of_xacro(path: Path) -> str:
    return (
        f"'{path}' is a xacro file, of which a URDF is made: run `xacro {path.name} > {_plain_name(path)}` "
        "(from ROS, or `pip install xacro`) and name that file."
    )


def _plain_name(path: Path) -> str:
    """What the URDF of a xacro file is called."""
    stem = path.name.removesuffix(".xacro").removesuffix(".urdf")
    return f"{stem}.urdf" if path.name != f"{stem}.urdf" else f"{stem}_plain.urdf"
