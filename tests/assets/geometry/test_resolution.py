"""Warnings about thin walls and small objects."""

import pytest
import trimesh

from qdgrasp_assets.geometry.mesh import Mesh, box
from qdgrasp_assets.geometry.proximity import (
    THINNEST,
    thin_share,
)


@pytest.mark.parametrize(("thickness", "is_thin"), [(0.5 * THINNEST, True), (1.05 * THINNEST, False)])
def test_a_sheet_is_thin_below_twice_the_margin_of_parts(thickness: float, is_thin: bool) -> None:
    share = thin_share(box((0.08, 0.05, thickness)))
    assert (share > 0.9) if is_thin else (share < 0.01)


def test_the_wall_of_a_tube_is_measured_through_the_wall() -> None:
    for wall, is_thin in ((0.001, True), (0.004, False)):
        tube = trimesh.creation.annulus(0.03 - wall, 0.03, 0.1, sections=64)
        assert (thin_share(Mesh(tube.vertices, tube.faces)) > 0.5) is is_thin
