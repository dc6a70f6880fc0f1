"""Reading and writing mesh files."""

import json
import os
import re
from pathlib import Path

import numpy as np
import pytest
import trimesh
from tests.assets.special_files import PLACES, make_places

from qdgrasp_assets.catalog import build_scene
from qdgrasp_assets.geometry import mesh_io
from qdgrasp_assets.geometry.mesh_io import (
    LARGEST_FILE,
    UNITS,
    WRITABLE_FORMATS,
    linked_files,
    read_mesh_file,
    scale_advice,
    scale_in_words,
    scale_of,
    stated_triangles,
    to_bytes,
)
from qdgrasp_assets.geometry.primitives import box
from qdgrasp_assets.mesh_check import check_mesh
from qdgrasp_assets.object_model import read_draft, read_solid
from qdgrasp_protocol.build_messages import MeshPreparation
from qdgrasp_protocol.errors import AssetError, ImpossibleValue, InputError, UnknownName
from qdgrasp_protocol.spec import RunSpec

BLOCK = (0.02, 0.03, 0.05)
MILLIMETRES = """<?xml version="1.0" encoding="utf-8"?>
<COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1"/>"""


@pytest.mark.parametrize(
    ("name", "content", "sentence"),
    [
        ("part.stl", "", r"is empty: the file has no bytes"),
        ("part.stl", "solid nothing\nendsolid nothing\n", r"is empty, or no \.stl file: it has no triangles"),
        ("part.obj", "v 0 0 0\nv 1 0 0\n", r"is empty, or no \.obj file|cannot be read as \.obj"),
        ("part.stl", "this is not a mesh " * 10, r"is empty, or no \.stl file"),
        ("part.glb", "this is not a mesh " * 10, r"cannot be read as \.glb: .*; export it again"),
        ("part.xyzzy", "anything", r"'\.xyzzy' is not among the formats \.stl, \.obj, \.ply"),
        ("part.zip", "anything", r"'\.zip' is not among the formats"),
        ("part", "anything", r"'' is not among the formats"),
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
        ("part.dae", "anything", r"\.dae needs pycollada, .*`pip install pycollada`"),
        ("part.step", "anything", r"\.step needs cascadio"),
    ],
)
def test_a_file_that_is_no_mesh_is_refused(tmp_path, monkeypatch, name, content, sentence):
    monkeypatch.setattr("trimesh.exchange.load.mesh_formats", lambda: {"stl", "obj", "ply", "off", "glb"})
    path = tmp_path / name
    path.write_text(content)
    with pytest.raises(AssetError, match=sentence) as refused:
        read_mesh_file(path)
    assert "\n" not in str(refused.value)


def test_a_folder_is_told_from_a_file(tmp_path):
    with pytest.raises(AssetError, match=r"is a folder, .* `qdgrasp campaign --objects .*` takes every mesh"):
        read_mesh_file(tmp_path)


def test_a_cloud_of_points_is_no_surface(tmp_path):
    path = tmp_path / "cloud.ply"
    trimesh.PointCloud(np.random.default_rng(0).random((9, 3))).export(path)
    with pytest.raises(AssetError, match=r"has no triangles; an object needs a surface, and points or lines"):
        read_mesh_file(path)


@pytest.mark.parametrize(("unit", "flag"), [("millimeter", "--units mm"), ("0.1 * meters", "--scale 0.1")])
def test_a_unit_that_the_file_states_is_to_be_said(tmp_path, monkeypatch, unit, flag):
    """As 3MF and Collada do, which need packages of their own."""
    path = tmp_path / "part.ply"
    trimesh.creation.box(BLOCK).export(path)
    monkeypatch.setattr(trimesh.Scene, "units", unit)
    with pytest.raises(AssetError, match=rf"its unit is 0\.\d* m, .*: add {flag}, or --units m"):
        read_solid(path)
    assert read_draft(path, 1.0).mesh.extents == pytest.approx(BLOCK)


def test_a_unit_that_nobody_knows_is_none(tmp_path, monkeypatch):
    path = tmp_path / "part.ply"
    trimesh.creation.box(BLOCK).export(path)
    monkeypatch.setattr(trimesh.Scene, "units", "cubits")
    assert read_mesh_file(path).unit is None


@pytest.mark.parametrize("suffix", WRITABLE_FORMATS)
def test_what_is_written_is_read_again(tmp_path, suffix):
    path = tmp_path / f"block{suffix}"
    path.write_bytes(to_bytes(box(BLOCK), suffix))
    draft = read_draft(path)
    assert (draft.repairs, draft.faults) == ((), ())
    assert draft.mesh.extents == pytest.approx(BLOCK)


