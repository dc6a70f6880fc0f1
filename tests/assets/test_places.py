"""A pipe, a device or a folder in the place of an object's file is told, never waited for."""

import json
import re

import pytest
import trimesh
from tests.assets.places import PLACES, make_places

from qdgrasp_assets.catalog import build_scene
from qdgrasp_assets.mesh_file import read_mesh_file
from qdgrasp_protocol.errors import AssetError
from qdgrasp_protocol.spec import RunSpec

BLOCK = (0.02, 0.03, 0.05)


@pytest.mark.parametrize("name", [*PLACES, "x" * 300 + ".stl"])
def test_what_is_no_ordinary_file_is_told_for_what_it_is(tmp_path, name):
    make_places(tmp_path)
    told = PLACES.get(name, "cannot be looked at (File name too long)")
    spec = RunSpec(gripper="panda", object=str(tmp_path / name), mass=1.0)
    for read in (lambda: read_mesh_file(tmp_path / name), lambda: build_scene(spec)):
        with pytest.raises(AssetError, match=re.escape(told)):
            read()


def buffered(folder, name):
    """A glTF file whose triangles are in another file."""
    for file, content in trimesh.creation.box(BLOCK).export(file_type="gltf").items():
        (folder / file).write_bytes(content)
    model = json.loads((folder / "model.gltf").read_text())
    model["buffers"][0]["uri"] = name
    (folder / "model.gltf").write_text(json.dumps(model))
    return folder / "model.gltf"


def test_a_pipe_in_the_place_of_a_buffer_is_not_waited_for(tmp_path):
    make_places(tmp_path)
    assert read_mesh_file(buffered(tmp_path, "gltf_buffer_0.bin")).mesh.extents == pytest.approx(BLOCK)
    with pytest.raises(
        AssetError, match=r"'pipe\.stl', which it names, is no ordinary file; export it again"
    ):
        read_mesh_file(buffered(tmp_path, "pipe.stl"))


def test_a_pipe_in_the_place_of_materials_is_left_aside(tmp_path):
    make_places(tmp_path)
    text = trimesh.creation.box(BLOCK).export(file_type="obj")
    (tmp_path / "part.obj").write_text(f"mtllib pipe.stl\nusemtl red\n{text}")
    assert read_mesh_file(tmp_path / "part.obj").mesh.extents == pytest.approx(BLOCK)
