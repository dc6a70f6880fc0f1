"""The rule by which convex parts are chosen."""

import logging

import numpy as np
import pytest
import trimesh

from qdgrasp_assets.geometry import collision_parts as module
from qdgrasp_assets.geometry.collision_parts import (
    COACD_THRESHOLDS,
    CORNER_TOLERANCE,
    MOST_CORNERS,
    DecompositionTimeout,
    FingerClearance,
    ProcessLimits,
    available_parts,
    collision_parts,
    decompose,
    limited_parts,
    simplify_part,
)
from qdgrasp_assets.geometry.mesh import Mesh, parts_to_obj
from qdgrasp_assets.geometry.primitives import box, geodesic, heights, hull
from qdgrasp_assets.stand_ins import mug
from qdgrasp_protocol.errors import AssetError

CORNERS = [(0, 0), (0.06, 0), (0.06, 0.02), (0.02, 0.02), (0.02, 0.06), (0, 0.06)]
HALVES = (
    box((0.06, 0.02, 0.02)).moved((0.03, 0.01, 0.01)),
    box((0.02, 0.04, 0.02)).moved((0.01, 0.04, 0.01)),
)
"""Convex parts of the angle."""
WIDE_LIMITS = ProcessLimits(60.0, 1_000_000_000)
CAPS = [(0, 1, 2), (0, 2, 3), (0, 3, 4), (0, 4, 5)]


@pytest.fixture
def angle() -> Mesh:
    """An L-shaped profile of 6 corners, 2 cm high."""
    low, high = ([(x, y, z) for x, y in CORNERS] for z in (0.0, 0.02))
    sides = [(i, (i + 1) % 6, (i + 1) % 6 + 6) for i in range(6)]
    sides += [(i, (i + 1) % 6 + 6, i + 6) for i in range(6)]
    caps = [(a, c, b) for a, b, c in CAPS] + [(a + 6, b + 6, c + 6) for a, b, c in CAPS]
    return Mesh(np.array(low + high), np.array(sides + caps))


def convex_parts(mesh, name, **options):
    return collision_parts(mesh, name, **options)[1]


def kept_in(cache):
    """The file of the parts of the only mesh so far."""
    (kept,) = (cache / "convex").iterdir()
    return kept


@pytest.fixture(autouse=True)
def cache(tmp_path, monkeypatch):
    monkeypatch.setenv("QDGRASP_CACHE", str(tmp_path / "cache"))
    monkeypatch.setattr(module, "_unfinished", {})
    return tmp_path / "cache"


def test_a_convex_mesh_is_its_own_part_and_needs_no_cache(cache):
    (part,) = convex_parts(box((0.1, 0.2, 0.3)), "block")
    assert part.volume == pytest.approx(0.006)
    assert not cache.exists()


def bowed() -> Mesh:
    """A box with a dent of 1 mm in one face: a finger does not feel it."""
    solid = box((0.1, 0.1, 0.1))
    dent = len(solid.vertices)
    top = [face for face in solid.faces.tolist() if (solid.vertices[face, 2] > 0).all()]
    rest = [face for face in solid.faces.tolist() if face not in top]
    rim = [(face[i], face[(i + 1) % 3]) for face in top for i in range(3)]
    outer = [edge for edge in rim if edge[::-1] not in rim]
    faces = rest + [[a, b, dent] for a, b in outer]
    return Mesh(np.concatenate([solid.vertices, [(0, 0, 0.049)]]), np.array(faces))


@pytest.fixture
def found(monkeypatch):
    """Results of CoACD by its threshold: parts, or an error."""
    answers: dict[float, object] = {}

    def decompose(mesh, name, threshold, time_limit, limits=None):
        answer = answers[threshold]
        if isinstance(answer, Exception):
            raise answer
        return answer

    monkeypatch.setattr(module, "decompose", decompose)
    return answers


def test_a_mesh_that_is_not_convex_is_decomposed_once(angle, cache, caplog, monkeypatch):
    with caplog.at_level(logging.WARNING):
        parts = convex_parts(angle, "angle.stl")
    assert "Decomposing 'angle.stl' (20 triangles)" in caplog.text
    assert len(parts) >= 2
    assert sum(part.volume for part in parts) == pytest.approx(angle.volume, rel=0.05)
    for part in parts:
        assert part.volume > 0
    assert [file.suffix for file in (cache / "convex").iterdir()] == [".obj"]
    monkeypatch.setattr(module, "decompose", None)
    again = convex_parts(angle, "angle.stl")
    assert all((a.vertices == b.vertices).all() for a, b in zip(parts, again, strict=True))


def test_parts_within_wide_limits_are_those_of_a_single_run_and_not_cached(angle, cache, monkeypatch):
    source, parts, fit = limited_parts(angle, WIDE_LIMITS)
    assert (source, fit.is_good) == ("coacd", True)
    assert not cache.exists()
    assert parts_to_obj(parts) == parts_to_obj(convex_parts(angle, "angle"))
    source, parts, fit = limited_parts(bowed(), WIDE_LIMITS)
    assert (source, fit.is_good) == ("own hull", True)
    assert parts_to_obj(parts) == parts_to_obj(convex_parts(bowed(), "dented"))


@pytest.mark.parametrize(
    ("program", "source"),
    [
        ("while True: pass", "took more than 1 s"),
        ("bytearray(1 << 31)", "took more than 0.5 GB"),
        ("raise MemoryError", "took more than 0.5 GB"),
        ("import os; os.abort()", "failed"),
        ("raise ValueError", "failed"),
        ("", "failed"),
    ],
)
def test_where_coacd_cannot_keep_its_limits_the_own_hull_is_taken_and_says_why(
    angle, tmp_path, monkeypatch, program, source
):
    (tmp_path / "coacd.py").write_text(program)
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    found, (part,), fit = limited_parts(angle, ProcessLimits(1.0, 1 << 29))
    assert found == f"own hull: CoACD {source}"
    assert part.volume == pytest.approx(hull(angle.vertices).volume)
    assert fit.filled > 0.1


