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
    FingerClearance,
    collision_parts,
    known_parts,
    simplify_part,
)
from qdgrasp_assets.geometry.mesh import Mesh, box, geodesic, heights, hull
from qdgrasp_assets.stand_ins import stand_in
from qdgrasp_protocol.errors import AssetError, UnreadableHere

CORNERS = [(0, 0), (0.06, 0), (0.06, 0.02), (0.02, 0.02), (0.02, 0.06), (0, 0.06)]
LIMITED = """
from qdgrasp_assets.geometry import collision_parts
collision_parts.COACD_SECONDS = 1
collision_parts.main()
"""
"""The process of CoACD with little time."""
CAPS = [(0, 1, 2), (0, 2, 3), (0, 3, 4), (0, 4, 5)]


@pytest.fixture
def angle() -> Mesh:
    """An L-shaped profile of 6 corners, 2 cm high."""
    low, high = ([(x, y, z) for x, y in CORNERS] for z in (0.0, 0.02))
    sides = [(i, (i + 1) % 6, (i + 1) % 6 + 6) for i in range(6)]
    sides += [(i, (i + 1) % 6 + 6, i + 6) for i in range(6)]
    caps = [(a, c, b) for a, b, c in CAPS] + [(a + 6, b + 6, c + 6) for a, b, c in CAPS]
    return Mesh(np.array(low + high), np.array(sides + caps))


def convex_parts(mesh, name):
    return collision_parts(mesh, name)[1]


@pytest.fixture(autouse=True)
def cache(tmp_path, monkeypatch):
    monkeypatch.setenv("QDGRASP_CACHE", str(tmp_path / "cache"))
    return tmp_path / "cache"


def test_a_convex_mesh_is_its_own_part_and_needs_no_cache(cache):
    (part,) = convex_parts(box((0.1, 0.2, 0.3)), "block")
    assert part.volume == pytest.approx(0.006)
    assert not cache.exists()


@pytest.fixture
def found(monkeypatch):
    """Results of CoACD by its threshold."""
    answers: dict[float, tuple[Mesh, ...]] = {}

    monkeypatch.setattr(module, "decompose", lambda _mesh, _name, threshold: answers[threshold])
    return answers


def test_a_mesh_that_is_not_convex_is_decomposed_once(angle, cache, caplog, monkeypatch):
    assert known_parts(angle) is None
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


@pytest.mark.parametrize(
    ("program", "error", "words"),
    [
        ("while True: pass", AssetError, r"'angle\.stl' into convex parts within 1 s of CPU time; simplify"),
        ("import os; os.abort()", UnreadableHere, "exit code -6"),
        ("raise ValueError('flat')", AssetError, "ValueError: flat"),
    ],
)
def test_where_coacd_fails_or_takes_too_long_it_is_said(
    angle, cache, tmp_path, monkeypatch, program, error, words
):
    (tmp_path / "coacd.py").write_text(program)
    (tmp_path / "limited.py").write_text(LIMITED)
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    monkeypatch.setattr(module.__spec__, "name", "limited")
    monkeypatch.setattr(module, "COACD_SECONDS", 1)
    with pytest.raises(error, match=words):
        convex_parts(angle, "angle.stl")
    assert not cache.exists()


@pytest.mark.parametrize("scale", [(1, 1, 1), (0.5, 1, 2), (1, 1, 0.1)])
def test_no_corner_that_is_left_out_was_far_outside_and_none_is_added(scale) -> None:
    ball = geodesic(0.01, 8)
    round_part = Mesh(ball.vertices * scale, ball.faces)
    part = simplify_part(round_part)
    assert len(part.vertices) < MOST_CORNERS
    assert heights(part, round_part.vertices).max() <= CORNER_TOLERANCE
    assert heights(round_part, part.vertices).max() < 1e-9
    assert trimesh.Trimesh(part.vertices, part.faces, process=False).is_volume


def mug() -> tuple[Mesh, tuple[Mesh, ...]]:
    """Surface and parts of the mug, around its cup's axis."""
    target, shift = stand_in("mug"), (0.0207, -0.0174, 0.0005)
    return target.mesh.moved(shift), tuple(part.moved(shift) for part in target.parts)


SLIT, WIDE = 0.004, 0.03
