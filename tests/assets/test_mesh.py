import logging
from pathlib import Path

import numpy as np
import pytest
import trimesh

from qdgrasp_assets.mesh import join, parts_to_obj, read_parts, read_solid
from qdgrasp_assets.objects.solids import box
from qdgrasp_protocol.errors import AssetError

BLOCK = (0.02, 0.03, 0.05)


def write(path: Path, mesh: trimesh.Trimesh) -> Path:
    mesh.export(path)
    return path


@pytest.mark.parametrize("suffix", [".stl", ".obj", ".ply", ".off", ".glb"])
def test_a_solid_is_read_from_any_format(tmp_path, suffix):
    block = trimesh.creation.box(BLOCK, transform=trimesh.transformations.translation_matrix((0.1, 0, 0)))
    mesh = read_solid(write(tmp_path / f"block{suffix}", block))
    assert mesh.volume == pytest.approx(np.prod(BLOCK), rel=1e-5)
    assert mesh.extents == pytest.approx(BLOCK, rel=1e-5)
    assert mesh.centre_of_mass == pytest.approx([0.1, 0, 0], abs=1e-6)


def test_volume_and_centre_of_mass_do_not_depend_on_where_the_mesh_lies():
    block = box(BLOCK)
    shift = np.array([0.3, -0.2, 0.1])
    moved = block.moved(shift)
    assert moved.volume == pytest.approx(block.volume)
    assert moved.centre_of_mass == pytest.approx(block.centre_of_mass + shift)
    assert block.flipped().volume == pytest.approx(-block.volume)
    assert block.flipped().normals == pytest.approx(-block.normals)


def test_several_bodies_are_one_object(tmp_path):
    pair = trimesh.util.concatenate(
        [trimesh.creation.box(BLOCK), trimesh.creation.icosphere(radius=0.01).apply_translation((0.1, 0, 0))]
    )
    mesh = read_solid(write(tmp_path / "pair.stl", pair))
    assert mesh.volume == pytest.approx(pair.volume, rel=1e-4)


def test_a_mesh_that_is_inside_out_is_turned_with_a_warning(tmp_path, caplog):
    block = trimesh.creation.box(BLOCK)
    block.invert()
    with caplog.at_level(logging.WARNING):
        mesh = read_solid(write(tmp_path / "block.stl", block))
    assert mesh.volume > 0
    assert "is inside out" in caplog.text


def open_box() -> trimesh.Trimesh:
    mesh = trimesh.creation.box(BLOCK)
    return trimesh.Trimesh(mesh.vertices, mesh.faces[1:])


def box_with_one_turned_face() -> trimesh.Trimesh:
    mesh = trimesh.creation.box(BLOCK)
    faces = mesh.faces.copy()
    faces[0] = faces[0][::-1]
    return trimesh.Trimesh(mesh.vertices, faces, process=False)


def sheet() -> trimesh.Trimesh:
    corners = [(0, 0, 0), (0.1, 0, 0), (0, 0.1, 0)]
    return trimesh.Trimesh(corners, [(0, 1, 2), (2, 1, 0)], process=False)


@pytest.mark.parametrize(
    ("mesh", "sentence"),
    [
        (
            trimesh.creation.box((20, 30, 50)),
            r"is 20 x 30 x 50 m large, so it looks like millimetres; .* 0\.001",
        ),
        (open_box(), "is not watertight"),
        (box_with_one_turned_face(), "wound both ways"),
        (sheet(), "is flat"),
    ],
)
def test_a_mesh_that_is_no_solid_in_metres_is_refused(tmp_path, mesh, sentence):
    with pytest.raises(AssetError, match=sentence) as refused:
        read_solid(write(tmp_path / "part.ply", mesh))
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize(
    ("name", "content", "sentence"),
    [
        ("part.stl", "", r"is empty: the file has no bytes"),
        ("part.stl", "solid nothing\nendsolid nothing\n", r"is empty: it has no triangles|cannot be read"),
        ("part.obj", "v 0 0 0\nv 1 0 0\n", r"is empty: it has no triangles|cannot be read"),
        ("part.stl", "this is not a mesh " * 10, r"cannot be read|is empty"),
        ("part.xyzzy", "anything", r"cannot be read"),
        ("part.obj", "v 0 0 nan\nv 1 0 0\nv 0 1 0\nf 1 2 3\n", r"not finite|is empty|cannot be read"),
    ],
)
def test_a_file_that_is_no_mesh_is_refused(tmp_path, name, content, sentence):
    path = tmp_path / name
    path.write_text(content)
    with pytest.raises(AssetError, match=sentence) as refused:
        read_solid(path)
    assert "\n" not in str(refused.value)


def test_a_mesh_that_is_not_there_is_named(tmp_path):
    with pytest.raises(AssetError, match=r"No mesh file at '.*none.stl'"):
        read_solid(tmp_path / "none.stl")


def test_parts_survive_the_round_trip_through_an_obj_file(tmp_path):
    parts = (box(BLOCK), box(BLOCK).moved((0.1, 0.2, 0.3)))
    path = tmp_path / "parts.obj"
    path.write_bytes(parts_to_obj(parts))
    for found, given in zip(read_parts(path), parts, strict=True):
        assert found.vertices == pytest.approx(given.vertices, abs=1e-9)
        assert (found.faces == given.faces).all()


def test_joined_meshes_enclose_what_they_did_alone():
    parts = (box(BLOCK), box(BLOCK).moved((0.1, 0.2, 0.3)))
    assert join(parts).volume == pytest.approx(2 * np.prod(BLOCK))


def test_parts_that_cannot_be_read_are_named(tmp_path):
    broken = tmp_path / "parts.obj"
    broken.write_text("o a\nv 0 0\nf 1 2 up\n")
    with pytest.raises(AssetError, match="is not an OBJ file of convex parts"):
        read_parts(broken)
    with pytest.raises(AssetError, match="No convex parts can be read"):
        read_parts(tmp_path / "none.obj")