def test_every_format_that_is_named_is_read_or_needs_a_package():
    from trimesh.exchange.load import mesh_formats

    assert {kind.removeprefix(".") for kind in mesh_io.READABLE_FORMATS} <= mesh_formats()
    assert (
        mesh_formats()
        <= {kind.removeprefix(".") for kind in (*mesh_io.READABLE_FORMATS, *mesh_io.FORMAT_PACKAGES)} | OTHERS
    )


OTHERS = {"stl_ascii", "xyz"}
"""Another name, and points alone."""


def test_a_damaged_stl_is_told_for_what_it_is(tmp_path):
    """Binary rubbish gives no advice about packages."""
    path = tmp_path / "part.stl"
    path.write_bytes(bytes(80) + b"\xff" * 4)
    with pytest.raises(AssetError, match=r"part\.stl' (is damaged|cannot be read)") as refused:
        read_mesh_file(path)
    assert "module" not in str(refused.value).lower()


def test_a_file_that_is_too_large_is_refused_before_it_is_read(tmp_path: Path) -> None:
    part = tmp_path / "part.stl"
    part.touch()
    os.truncate(part, LARGEST_FILE + 1)
    with pytest.raises(AssetError, match=r"part\.stl' has 1073741825 bytes, and at most 1 GiB are read"):
        read_mesh_file(part)


def test_a_unit_is_a_scale():
    assert {unit: scale_of(unit, None) for unit in UNITS} == {"mm": 0.001, "cm": 0.01, "m": 1.0, "in": 0.0254}
    assert scale_of(None, 0.3) == 0.3
    assert scale_of(None, None) is None


IMPOSSIBLE = r"--scale must be a number greater than 0 and at most 1000000 .*got"


@pytest.mark.parametrize(
    ("units", "scale", "error", "sentence"),
    [
        ("mm", 2.0, InputError, r"--units mm means --scale 0\.001: give only one"),
        ("furlong", None, UnknownName, r"Unknown unit 'furlong'\. Known: cm, in, m, mm\."),
        *((None, scale, ImpossibleValue, IMPOSSIBLE) for scale in (0.0, -1.0, float("nan"), 1e7)),
    ],
)
def test_what_is_no_unit_or_scale_is_refused_in_a_sentence(units, scale, error, sentence):
    with pytest.raises(error, match=sentence):
        scale_of(units, scale)


@pytest.mark.parametrize(
    ("largest", "words"),
    [
        (120.0, "it looks like millimetres: add --units mm"),
        (
            5.0,
            "it looks like millimetres or centimetres or inches: add --units mm or --units cm or --units in",
        ),
        (3e6, "say how many metres a unit of the file is with --scale"),
        (1e-4, "say how many metres a unit of the file is with --scale"),
    ],
)
def test_what_a_drawing_looks_like_follows_from_its_size(largest, words):
    assert scale_advice(largest) == words


def test_a_scale_is_told_as_the_flag_that_means_it():
    flags = ["--units mm", "--units in", "--units m", "--scale 0.5"]
    assert [scale_in_words(scale) for scale in (0.001, 0.0254, 1.0, 0.5)] == flags


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
    sentence = r"'pipe\.stl', which it names, is no ordinary file; export it again"
    with pytest.raises(AssetError, match=sentence):
        read_mesh_file(buffered(tmp_path, "pipe.stl"))


def test_a_pipe_in_the_place_of_materials_is_left_aside(tmp_path):
    make_places(tmp_path)
    text = trimesh.creation.box(BLOCK).export(file_type="obj")
    (tmp_path / "part.obj").write_text(f"mtllib pipe.stl\nusemtl red\n{text}")
    assert read_mesh_file(tmp_path / "part.obj").mesh.extents == pytest.approx(BLOCK)


@pytest.mark.parametrize("suffix", [".stl", ".ply", ".off", ".glb", ".gltf"])
def test_a_header_states_as_many_triangles_as_are_read(tmp_path, suffix):
    path = tmp_path / f"ball{suffix}"
    if suffix == ".gltf":
        for name, content in trimesh.exchange.gltf.export_gltf(trimesh.creation.icosphere().scene()).items():
            (tmp_path / name.replace("model.gltf", path.name)).write_bytes(content)
    else:
        trimesh.creation.icosphere().export(path)
    assert stated_triangles(path) == len(read_mesh_file(path).mesh.faces) == 1280


