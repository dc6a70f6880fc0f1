from dataclasses import replace
from pathlib import Path

import matplotlib.image
import numpy as np
import pytest

from qdgrasp_assets.catalog import find_gripper
from qdgrasp_assets.objects.stand_ins import stand_in
from qdgrasp_coordinator.analysis.lettering import BOX, lettered
from qdgrasp_coordinator.analysis.portrait import draw_gripper, draw_object, seen_at
from qdgrasp_coordinator.analysis.rays import camera


def halves(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """The left and the right view of a portrait, without its words."""
    image = matplotlib.image.imread(path)[..., :3]
    rows, columns, _ = image.shape
    views = image[rows // 5 :]
    return views[:, : columns // 2], views[:, columns // 2 :]


def share_drawn(view: np.ndarray) -> float:
    return float((view.min(axis=-1) < 0.99).mean())


@pytest.mark.parametrize("name", ["panda", "shadow"])
def test_a_hand_is_drawn_open_and_closed(tmp_path: Path, name: str) -> None:
    draw_gripper(find_gripper(name).on_carrier("paper"), tmp_path / "hand.png")
    opened, closed = halves(tmp_path / "hand.png")
    assert share_drawn(opened) > 0.05
    assert share_drawn(closed) > 0.05
    assert not np.allclose(opened, closed)


def test_an_object_is_drawn_with_its_parts_in_colours(tmp_path: Path) -> None:
    draw_object(stand_in("mug"), tmp_path / "mug.png")
    surface, parts = halves(tmp_path / "mug.png")

    def colourful(view: np.ndarray) -> float:
        return float((np.ptp(view, axis=-1) > 0.4).mean())

    assert share_drawn(surface) == pytest.approx(share_drawn(parts), rel=0.05)
    assert colourful(parts) > 10 * colourful(surface)


@pytest.mark.parametrize("name", ["\u5341\u5b57", "price $5$", r"$\frac$", "\U0001f600", "a\tb"])
@pytest.mark.filterwarnings("error")
def test_any_name_is_drawn_and_nothing_is_complained_of(tmp_path: Path, name: str) -> None:
    mug = stand_in("mug")
    draw_object(replace(mug, name=name), tmp_path / "mug.png")
    assert share_drawn(halves(tmp_path / "mug.png")[0]) > 0.05


def test_letters_that_the_font_lacks_are_boxes_and_others_stay() -> None:
    assert lettered("\u5341 caf\u00e9, 5 \u00b5m") == f"{BOX} caf\u00e9, 5 \u00b5m"
    assert lettered("a\nb") == "a\nb"


def test_a_point_is_marked_where_the_camera_shows_it() -> None:
    corners = np.array([[-0.2, -0.2, 0.0], [0.2, 0.2, 0.0]])
    above = camera(corners, -np.pi / 2, np.pi / 2, 200, 200)
    assert seen_at(above, np.zeros(3)) == pytest.approx((50, 50), abs=0.1)
    right, low = seen_at(above, np.array([0.1, -0.1, 0.0]))
    assert right > 60
    assert low > 60
