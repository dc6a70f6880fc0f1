"""The rule by which convex parts are chosen."""

import logging
import re

import numpy as np
import pytest
import trimesh

from qdgrasp_assets.geometry import collision_parts as module
from qdgrasp_assets.geometry.collision_parts import (
    COACD_THRESHOLDS,
    CORNER_TOLERANCE,
    MOST_CORNERS,
    DecompositionFailure,
    DecompositionTimeout,
    FingerClearance,
    ProcessLimits,
    available_parts,
    collision_parts,
    decompose,
    limited_parts,
    simplify_part,
    solid_parts,
)
from qdgrasp_assets.geometry.mesh import Mesh, join, parts_to_obj
from qdgrasp_assets.geometry.primitives import box, geodesic, heights, hull
from qdgrasp_assets.geometry.proximity import ray_distance
from qdgrasp_assets.stand_ins import HANDLE_PATH, mug
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


def test_a_mesh_that_is_nearly_convex_is_its_own_part(cache):
    assert bowed().volume < 0.9975 * box((0.1, 0.1, 0.1)).volume
    source, (part,) = collision_parts(bowed(), "dented")
    assert (source, len(part.vertices)) == ("own hull", 8)


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


@pytest.mark.parametrize(
    ("error", "words"),
    [
        (DecompositionTimeout("mug", 1.0), "took more than 60 s"),
        (DecompositionFailure("mug", -6, "terminate called: std::bad_alloc"), "took more than 1.0 GB"),
        (DecompositionFailure("mug", -11, ""), "failed"),
    ],
)
def test_where_finer_parts_cannot_be_had_the_finest_found_are_taken(found, error, words):
    surface, own = mug()
    found.update({COACD_THRESHOLDS[0]: own[:-8], COACD_THRESHOLDS[1]: error})
    source, parts, fit = limited_parts(surface, WIDE_LIMITS)
    assert source == f"coacd, coarse: finer parts {words}"
    assert parts == own[:-8]
    assert not fit.is_good


def test_the_limit_of_time_is_for_all_attempts(found, monkeypatch):
    surface, own = mug()
    found.update(dict.fromkeys(COACD_THRESHOLDS[:2], own[:-8]))
    clock = iter([0.0, 50.0, 50.0, 110.0])
    monkeypatch.setattr(module, "_children_seconds", lambda: next(clock, 110.0))
    source, parts, _ = limited_parts(surface, WIDE_LIMITS)
    assert source == "coacd, coarse: finer parts took more than 60 s"
    assert parts == own[:-8]


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


def test_others_can_read_the_parts_that_are_kept(found, cache):
    surface, own = mug()
    found[COACD_THRESHOLDS[0]] = own
    convex_parts(surface, "mug")
    kept = kept_in(cache)
    written = cache / "written"
    written.touch()
    assert kept.stat().st_mode == written.stat().st_mode


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


def test_the_line_that_shows_that_parts_are_whole_is_none_of_them(found, angle, cache):
    found[COACD_THRESHOLDS[0]] = HALVES
    parts = convex_parts(angle, "angle")
    content = kept_in(cache).read_bytes()
    assert content.startswith(parts_to_obj(parts))
    assert re.fullmatch(rb"# sha256 [0-9a-f]{64}\n", content.removeprefix(parts_to_obj(parts)))
    assert available_parts(angle) is not None


def test_where_none_fit_the_finest_are_taken_with_a_warning(found, caplog):
    surface, own = mug()
    found.update(dict.fromkeys(COACD_THRESHOLDS, (hull(surface.vertices),)))
    found[COACD_THRESHOLDS[-1]] = own[:-8]
    with caplog.at_level(logging.WARNING):
        assert len(convex_parts(surface, "mug")) == len(own) - 8
    assert "finer ones are not tried" in caplog.text


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


def test_a_cache_that_cannot_be_written_is_named(angle, tmp_path, monkeypatch):
    (tmp_path / "file").touch()
    monkeypatch.setenv("QDGRASP_CACHE", str(tmp_path / "file"))
    with pytest.raises(AssetError, match=r"cannot be kept in '.*file.*'.*QDGRASP_CACHE"):
        convex_parts(angle, "angle.stl")


@pytest.mark.parametrize("scale", [(1, 1, 1), (0.5, 1, 2), (1, 1, 0.1)])
def test_no_corner_that_is_left_out_was_far_outside_and_none_is_added(scale) -> None:
    ball = geodesic(0.01, 8)
    round_part = Mesh(ball.vertices * scale, ball.faces)
    part = simplify_part(round_part)
    assert len(part.vertices) < MOST_CORNERS
    assert heights(part, round_part.vertices).max() <= CORNER_TOLERANCE
    assert heights(round_part, part.vertices).max() < 1e-9
    assert trimesh.Trimesh(part.vertices, part.faces, process=False).is_volume


