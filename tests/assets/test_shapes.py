"""The triangles of a robot's collision shapes."""

from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest

from qdgrasp_assets.shapes import largest_side, shapes
from qdgrasp_assets.urdf import tree

ARM = """<robot name="arm">
<link name="palm"><collision><geometry><box size="0.1 0.02 0.02"/></geometry></collision></link>
<joint name="turn" type="revolute"><parent link="palm"/><child link="tip"/>
<origin xyz="0.1 0 0" rpy="0 0 1.5707963267948966"/><axis xyz="1 0 0"/><limit lower="0" upper="1" effort="1" velocity="1"/>
</joint>
<link name="tip"><collision><origin xyz="0.1 0 0" rpy="0 1.5707963267948966 0"/>
<geometry><cylinder radius="0.01" length="0.2"/></geometry></collision>
<collision><origin xyz="0.2 0 0"/><geometry><sphere radius="0.05"/></geometry></collision></link>
</robot>"""  # noqa: E501


@pytest.fixture
def arm():
    return tree(Path("arm"), ElementTree.fromstring(ARM))  # noqa: S314 - written above


def test_every_shape_is_placed_in_its_link(arm) -> None:
    box, cylinder, sphere = shapes(arm, {})
    assert [shape.link for shape in (box, cylinder, sphere)] == ["palm", "tip", "tip"]
    np.testing.assert_allclose(np.ptp(box.vertices, axis=0), [0.1, 0.02, 0.02])
    np.testing.assert_allclose(np.ptp(cylinder.vertices, axis=0), [0.2, 0.02, 0.02], atol=1e-9)
    np.testing.assert_allclose(sphere.vertices.mean(axis=0), [0.2, 0, 0], atol=1e-9)


def test_the_largest_side_is_that_of_all_links_at_joints_zero(arm) -> None:
    # from the box's side at y = -0.01 to the sphere's end: 0.1 turns along y, so 0.2 + 0.05
    assert largest_side(arm, {}) == pytest.approx(0.01 + 0.25, abs=1e-6)
