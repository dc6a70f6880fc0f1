"""Reading and writing mesh files."""

import os
from pathlib import Path

import numpy as np
import pytest
import trimesh

from qdgrasp_assets import mesh_file
from qdgrasp_assets.mesh_file import LARGEST, WRITTEN, read_mesh_file, to_bytes
from qdgrasp_assets.objects.solids import box
from qdgrasp_assets.solid import read_draft, read_solid
from qdgrasp_protocol.errors import AssetError

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


def test_a_mesh_that_is_not_there_is_named(tmp_path):
    with pytest.raises(AssetError, match=r"No mesh file at '.*none.stl'"):
        read_mesh_file(tmp_path / "none.stl")


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


@pytest.mark.parametrize("suffix", WRITTEN)
def test_what_is_written_is_read_again(tmp_path, suffix):
    path = tmp_path / f"block{suffix}"
    path.write_bytes(to_bytes(box(BLOCK), suffix))
    draft = read_draft(path)
    assert (draft.repairs, draft.faults) == ((), ())
    assert draft.mesh.extents == pytest.approx(BLOCK)


def test_every_format_that_is_named_is_read_or_needs_a_package():
    from trimesh.exchange.load import mesh_formats

    assert {kind.removeprefix(".") for kind in mesh_file.ALWAYS} <= mesh_formats()
    assert (
        mesh_formats() <= {kind.removeprefix(".") for kind in (*mesh_file.ALWAYS, *mesh_file.NEEDED)} | OTHERS
    )


OTHERS = {"stl_ascii", "xyz"}
"""Another name, and points alone."""


def test_a_damaged_stl_is_told_for_what_it_is(tmp_path):
    """What is no text either is no question of packages."""
    path = tmp_path / "part.stl"
    path.write_bytes(bytes(80) + b"\xff" * 4)
    with pytest.raises(AssetError, match=r"part\.stl' (is damaged|cannot be read)") as refused:
        read_mesh_file(path)
    assert "module" not in str(refused.value).lower()


def test_a_file_that_is_too_large_is_refused_before_it_is_read(tmp_path: Path) -> None:
    part = tmp_path / "part.stl"
    part.touch()
    os.truncate(part, LARGEST + 1)
    with pytest.raises(AssetError, match=r"part\.stl' has 1073741825 bytes, and at most 1 GiB are read"):
        read_mesh_file(part)
