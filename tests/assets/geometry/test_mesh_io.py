"""Reading and writing mesh files."""

import re

import pytest
import trimesh
from tests.assets.special_files import PLACES, make_places

from qdgrasp_assets.catalog import build_scene
from qdgrasp_assets.geometry.mesh import box
from qdgrasp_assets.geometry.mesh_io import (
    WRITABLE_FORMATS,
    read_mesh_file,
    to_bytes,
)
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


@pytest.mark.parametrize(("unit", "flag"), [("millimeter", "--units mm"), ("0.1 * meters", "--units 0.1")])
def test_a_unit_that_the_file_states_is_to_be_said(tmp_path, monkeypatch, unit, flag):
    """As 3MF and Collada do, which need packages of their own."""
    path = tmp_path / "part.ply"
    trimesh.creation.box(BLOCK).export(path)
    monkeypatch.setattr(trimesh.Scene, "units", unit)
    with pytest.raises(AssetError, match=rf"its unit is 0\.\d* m, .*: add {flag}, or --units m"):
        read_solid(path)
    assert read_draft(path, 1.0).mesh.extents == pytest.approx(BLOCK)


@pytest.mark.parametrize("suffix", WRITABLE_FORMATS)
def test_what_is_written_is_read_again(tmp_path, suffix):
    path = tmp_path / f"block{suffix}"
    path.write_bytes(to_bytes(box(BLOCK), suffix))
    draft = read_draft(path)
    assert (draft.repairs, draft.faults) == ((), ())
    assert draft.mesh.extents == pytest.approx(BLOCK)


@pytest.mark.parametrize("name", [*PLACES, "x" * 300 + ".stl"])
def test_what_is_no_ordinary_file_is_told_for_what_it_is(tmp_path, name):
    make_places(tmp_path)
    told = PLACES.get(name, "cannot be looked at (File name too long)")
    spec = RunSpec(gripper="panda", object=str(tmp_path / name), mass=1.0)
    for read in (lambda: read_mesh_file(tmp_path / name), lambda: build_scene(spec)):
        with pytest.raises(AssetError, match=re.escape(told)):
            read()
