"""Convex parts of collision shapes: never more than the shapes, and hardly less."""

from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
import trimesh
from scipy.spatial import ConvexHull

from qdgrasp_assets.catalog import build_scene
from qdgrasp_assets.geometry.mesh import parse_parts
from qdgrasp_assets.grippers.collision_shapes import collision_elements, part_corners, shapes
from qdgrasp_assets.grippers.urdf import parse_robot
from qdgrasp_protocol.spec import RunSpec

LINK = (
    '<robot name="one"><link name="palm"><collision {}>{}<geometry>{}</geometry></collision></link></robot>'
)
TETRAHEDRON = [(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1)]
TWO = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\n{0} one\nf 1 2 3\nf 1/1 2/2/2 4//4\nv 5 5 5\n{0} two\nf -1 1 2\n"


def parts_of(geometry, files=None, origin="", attributes=""):
    robot = parse_robot(Path("one"), ElementTree.fromstring(LINK.format(attributes, origin, geometry)))  # noqa: S314 - written above
    return [corners for _, corners in link_parts(robot, files or {})]


def link_parts(robot, files):
    found = collision_elements(robot)
    return [(link, corners) for link, each in found for corners in part_corners(robot, each, files)]


@pytest.mark.parametrize("gripper", ["panda", "barrett", "allegro", "shadow", "robotiq_2f"])
def test_the_parts_of_a_hand_lie_within_its_shapes_and_nearly_fill_them(gripper) -> None:
    hand = build_scene(RunSpec(gripper=gripper, object="tennis_ball")).gripper
    robot = parse_robot(Path(), ElementTree.fromstring(hand.urdf))  # noqa: S314 - our own
    expected = [(shape.link, ConvexHull(shape.vertices)) for shape in shapes(robot, hand.meshes)]
    found = link_parts(robot, hand.meshes)
    assert [link for link, _ in found] == [link for link, _ in expected]
    for (_, corners), (_, hull) in zip(found, expected, strict=True):
        heights = corners @ hull.equations[:, :3].T + hull.equations[:, 3]
        assert heights.max() < 1e-4
        assert 0.9 * hull.volume < ConvexHull(corners).volume < 1.01 * hull.volume


def test_an_stl_is_one_part_with_its_scale() -> None:
    files = {"thing.STL": trimesh.Trimesh(TETRAHEDRON, [(0, 1, 2), (0, 1, 3)]).export(file_type="stl")}
    [part] = parts_of('<mesh filename="thing.STL" scale="1 2 3"/>', files)
    assert {tuple(corner) for corner in part} == {(0, 0, 0), (1, 0, 0), (0, 2, 0), (0, 0, 3)}


@pytest.mark.parametrize("word", ["o", "g"])
def test_an_obj_has_a_part_for_each_group_with_the_corners_of_its_triangles(word) -> None:
    one, two = (part.vertices for part in parse_parts(TWO.format(word)))
    np.testing.assert_array_equal(one, TETRAHEDRON)
    np.testing.assert_array_equal(two, [(0, 0, 0), (1, 0, 0), (5, 5, 5)])
