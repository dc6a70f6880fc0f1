"""`qdgrasp object check`: its report, pictures, files and refusals."""

from pathlib import Path

import pytest
import trimesh
from typer.testing import CliRunner

from qdgrasp_assets.object_model import read_draft
from qdgrasp_protocol.errors import AssetError, ImpossibleValue, UnknownName
from qdgrasp_tools.cli.asset_commands import is_drawn_here, object_app

BLOCK = (0.02, 0.03, 0.05)


@pytest.fixture
def check(tmp_path, monkeypatch):
    """`qdgrasp object check` in a folder of its own."""
    monkeypatch.setenv("QDGRASP_CACHE", str(tmp_path / "cache"))
    monkeypatch.setattr("qdgrasp_tools.rendering.drawings.PORTRAIT_PIXELS", 120)
    monkeypatch.chdir(tmp_path)
    return lambda *words: CliRunner().invoke(object_app, ["check", *map(str, words)])


def block() -> trimesh.Trimesh:
    return trimesh.creation.box(BLOCK)


def test_a_good_object_is_described_and_the_next_command_is_named(check):
    block().apply_scale(1000).export("my part.stl")
    done = check("my part.stl", "--units", "mm", "--mass", 0.1)
    assert done.exit_code == 0
    for words in (
        "0.0200 x 0.0300 x 0.0500 m (--units mm)",
        "30.00 cm3",
        "0.1 kg, 3333 kg/m3",
        "2.833e-05",
        "next: qdgrasp run --gripper panda --object 'my part.stl' --units mm --mass 0.1",
    ):
        assert words in done.stdout


def test_what_was_repaired_is_said_and_written(check):
    inverted = block()
    inverted.invert()
    inverted.export("part.stl")
    done = check("part.stl", "--mass", 0.1, "--repaired", "right.stl")
    assert "repaired         its triangles turned: it was inside out" in done.stdout
    assert "written: right.stl, in metres, with 12 triangles" in done.stdout
    assert "next: qdgrasp run --gripper panda --object right.stl --mass 0.1" in done.stdout
    assert read_draft(Path("right.stl")).repairs == ()


def test_an_object_is_drawn_also_where_it_is_open(check):
    ball = trimesh.creation.icosphere(subdivisions=2, radius=0.03)
    trimesh.Trimesh(ball.vertices, ball.faces[1:], process=False).export("part.ply")
    assert "drawn: pictures/part.png" in check("part.ply", "--picture", "pictures").stdout
    assert Path("pictures/part.png").read_bytes()[:4] == b"\x89PNG"
    assert is_drawn_here(Path("pictures/part.png"))
    assert "drawn: pictures/part.png" in check("part.ply", "--picture", "pictures").stdout


@pytest.mark.parametrize(
    ("flags", "error", "words"),
    [
        (("--mass", 0), ImpossibleValue, r"mass must be a number greater than 0 .*, got 0\.0"),
        (("--mass", -1), ImpossibleValue, r"mass must be"),
        (("--units", -1), ImpossibleValue, r"units must be .*0\.001 for mm\), got -1"),
        (("--units", "nan"), ImpossibleValue, r"units must be"),
        (("--units", "ft"), UnknownName, r"Unknown unit 'ft'\. Known: cm, in, m, mm"),
        (("--units", "mm"), AssetError, r"correct the 2 faults that are listed"),
    ],
)
def test_flags_that_cannot_be_are_refused_in_one_sentence(check, flags, error, words):
    block().export("part.stl")
    done = check("part.stl", *flags)
    assert isinstance(done.exception, error)
    assert done.exception.exit_code == 2
    with pytest.raises(error, match=words):
        raise done.exception


@pytest.mark.parametrize("way", ["remesh", "hull"])
def test_a_mesh_that_cannot_be_used_has_a_way_out(check, tmp_path, way):
    trimesh.Trimesh(block().vertices, block().faces[2:], process=False).export(tmp_path / "part.ply")
    assert isinstance(check("part.ply", "--no-parts").exception, AssetError)
    done = check("part.ply", "--mass", 0.1, "--no-parts", "--mesh", f"simplify=500,{way}")
    assert done.exit_code == 0
    assert f"--object part.ply --mass 0.1 --mesh simplify=500,{way}" in done.stdout
    assert "repaired" in done.stdout
