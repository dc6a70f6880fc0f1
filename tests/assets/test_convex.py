import logging

import numpy as np
import pytest
import trimesh

from qdgrasp_assets import convex
from qdgrasp_assets.convex import convex_parts, simple
from qdgrasp_assets.mesh import Mesh
from qdgrasp_assets.objects.solids import box, geodesic
from qdgrasp_protocol.errors import AssetError

CORNERS = [(0, 0), (0.06, 0), (0.06, 0.02), (0.02, 0.02), (0.02, 0.06), (0, 0.06)]
CAPS = [(0, 1, 2), (0, 2, 3), (0, 3, 4), (0, 4, 5)]


@pytest.fixture
def angle() -> Mesh:
    """An L-shaped profile of 6 corners, 2 cm high."""
    low, high = ([(x, y, z) for x, y in CORNERS] for z in (0.0, 0.02))
    sides = [(i, (i + 1) % 6, (i + 1) % 6 + 6) for i in range(6)]
    sides += [(i, (i + 1) % 6 + 6, i + 6) for i in range(6)]
    caps = [(a, c, b) for a, b, c in CAPS] + [(a + 6, b + 6, c + 6) for a, b, c in CAPS]
    return Mesh(np.array(low + high), np.array(sides + caps))


@pytest.fixture(autouse=True)
def cache(tmp_path, monkeypatch):
    monkeypatch.setenv("QDGRASP_CACHE", str(tmp_path / "cache"))
    return tmp_path / "cache"


def test_a_convex_mesh_is_its_own_part_and_needs_no_cache(cache):
    (part,) = convex_parts(box((0.1, 0.2, 0.3)), "block")
    assert part.volume == pytest.approx(0.006)
    assert not cache.exists()


def test_a_mesh_that_is_not_convex_is_decomposed_once(angle, cache, caplog, monkeypatch):
    with caplog.at_level(logging.WARNING):
        parts = convex_parts(angle, "angle.stl")
    assert "Decomposing 'angle.stl' (20 triangles)" in caplog.text
    assert len(parts) >= 2
    assert sum(part.volume for part in parts) == pytest.approx(angle.volume, rel=0.05)
    for part in parts:
        assert part.volume > 0
    assert [file.suffix for file in (cache / "convex").iterdir()] == [".obj"]
    monkeypatch.setattr(convex, "_run_coacd", None)
    again = convex_parts(angle, "angle.stl")
    assert all((a.vertices == b.vertices).all() for a, b in zip(parts, again, strict=True))


def test_a_decomposition_that_takes_too_long_is_an_error_that_says_what_to_do(angle, cache):
    with pytest.raises(AssetError, match=r"'angle.stl' into convex parts within 0.01 s; simplify the mesh"):
        convex_parts(angle, "angle.stl", time_limit=0.01)
    assert not list((cache / "convex").iterdir())


def test_a_cache_that_cannot_be_written_is_named(angle, tmp_path, monkeypatch):
    (tmp_path / "file").touch()
    monkeypatch.setenv("QDGRASP_CACHE", str(tmp_path / "file"))
    with pytest.raises(AssetError, match=r"cannot be kept in '.*file.*'.*QDGRASP_CACHE"):
        convex_parts(angle, "angle.stl")


def test_a_part_of_many_vertices_is_simplified_without_leaving_its_hull():
    ball = geodesic(0.03, 8)
    part = simple(Mesh(ball.vertices * (4, 1, 1), ball.faces))
    assert len(part.vertices) <= 92
    assert part.volume > 0.9 * 4 * ball.volume
    assert (np.linalg.norm(part.vertices / (4, 1, 1), axis=1) <= 0.03 + 1e-9).all()
    assert trimesh.Trimesh(part.vertices, part.faces, process=False).is_volume
