import numpy as np
import pytest
import trimesh

from qdgrasp_assets.geometry.mesh import join, parts_to_obj, read_obj, read_parts, stl_triangles
from qdgrasp_assets.geometry.primitives import box
from qdgrasp_protocol.errors import AssetError

BLOCK = (0.02, 0.03, 0.05)


def test_volume_and_centre_of_mass_do_not_depend_on_where_the_mesh_lies():
    block = box(BLOCK)
    shift = np.array([0.3, -0.2, 0.1])
    moved = block.moved(shift)
    assert moved.volume == pytest.approx(block.volume)
    assert moved.centre_of_mass == pytest.approx(block.centre_of_mass + shift)
    assert block.flipped().volume == pytest.approx(-block.volume)
    assert block.flipped().normals == pytest.approx(-block.normals)


def test_the_inertia_of_a_box_is_that_of_a_box_wherever_it_lies():
    x, y, z = np.square(BLOCK)
    for shift in ((0, 0, 0), (3, -2, 1)):
        expected = np.diag([y + z, x + z, x + y]) / 12
        assert box(BLOCK).moved(shift).inertia == pytest.approx(expected, abs=1e-12)


def test_parts_enclose_together_what_they_do_alone_and_survive_an_obj_file(tmp_path):
    parts = (box(BLOCK), box(BLOCK).moved((0.1, 0.2, 0.3)))
    assert join(parts).volume == pytest.approx(2 * np.prod(BLOCK))
    path = tmp_path / "parts.obj"
    path.write_bytes(parts_to_obj(parts))
    for found, given in zip(read_parts(path), parts, strict=True):
        assert found.vertices == pytest.approx(given.vertices, abs=1e-9)
        assert (found.faces == given.faces).all()


def test_parts_that_cannot_be_read_are_named(tmp_path):
    broken = tmp_path / "parts.obj"
    broken.write_text("o a\nv 0 0\nf 1 2 up\n")
    with pytest.raises(AssetError, match="is not an OBJ file of convex parts"):
        read_parts(broken)
    with pytest.raises(AssetError, match="No convex parts can be read"):
        read_parts(tmp_path / "none.obj")


SQUARES = """v 0 0 0
v 1 0 0
v 1 1 0
v 0 1 0
f 1/1 2/2/2 3//3 4
g none
o two
v 0 0 1
f -1 -3 -2
"""


def test_a_face_of_four_corners_is_two_triangles_and_negative_numbers_count_from_the_end() -> None:
    read = read_obj(SQUARES)
    one, two = read.groups
    np.testing.assert_array_equal(one, [(0, 1, 2), (0, 2, 3)])
    np.testing.assert_array_equal(two, [(4, 2, 3)])
    assert read.vertices.shape == (5, 3)


@pytest.mark.parametrize(
    ("lines", "groups"), [(("o b", "g b", " \tg\tb", "o "), 2), (("g", "usemtl b", "s 2", "object b"), 1)]
)
def test_objects_and_groups_begin_another_group_and_materials_do_not(lines, groups) -> None:
    for line in lines:
        assert len(read_obj(f"v 0 0 0\no a\nf 1 1 1\n{line}\nf 1 1 1\n").groups) == groups


@pytest.mark.parametrize("text", ["v zero 0 0\n", "v 0 0 0\nf a b c\n"])
def test_what_is_no_obj_file_is_an_error(text) -> None:
    with pytest.raises(ValueError, match=r"could not convert|invalid literal"):
        read_obj(text)


def test_triangles_are_those_that_were_written() -> None:
    ball = trimesh.creation.icosphere(subdivisions=1, radius=0.03)
    found = stl_triangles(ball.export(file_type="stl"))
    np.testing.assert_array_equal(found, ball.triangles.astype(np.float32))


def test_a_text_is_not_a_binary_file() -> None:
    assert stl_triangles(trimesh.creation.box().export(file_type="stl_ascii").encode()) is None
    assert stl_triangles(b"solid") is None
