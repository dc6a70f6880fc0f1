"""Hollow links: what the simulator would fill, and what is convex part by part already."""

import numpy as np
from tests.assets.grippers.test_urdf_checks import BOX

from qdgrasp_assets.geometry.mesh import Mesh, join, parts_to_obj
from qdgrasp_assets.geometry.primitives import hull
from qdgrasp_assets.gripper_setup.mesh_splitting import hollow_meshes
from qdgrasp_assets.grippers.urdf import read_urdf

CORNERS = np.array([[x, y, z] for x in (-0.01, 0.01) for y in (-0.005, 0.005) for z in (0.0, 0.01)])
PRISM = np.array([[x, y, z] for y in (-0.005, 0.005) for x, z in ((-0.01, 0.0), (0.01, 0.0), (0.0, 0.06))])


def slab(place: int) -> Mesh:
    return hull(CORNERS + np.array([0.0, 0.0, 0.01 * place]))


def tooth(place: int) -> Mesh:
    return hull(PRISM + np.array([0.02 * place, 0.0, 0.0]))


def hollow_links(jaw_urdf, edit, parts):
    (jaw_urdf.parent / "pad.obj").write_bytes(parts_to_obj(parts))
    edit(jaw_urdf, BOX, '<mesh filename="pad.obj"/>')
    return [hollow.link for hollow in hollow_meshes(read_urdf(jaw_urdf))]


def test_grooves_between_the_teeth_of_one_part_are_filled(jaw_urdf, edit):
    assert hollow_links(jaw_urdf, edit, [join(tooth(place) for place in range(5))]) == ["left", "right"]


def test_a_mesh_of_convex_parts_that_touch_has_no_room_that_they_fill(jaw_urdf, edit):
    assert hollow_links(jaw_urdf, edit, [slab(place) for place in range(8)]) == []
