"""A URDF that is damaged anywhere is examined all the same: what comes out are words."""

import random
import xml.etree.ElementTree as ET

import pytest
from tests.assets.hands import jaw, linkage

from qdgrasp_assets.hands.examination import examine_urdf

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
@pytest.mark.parametrize("text", [jaw.URDF, linkage.URDF], ids=["jaw", "linkage"])
def test_damage_is_told_in_words_or_does_no_harm(tmp_path, text, seed):
    urdf = tmp_path / "hand.urdf"
    for turn in range(20):
        urdf.write_text(damaged(text, seed + turn))
        found, gripper = examine_urdf(urdf, "hand")
        assert (gripper is None) == (not found.base_link), seed + turn
        assert all(fault and "\n" not in fault for fault in (*found.faults, *found.notes)), seed + turn
