"""`qdgrasp object check`: its report, pictures, files and refusals."""

import json
from pathlib import Path

import msgspec
import numpy as np
import pytest
import trimesh
from typer.testing import CliRunner

from qdgrasp_assets.asset_report import ObjectReport
from qdgrasp_assets.geometry.collision_parts import DecompositionTimeout
from qdgrasp_assets.object_model import read_draft
from qdgrasp_coordinator.storage.outputs import is_drawn_here
from qdgrasp_protocol.errors import AssetError, FolderError, ImpossibleValue, UnknownName
from qdgrasp_tools.cli.object_commands import object_app

BLOCK = (0.02, 0.03, 0.05)


@pytest.fixture
def check(tmp_path, monkeypatch):
    """`qdgrasp object check` in a folder of its own."""
    monkeypatch.setenv("QDGRASP_CACHE", str(tmp_path / "cache"))
    monkeypatch.chdir(tmp_path)
    return lambda *words: CliRunner().invoke(object_app, ["check", *map(str, words)])


def block() -> trimesh.Trimesh:
    return trimesh.creation.box(BLOCK)


def without(*faces: int) -> trimesh.Trimesh:
    ball = trimesh.creation.icosphere(subdivisions=3, radius=0.03)
    return trimesh.Trimesh(ball.vertices, np.delete(ball.faces, faces, axis=0), process=False)


def found(done) -> ObjectReport:
    return msgspec.convert(json.loads(done.stdout), ObjectReport)


def test_a_good_object_is_described_and_the_next_command_is_named(check):
    block().apply_scale(1000).export("my part.stl")
    done = check("my part.stl", "--units", "mm", "--mass", 0.1)
    assert done.exit_code == 0
    for words in (
        "0.0200 x 0.0300 x 0.0500 m (--units mm)",
        "12 triangles, closed",
        "30.00 cm3",
        "0.1 kg, 3333 kg/m3",
        "0.0000 0.0000 0.0000 m, frame of the mesh file",
        "2.833e-05",
        "616",
        "1, own hull",
        "nothing had to be",
        "next: qdgrasp run --gripper panda --object 'my part.stl' --units mm --mass 0.1",
    ):
        assert words in done.stdout


def test_the_same_is_said_to_machines(check):
    block().export("part.stl")
    one = found(check("part.stl", "--units", 2, "--mass", 0.8, "--json"))
    assert one.extents == pytest.approx(np.multiply(BLOCK, 2))
    assert (one.scale, one.mass, one.density) == (2, 0.8, pytest.approx(0.8 / 2.4e-4))
    x, y, z = np.square(one.extents)
    assert np.diag(one.inertia) == pytest.approx(0.8 / 12 * np.array([y + z, x + z, x + y]))
    assert one.convex.count == 1
    assert (one.repairs, one.notes, one.faults) == ((), (), ())


def test_the_convex_parts_are_looked_for_unless_that_is_left_out(check, monkeypatch):
    def none(*_arguments):
        raise AssertionError

    monkeypatch.setattr("qdgrasp_assets.asset_report.collision_parts", none)
    block().export("part.stl")
    assert "not looked for" in check("part.stl", "--no-parts").stdout


def test_parts_that_are_not_found_in_time_are_a_fault(check, monkeypatch):
    def decompose(_mesh, name, _threshold, time_limit):
        raise DecompositionTimeout(name, time_limit)

    monkeypatch.setattr("qdgrasp_assets.geometry.collision_parts.decompose", decompose)
    trimesh.creation.annulus(0.02, 0.03, 0.05).export("ring.stl")
    done = check("ring.stl", "--mass", 0.1, "--time-limit", 7)
    assert "WRONG            CoACD did not decompose the mesh 'ring.stl'" in done.stdout
    assert "within 7 s; simplify the mesh" in done.stdout
    assert "correct the fault that is listed" in str(done.exception)


def test_two_bodies_that_are_apart_are_one_object_only_if_that_is_said(check):
    trimesh.util.concatenate([block(), block().apply_translation((0.05, 0, 0))]).export("two.stl")
    done = check("two.stl", "--mass", 0.1, "--no-parts")
    assert isinstance(done.exception, AssetError)
    assert "WRONG            it is of bodies with about 0.03 m of air between them" in done.stdout
    assert "or say with --mesh glued that they are moved as one" in done.stdout
    done = check("two.stl", "--mass", 0.1, "--no-parts", "--mesh", "glued")
    assert done.exit_code == 0
    assert "bodies           2" in done.stdout
    assert "its 2 bodies are moved as one rigid object, as if they were glued" in done.stdout


def test_a_rod_that_floats_in_a_ring_is_an_object_of_its_own(check):
    rod, ring = trimesh.creation.cylinder(0.01, 0.1), trimesh.creation.annulus(0.015, 0.03, 0.02)
    trimesh.util.concatenate([rod, ring]).export("bearing.stl")
    done = check("bearing.stl", "--mass", 0.1, "--no-parts")
    assert "it is of bodies with about 0.005 m of air between them" in done.stdout
    assert check("bearing.stl", "--mass", 0.1, "--no-parts", "--mesh", "glued").exit_code == 0


