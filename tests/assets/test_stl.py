"""Binary STL files."""

import numpy as np
import trimesh

from qdgrasp_assets.stl import triangles


def test_triangles_are_those_that_were_written() -> None:
    ball = trimesh.creation.icosphere(subdivisions=1, radius=0.03)
    found = triangles(ball.export(file_type="stl"))
    np.testing.assert_array_equal(found, ball.triangles.astype(np.float32))


def test_a_text_is_not_a_binary_file() -> None:
    assert triangles(trimesh.creation.box().export(file_type="stl_ascii").encode()) is None
    assert triangles(b"solid") is None