@pytest.mark.slow
def test_a_mug_keeps_its_hollow_and_the_eye_of_its_handle():
    surface, own = mug()
    parts = convex_parts(surface, "mug")
    assert FingerClearance(surface).fit(parts).is_good
    assert len(parts) < len(own) < 64
    low, high = surface.bounds
    hollow, eye = (0, 0, high[2] - 0.01), (high[0] - 0.016, 0, (low[2] + high[2]) / 2)
    for point in np.array([hollow, eye]):
        assert not any(np.all((point - part.corners[:, 0]) * part.normals, axis=1).all() for part in parts)


def test_the_coarsest_parts_that_fit_are_taken(found):
    surface, own = mug()
    found.update({COACD_THRESHOLDS[0]: (hull(surface.vertices),), COACD_THRESHOLDS[1]: own})
    assert len(convex_parts(surface, "mug")) == len(own)


DAMAGE = {
    "empty": lambda content: b"",
    "cut in its middle": lambda content: content[: len(content) // 2],
    "cut between two parts": lambda content: content[: content.index(b"o part_1")],
    "without its last line": lambda content: content[: content.index(b"#")],
    "another number": lambda content: content.replace(b"v 0", b"v 1", 1),
    "zeros of a power cut": lambda content: bytes(len(content)),
}


@pytest.mark.parametrize("damage", DAMAGE.values(), ids=DAMAGE)
def test_parts_that_are_not_whole_are_made_again_with_a_word(found, angle, cache, caplog, damage):
    found[COACD_THRESHOLDS[0]] = HALVES
    parts, kept = convex_parts(angle, "angle"), kept_in(cache)
    whole = kept.read_bytes()
    kept.write_bytes(damage(whole))
    assert kept.read_bytes() != whole
    assert available_parts(angle) is None
    with caplog.at_level(logging.WARNING):
        again = convex_parts(angle, "angle")
    assert f"once again, as '{kept}' does not hold them whole" in caplog.text
    assert all((a.vertices == b.vertices).all() for a, b in zip(parts, again, strict=True))
    assert kept.read_bytes() == whole


def test_where_time_runs_out_the_finest_found_serve_this_process_and_the_next_one_tries_again(
    found, cache, caplog, monkeypatch
):
    surface, own = mug()
    coarse = hull(surface.vertices)
    found.update({COACD_THRESHOLDS[0]: (coarse,), COACD_THRESHOLDS[1]: DecompositionTimeout("mug", 1.0)})
    with caplog.at_level(logging.WARNING):
        assert convex_parts(surface, "mug", time_limit=0.0) == (coarse,)
    assert "no time for finer ones" in caplog.text
    assert not list((cache / "convex").iterdir())
    found.clear()
    assert convex_parts(surface, "mug") == (coarse,)
    monkeypatch.setattr(module, "_unfinished", {})
    found[COACD_THRESHOLDS[0]] = own
    assert len(convex_parts(surface, "mug")) == len(own)
    assert len(list((cache / "convex").iterdir())) == 1


def test_a_decomposition_that_takes_too_long_is_an_error_that_says_what_to_do(angle, cache):
    with pytest.raises(AssetError, match=r"'angle.stl' into convex parts within 0.01 s; simplify the mesh"):
        convex_parts(angle, "angle.stl", time_limit=0.01)
    assert not list((cache / "convex").iterdir())


@pytest.mark.parametrize("scale", [(1, 1, 1), (0.5, 1, 2), (1, 1, 0.1)])
def test_no_corner_that_is_left_out_was_far_outside_and_none_is_added(scale) -> None:
    ball = geodesic(0.01, 8)
    round_part = Mesh(ball.vertices * scale, ball.faces)
    part = simplify_part(round_part)
    assert len(part.vertices) < MOST_CORNERS
    assert heights(part, round_part.vertices).max() <= CORNER_TOLERANCE
    assert heights(round_part, part.vertices).max() < 1e-9
    assert trimesh.Trimesh(part.vertices, part.faces, process=False).is_volume


def test_coacd_is_given_a_dense_mesh_simplified(tmp_path, monkeypatch) -> None:
    (tmp_path / "counting.py").write_text(
        "import sys, numpy\nsys.exit(str(len(numpy.load(sys.argv[1])['faces'])))"
    )
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    monkeypatch.setattr(module.__spec__, "name", "counting")
    given = {}
    for subdivisions in (30, 60):
        ball = geodesic(0.05, subdivisions)
        with pytest.raises(AssetError, match=r"exit code 1\): \d+") as failed:
            decompose(ball, "ball", 0.1, time_limit=60.0)
        given[len(ball.faces)] = int(str(failed.value).rpartition(" ")[2].rstrip("."))
    (few, kept), (many, simplified) = given.items()
    assert kept == few < module.COACD_TRIANGLES < many
    assert 0.95 * module.COACD_TRIANGLES < simplified <= module.COACD_TRIANGLES


SLIT, WIDE = 0.004, 0.03


@pytest.fixture(scope="module")
def cup():
    """Surface and parts of the mug, around its own origin."""
    return mug()


def test_a_hull_fills_the_hollow_of_a_mug(cup) -> None:
    surface, _ = cup
    fit = FingerClearance(surface).fit((hull(surface.vertices),))
    assert not fit.is_good
    assert fit.filled > 0.4
