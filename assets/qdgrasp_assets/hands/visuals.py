"""Visual shapes of a hand, which no evaluation needs; pictures are drawn of the collision shapes."""

import copy
import xml.etree.ElementTree as ET
from dataclasses import replace

from qdgrasp_assets.urdf import Urdf


def without_visuals(robot: Urdf) -> Urdf:
    """The robot as it is, but for its visual shapes."""
    element = copy.deepcopy(robot.element)
    drop_visuals(element)
    return replace(robot, element=element)


def drop_visuals(element: ET.Element) -> int:
    """Take the visual shapes out of a `<robot>`, and say how many there were."""
    found = [(link, visual) for link in element.findall("link") for visual in link.findall("visual")]
    for link, visual in found:
        link.remove(visual)
    return len(found)
