"""Parts with few corners; what CoACD itself does is tested with the rule that asks it."""

import numpy as np
import pytest
import trimesh

from qdgrasp_assets import decompose as module
from qdgrasp_assets.decompose import CORNERS, TOLERANCE, decompose, simple
from qdgrasp_assets.mesh import Mesh
from qdgrasp_assets.objects.solids import box, geodesic, heights, hull
from qdgrasp_protocol.errors import AssetError


@pytest.mark.parametrize("scale", [(1, 1, 1), (0.5, 1, 2), (1, 1, 0.1)])
def test_no_corner_that_is_left_out_was_far_outside_and_none_is_added(scale) -> None:
    ball = geodesic(0.01, 8)
    round_part = Mesh(ball.vertices * scale, ball.faces)
    part = simple(round_part)
    assert len(part.vertices) < CORNERS
    assert heights(part, round_part.vertices).max() <= TOLERANCE
    assert heights(round_part, part.vertices).max() < 1e-9
    assert trimesh.Trimesh(part.vertices, part.faces, process=False).is_volume


def test_a_large_round_part_has_as_many_corners_as_there_may_be() -> None:
    ball = geodesic(0.1, 8)
    part = simple(ball)
    assert len(part.vertices) == CORNERS
    assert heights(part, ball.vertices).max() < 4e-3


def test_a_small_part_has_fewer_corners_than_a_large_one() -> None:
    small, large = (simple(geodesic(radius, 8)) for radius in (0.005, 0.05))
    assert len(small.vertices) < len(large.vertices) / 2


def test_a_box_stays_as_it_is() -> None:
    solid = box((0.1, 0.02, 0.3))
    assert len(simple(solid).vertices) == 8
    assert simple(solid).volume == pytest.approx(solid.volume)


def test_a_part_whose_outermost_corners_are_in_one_plane_stays_a_solid() -> None:
    corners = np.array([(0, 0, 0), (1, 1, 0.5), (0.5, 0.5, 1), (0.6, 0.4, 0.5)]) * 0.1
    assert simple(hull(corners)).volume == pytest.approx(hull(corners).volume)


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
