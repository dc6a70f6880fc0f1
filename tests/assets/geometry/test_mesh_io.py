"""Reading and writing mesh files."""

import base64
import json
import re

import numpy as np
import pytest
import trimesh
from tests.assets.special_files import PLACES, make_places

from qdgrasp_assets.catalog import build_scene
from qdgrasp_assets.geometry.mesh_io import read_mesh_file
from qdgrasp_assets.object_model import read_draft, read_solid
from qdgrasp_protocol.errors import AssetError
from qdgrasp_protocol.spec import RunSpec

BLOCK = (0.02, 0.03, 0.05)


@pytest.mark.parametrize(
    ("name", "content", "sentence"),
    [
        ("part.stl", "", r"is empty: the file has no bytes"),
        ("part.stl", "solid nothing\nendsolid nothing\n", r"is empty, or no \.stl file: it has no triangles"),
        ("part.obj", "v 0 0 0\nv 1 0 0\n", r"is empty, or no \.obj file|cannot be read as \.obj"),
        ("part.stl", "this is not a mesh " * 10, r"is empty, or no \.stl file"),
        ("part.glb", "this is not a mesh " * 10, r"cannot be read as \.glb: .*; export it again"),
        ("part.xyzzy", "anything", r"'\.xyzzy' is not among the formats \.stl, \.obj, \.ply"),
        ("part.stl", "version https://git-lfs.github.com/spec/v1\noid sha256:0\n", r"pointer of Git LFS"),
        ("part.obj", "\ufeff\n<!DOCTYPE html>\n<html><head>", r"is a web page, not the mesh"),
        (
            "part.obj",
            "v 0 0 nan\nv 1 0 0\nv 0 1 0\nf 1 2 3\n",
            r"vertices that are not finite \(nan or inf\)",
        ),
        (
            "part.3mf",
            "anything",
            r"\.3mf needs lxml and networkx, .*`pip install lxml networkx`, or export it",
        ),
    ],
)
def test_a_file_that_is_no_mesh_is_refused(tmp_path, monkeypatch, name, content, sentence):
    monkeypatch.setattr("trimesh.exchange.load.mesh_formats", lambda: {"stl", "obj", "ply", "off", "glb"})
    path = tmp_path / name
    path.write_text(content)
    with pytest.raises(AssetError, match=sentence) as refused:
        read_mesh_file(path)
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize(("unit", "flag"), [("millimeter", "--units mm"), ("0.1 * meters", "--units 0.1")])
def test_a_unit_that_the_file_states_is_to_be_said(tmp_path, monkeypatch, unit, flag):
    """As 3MF and Collada do, which need packages of their own."""
    path = tmp_path / "part.ply"
    trimesh.creation.box(BLOCK).export(path)
    monkeypatch.setattr(trimesh.Scene, "units", unit)
    with pytest.raises(AssetError, match=rf"its unit is 0\.\d* m, .*: add {flag}, or --units m"):
        read_solid(path)
    assert read_draft(path, 1.0).mesh.extents == pytest.approx(BLOCK)


@pytest.mark.parametrize("name", [*PLACES, "x" * 300 + ".stl"])
def test_what_is_no_ordinary_file_is_told_for_what_it_is(tmp_path, name):
    make_places(tmp_path)
    told = PLACES.get(name, "cannot be looked at (File name too long)")
    spec = RunSpec(gripper="panda", object=str(tmp_path / name), mass=1.0)
    for read in (lambda: read_mesh_file(tmp_path / name), lambda: build_scene(spec)):
        with pytest.raises(AssetError, match=re.escape(told)):
            read()


TEXTS = {
    "latin-1": "Gehäuse für Prüfung",
    "gbk": "测试模型零件",
}


@pytest.mark.parametrize(("encoding", "text"), TEXTS.items())
@pytest.mark.parametrize(
    ("suffix", "before", "after"),
    [
        ("obj", "f ", "# {0}\nmtllib part.mtl\no {0}\nusemtl {0}\nf "),
        ("ply", "element vertex", "comment {0}\nelement vertex"),
    ],
)
def test_comments_and_names_may_have_any_encoding(tmp_path, encoding, text, suffix, before, after):
    options = {"encoding": "ascii"} if suffix == "ply" else {}
    whole = trimesh.creation.box(BLOCK).export(file_type=suffix, **options)
    whole = whole if isinstance(whole, str) else whole.decode()
    (tmp_path / "part.mtl").write_bytes(f"# {text}\nnewmtl {text}\nmap_Kd {text}.png\n".encode(encoding))
    path = tmp_path / f"part.{suffix}"
    path.write_bytes(whole.replace(before, after.format(text), 1).encode(encoding))
    assert read_mesh_file(path).mesh.volume == pytest.approx(np.prod(BLOCK))


def quantised(path, kind, **more):
    """A glTF file of two blocks whose corners are normalised integers, from 0 to 1 within a cube of 0.1 m."""
    block, codes = trimesh.creation.box(BLOCK), {"int8": 5120, "uint8": 5121, "int16": 5122, "uint16": 5123}
    corners = np.zeros((8, 4), kind)
    corners[:, :3] = np.round((block.vertices * 10 + 0.5) * np.iinfo(kind).max)
    faces = block.faces.astype("<u2").tobytes()
    data = faces + corners.tobytes()
    position = {"bufferView": 1, "componentType": codes[kind], "count": 8, "type": "VEC3", "normalized": True}
    document = {
        "asset": {"version": "2.0"},
        "buffers": [{"byteLength": len(data), "uri": DATA_URI + base64.b64encode(data).decode()}],
        "bufferViews": [
            {"buffer": 0, "byteLength": len(faces)},
            {
                "buffer": 0,
                "byteOffset": len(faces),
                "byteLength": corners.nbytes,
                "byteStride": corners.strides[0],
            },
        ],
        "accessors": [{"bufferView": 0, "componentType": 5123, "count": 36, "type": "SCALAR"}, position],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 1}, "indices": 0}] * 2}],
        "nodes": [{"mesh": 0, "scale": [0.1] * 3}],
        "scenes": [{"nodes": [0]}],
        **more,
    }
    path.write_text(json.dumps(document))
    return path


DATA_URI = "data:application/octet-stream;base64,"


@pytest.mark.parametrize("kind", ["int8", "uint8", "int16", "uint16"])
def test_quantised_corners_are_as_large_as_they_stand_for(tmp_path, kind):
    path = quantised(tmp_path / "part.gltf", kind, extensionsRequired=["KHR_mesh_quantization"])
    assert read_mesh_file(path).mesh.extents == pytest.approx(BLOCK, abs=0.1 / np.iinfo(kind).max)


@pytest.mark.parametrize("name", ["KHR_draco_mesh_compression", "EXT_meshopt_compression", "ACME_shape"])
def test_an_extension_that_geometry_needs_is_refused_by_its_name(tmp_path, monkeypatch, name):
    monkeypatch.setattr("qdgrasp_assets.geometry.mesh_io.find_spec", lambda _: None)
    path = quantised(tmp_path / "part.gltf", "int16", extensionsRequired=["KHR_materials_unlit", name])
    with pytest.raises(AssetError, match=rf"needs the glTF extension {name}, which is not read"):
        read_mesh_file(path)