@pytest.mark.parametrize("shift", [0.02, 0.0205])
def test_bodies_that_meet_are_one_object_without_a_word_for_it(check, shift):
    trimesh.util.concatenate([block(), block().apply_translation((shift, 0, 0))]).export("pair.stl")
    assert check("pair.stl", "--mass", 0.1, "--no-parts").exit_code == 0


def test_a_surface_that_cuts_itself_is_told_of(check):
    trimesh.util.concatenate([block(), block().apply_translation((0.01, 0, 0))]).export("cut.stl")
    assert (
        "% of its surface lies inside it, where it cuts itself or bodies overlap" in check("cut.stl").stdout
    )


def test_a_hollow_is_told_from_a_body(check):
    hollow = block().apply_scale(0.5)
    hollow.invert()
    trimesh.util.concatenate([block(), hollow]).export("hollow.stl")
    done = check("hollow.stl", "--no-parts")
    assert "bodies           1, with 1 hollow within" in done.stdout
    assert "no finger reaches it" in done.stdout


@pytest.mark.parametrize(
    ("mass", "words"),
    [(300, "denser than lead"), (0.0001, "lighter than foam"), (None, "of water it would be 0.03 kg")],
)
def test_a_mass_is_weighed_against_the_volume(check, mass, words):
    block().export("part.stl")
    assert words in check("part.stl", *(() if mass is None else ("--mass", mass))).stdout


def test_what_was_repaired_is_said_and_written(check):
    inverted = block()
    inverted.invert()
    inverted.export("part.stl")
    done = check("part.stl", "--mass", 0.1, "--repaired", "right.stl")
    assert "repaired         its triangles turned: it was inside out" in done.stdout
    assert "written: right.stl, in metres, with 12 triangles" in done.stdout
    assert "next: qdgrasp run --gripper panda --object right.stl --mass 0.1" in done.stdout
    assert read_draft(Path("right.stl")).repairs == ()


def test_a_repaired_mesh_is_in_metres(check):
    block().apply_scale(1000).export("part.stl")
    done = check("part.stl", "--units", "mm", "--mass", 0.1, "--repaired", "metres.ply")
    assert "--object metres.ply --mass 0.1" in done.stdout
    assert read_draft(Path("metres.ply")).mesh.extents == pytest.approx(BLOCK)


def test_holes_are_filled_where_that_is_asked_for(check):
    without(5, 100).export("ball.ply")
    done = check("ball.ply")
    assert isinstance(done.exception, AssetError)
    assert "WRONG            it is not closed (watertight): 6 edges" in done.stdout
    assert not check("ball.ply", "--fill-holes", "--repaired", "whole.ply").exit_code
    assert read_draft(Path("whole.ply")).faults == ()


def test_nothing_is_written_of_a_mesh_that_cannot_be_used_nor_over_another_file(check):
    without(5).export("ball.ply")
    check("ball.ply", "--repaired", "whole.ply")
    assert not Path("whole.ply").exists()
    block().export("part.stl")
    done = check("part.stl", "--repaired", "ball.ply")
    assert isinstance(done.exception, FolderError)
    assert done.stdout == ""


@pytest.mark.parametrize("good", [True, False])
def test_an_object_is_drawn_also_where_it_is_open(check, good):
    (block() if good else without(5)).export("part.ply")
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


def test_a_name_of_the_catalog_is_no_file(check):
    done = check("mug")
    assert str(done.exception) == (
        "'mug' is an object of the catalog, no file; `qdgrasp asset check mug` checks it."
    )


@pytest.mark.parametrize("way", ["remesh", "hull"])
def test_a_mesh_that_cannot_be_used_has_a_way_out(check, tmp_path, way):
    trimesh.Trimesh(block().vertices, block().faces[2:], process=False).export(tmp_path / "part.ply")
    assert isinstance(check("part.ply", "--no-parts").exception, AssetError)
    done = check("part.ply", "--mass", 0.1, "--no-parts", "--mesh", f"simplify=500,{way}")
    assert done.exit_code == 0
    assert f"--object part.ply --mass 0.1 --mesh simplify=500,{way}" in done.stdout
    assert "repaired" in done.stdout


def test_a_mesh_that_is_written_needs_no_way_out_again(check, tmp_path):
    trimesh.Trimesh(block().vertices, block().faces[2:], process=False).export(tmp_path / "part.ply")
    done = check("part.ply", "--mass", 0.1, "--no-parts", "--mesh", "hull", "--repaired", "hull.stl")
    assert "next: qdgrasp run --gripper panda --object hull.stl --mass 0.1\n" in done.stdout
    assert check("hull.stl", "--no-parts").exit_code == 0
