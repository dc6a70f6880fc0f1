"""The room in front of a surface, and how much of it convex parts fill."""

import numpy as np
import pytest

from qdgrasp_assets.mesh import Mesh, join
from qdgrasp_assets.objects.mug import PATH, mug
from qdgrasp_assets.objects.solids import box, hull
from qdgrasp_assets.rays import ahead
from qdgrasp_assets.room import Room

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
    fit = Room(surface).fit(parts)
    assert fit.is_good
    assert fit.filled < 0.001
    assert fit.bare == 0


def test_a_hull_fills_the_hollow_of_a_mug(cup) -> None:
    surface, _ = cup
    fit = Room(surface).fit((hull(surface.vertices),))
    assert not fit.is_good
    assert fit.filled > 0.4


def test_a_plug_in_the_eye_of_a_handle_is_seen(cup) -> None:
    surface, parts = cup
    eye = hull(np.array([(x, y, z) for x, z in PATH for y in (-0.006, 0.006)]))
    assert not Room(surface).fit((*parts, eye)).is_good


def test_what_the_parts_leave_out_is_bare(cup) -> None:
    surface, parts = cup
    assert Room(surface).fit(parts[: len(parts) // 2]).bare > 0.1
    assert not Room(surface).fit(parts[: len(parts) // 2]).is_good


def test_a_gap_too_narrow_for_a_finger_is_no_room() -> None:
    for gap, is_good in ((SLIT, True), (WIDE, False)):
        plates = fork(gap)
        assert Room(plates).fit((hull(plates.vertices),)).is_good is is_good


def test_how_far_it_is_to_the_next_surface() -> None:
    across, away = ahead(
        fork(WIDE), np.array([[0.006, 0.01, 0.02], [-0.006, 0.01, 0.02]]), np.array([[1.0, 0, 0], [-1, 0, 0]])
    )
    assert across == pytest.approx(WIDE - 0.001, abs=1e-6)
    assert away > 1.0