@pytest.mark.parametrize("block", [3, 8, 11, 64, 1 << 20])
def test_lines_of_a_text_are_counted_whatever_stands_at_the_end_of_a_block(tmp_path, monkeypatch, block):
    monkeypatch.setattr(mesh_io, "TEXT_BLOCK", block)
    faces = ["f 1 2 3", "f\t1 2 3", "f 1/1 2/2 3/3 4/4"]
    (tmp_path / "a.obj").write_text("\n".join(["v 0 0 0", "vf 1", *faces, "# f 1 2 3", "usemtl f x"]))
    assert stated_triangles(tmp_path / "a.obj") == 3
    facet = "facet normal 0 0 1\nouter loop\n" + "vertex 0 0 0\n" * 3 + "endloop\nendfacet\n"
    (tmp_path / "a.stl").write_text(f"solid a\n{5 * facet}endsolid\n")
    assert stated_triangles(tmp_path / "a.stl") == 5


BOX_PLY = b"ply\nformat ascii 1.0\nelement vertex 8\n"
GLB_HEAD = b"glTF\x02\0\0\0\x28\0\0\0"


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("text.stl", b"solid ball\n" + b"facet normal 0 0 1\n" * 9),
        ("short.stl", b"\0" * 20),
        ("long.stl", b"\0" * 80 + b"\xff" * 4 + b"\0" * 50),
        ("points.obj", b"v 0 0 0\nv 1 0 0\nof 1 1 1\n"),
        ("none.ply", BOX_PLY + b"end_header\nelement face 99999999\n"),
        ("letters.ply", BOX_PLY + b"element face many\nend_header\n"),
        ("words.off", b"OFF\neight twelve\n"),
        ("short.glb", b"glT"),
        ("huge.glb", GLB_HEAD + b"\xff\xff\xff\xffJSON{}"),
        ("list.glb", GLB_HEAD + b"\x02\0\0\0JSON[]"),
        (
            "odd.glb",
            GLB_HEAD + b"\x3a\0\0\0JSON" + b'{"accessors": [], "meshes": [{"primitives": [{"mode":4}]}]}',
        ),
        ("text.gltf", b"\xff\xfe no json"),
    ],
)
def test_a_header_that_is_none_states_nothing(tmp_path, name, content):
    (tmp_path / name).write_bytes(content)
    assert stated_triangles(tmp_path / name) is None
    with pytest.raises(AssetError):
        read_solid(tmp_path / name)


@pytest.mark.parametrize("suffix", [".stl", ".ply", ".glb", ".off", ".obj", "_text.stl"])
def test_what_is_too_large_is_refused_before_it_is_read(tmp_path, monkeypatch, suffix):
    path = tmp_path / f"ball{suffix}"
    kind = "stl_ascii" if "text" in suffix else None
    trimesh.creation.icosphere(subdivisions=4, radius=0.03).export(path, file_type=kind)
    monkeypatch.setattr("qdgrasp_assets.object_model.MOST_TRIANGLES", 1000)
    monkeypatch.setattr("qdgrasp_assets.object_model.MOST_PREPARED", 5000)
    monkeypatch.setattr(mesh_io, "_load_scene", lambda path: pytest.fail("it was read"))
    with pytest.raises(AssetError, match=r"5120 triangles, and at most 1000 .* with --simplify 20000"):
        read_draft(path)
    with pytest.raises(AssetError, match=r"5120 triangles, and at most 5000 .*in the program that made it"):
        read_draft(path, preparation=MeshPreparation(simplify=100))


def test_a_large_mesh_is_simplified_where_that_is_asked_for(tmp_path, monkeypatch):
    path = tmp_path / "ball.ply"
    trimesh.creation.icosphere(subdivisions=4, radius=0.03).export(path)
    monkeypatch.setattr("qdgrasp_assets.object_model.MOST_TRIANGLES", 1000)
    found = read_draft(path, preparation=MeshPreparation(simplify=800))
    assert (found.faults, found.repairs) == ((), ("simplified from 5120 to 800 triangles",))


def test_a_file_that_could_not_be_read_is_checked_again(tmp_path, monkeypatch):
    def failing(*_given, **_named):
        raise MemoryError

    monkeypatch.setenv("QDGRASP_CACHE", str(tmp_path / "cache"))
    file = tmp_path / "block.stl"
    trimesh.creation.box(BLOCK).export(file)
    with monkeypatch.context() as context:
        context.setattr(trimesh, "load_scene", failing)
        assert "MemoryError" in check_mesh(file).faults[0]
    assert check_mesh(file).faults == ()


def test_files_beside_a_gltf_are_part_of_its_content(tmp_path, monkeypatch):
    monkeypatch.setenv("QDGRASP_CACHE", str(tmp_path / "cache"))
    for name, content in trimesh.exchange.gltf.export_gltf(trimesh.creation.box(BLOCK).scene()).items():
        (tmp_path / name).write_bytes(content)
    file = tmp_path / "model.gltf"
    assert not check_mesh(file).faults
    for other in linked_files(file):
        other.unlink()
    assert check_mesh(file).faults
