import numpy as np
import pytest
import trimesh

from qdgrasp_assets.geometry.mesh import box, join, parts_to_obj, read_parts, stl_triangles

BLOCK = (0.02, 0.03, 0.05)


@pytest.mark.parametrize("shift", [(0.3, -0.2, 0.1), (-3e3, 6e3, 1e3), (4e5, 5.6e6, 120.0)])
def test_volume_and_centre_of_mass_do_not_depend_on_where_the_mesh_lies(shift):
    block = box(BLOCK)
    moved = block.moved(shift)
    assert moved.volume == pytest.approx(block.volume, rel=1e-5)
    assert moved.centre_of_mass - shift == pytest.approx(block.centre_of_mass, abs=1e-7)
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


def test_triangles_are_those_that_were_written() -> None:
    ball = trimesh.creation.icosphere(subdivisions=1, radius=0.03)
    found = stl_triangles(ball.export(file_type="stl"))
    np.testing.assert_array_equal(found, ball.triangles.astype(np.float32))
