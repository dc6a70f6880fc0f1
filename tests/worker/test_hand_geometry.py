"""Links of a hand that a joint connects."""

import xml.etree.ElementTree as ET
from pathlib import Path

from qdgrasp_assets.grippers.hand_geometry import neighbours
from qdgrasp_assets.grippers.urdf import parse_robot

URDF = """<robot name="hand"><link name="palm"/><link name="pad"/><link name="finger"/><link name="tip"/>
<joint name="a" type="fixed"><parent link="palm"/><child link="pad"/></joint>
<joint name="b" type="revolute"><parent link="pad"/><child link="finger"/><axis xyz="0 0 1"/>
<limit lower="0" upper="1" effort="1" velocity="1"/></joint>
<joint name="c" type="revolute"><parent link="finger"/><child link="tip"/><axis xyz="0 0 1"/>
<limit lower="0" upper="1" effort="1" velocity="1"/></joint></robot>"""


def test_neighbours_have_no_joint_that_moves_between_them_or_one() -> None:
    robot = parse_robot(Path(), ET.fromstring(URDF))  # noqa: S314  # written above
    assert neighbours(robot) == {("pad", "palm"), ("finger", "palm"), ("finger", "pad"), ("finger", "tip")}