def test_a_large_round_part_has_as_many_corners_as_there_may_be() -> None:
    ball = geodesic(0.1, 8)
    part = simplify_part(ball)
    assert len(part.vertices) == MOST_CORNERS
    assert heights(part, ball.vertices).max() < 4e-3


def test_very_many_corners_are_looked_at_in_two_steps_and_none_far_outside_is_left_out(monkeypatch) -> None:
    part = geodesic(0.004, 24)
    monkeypatch.setattr(module, "MANY_CORNERS", 1000)
    found = simplify_part(part)
    assert len(found.vertices) < module.MOST_CORNERS
    assert heights(found, part.vertices).max() <= module.CORNER_TOLERANCE


def test_points_are_within_a_part_of_many_faces_as_within_one_of_few(monkeypatch) -> None:
    part, points = geodesic(0.04, 16), np.random.default_rng(0).uniform(-0.045, 0.045, (2000, 3))
    plain = module.is_within(part, points, 1e-3)
    monkeypatch.setattr(module, "MANY_FACES", 1000)
    monkeypatch.setattr(module, "SOME_FACES", 50)
    np.testing.assert_array_equal(module.is_within(part, points, 1e-3), plain)
    assert 0 < plain.sum() < len(points)


def test_a_small_part_has_fewer_corners_than_a_large_one() -> None:
    small, large = (simplify_part(geodesic(radius, 8)) for radius in (0.005, 0.05))
    assert len(small.vertices) < len(large.vertices) / 2


def test_a_box_stays_as_it_is() -> None:
    solid = box((0.1, 0.02, 0.3))
    assert len(simplify_part(solid).vertices) == 8
    assert simplify_part(solid).volume == pytest.approx(solid.volume)


def test_a_flat_part_fills_no_room_and_is_left_out() -> None:
    solid = box((0.1, 0.02, 0.3))
    (part,) = solid_parts([solid.vertices * (1, 1, 0), solid.vertices])
    assert part.volume == pytest.approx(solid.volume)


def test_a_part_whose_outermost_corners_are_in_one_plane_stays_a_solid() -> None:
    corners = np.array([(0, 0, 0), (1, 1, 0.5), (0.5, 0.5, 1), (0.6, 0.4, 0.5)]) * 0.1
    assert simplify_part(hull(corners)).volume == pytest.approx(hull(corners).volume)


TALKATIVE = """
import sys

print("a remark\\n" * 50_000, file=sys.stderr)
sys.exit("no such mesh")
"""


def test_what_says_more_than_a_pipe_holds_comes_to_its_end(tmp_path, monkeypatch) -> None:
    (tmp_path / "talkative.py").write_text(TALKATIVE)
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    monkeypatch.setattr(module.__spec__, "name", "talkative")
    with pytest.raises(AssetError, match=r"mesh 'mug' .*exit code 1\): .*no such mesh"):
        decompose(box((0.1, 0.1, 0.1)), "mug", 0.1, time_limit=60.0)


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


def fork(gap: float) -> Mesh:
    """Two plates side by side."""
    plate = box((0.01, 0.1, 0.1))
    return join([plate.moved((0, 0, 0)), plate.moved((0.01 + gap, 0, 0))])


def test_parts_that_enclose_the_same_space_leave_all_the_room(cup) -> None:
    surface, parts = cup
    fit = FingerClearance(surface).fit(parts)
    assert fit.is_good
    assert fit.filled < 0.001
    assert fit.bare == 0


def test_a_hull_fills_the_hollow_of_a_mug(cup) -> None:
    surface, _ = cup
    fit = FingerClearance(surface).fit((hull(surface.vertices),))
    assert not fit.is_good
    assert fit.filled > 0.4


def test_a_plug_in_the_eye_of_a_handle_is_seen(cup) -> None:
    surface, parts = cup
    eye = hull(np.array([(x, y, z) for x, z in HANDLE_PATH for y in (-0.006, 0.006)]))
    assert not FingerClearance(surface).fit((*parts, eye)).is_good


def test_what_the_parts_leave_out_is_bare(cup) -> None:
    surface, parts = cup
    assert FingerClearance(surface).fit(parts[: len(parts) // 2]).bare > 0.1
    assert not FingerClearance(surface).fit(parts[: len(parts) // 2]).is_good


def test_a_gap_too_narrow_for_a_finger_is_no_room() -> None:
    for gap, is_good in ((SLIT, True), (WIDE, False)):
        plates = fork(gap)
        assert FingerClearance(plates).fit((hull(plates.vertices),)).is_good is is_good


def test_how_far_it_is_to_the_next_surface() -> None:
    across, away = ray_distance(
        fork(WIDE), np.array([[0.006, 0.01, 0.02], [-0.006, 0.01, 0.02]]), np.array([[1.0, 0, 0], [-1, 0, 0]])
    )
    assert across == pytest.approx(WIDE - 0.001, abs=1e-6)
    assert away > 1.0
