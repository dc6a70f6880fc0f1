"""Grasps beside each other: one camera, and words beside the pictures."""

import numpy as np
import pytest
from tests.coordinator.scenes import made_scene
from tests.tools.rendering.test_drawings import rows_of

from qdgrasp_protocol.rows import Outcome
from qdgrasp_tools.rendering.contact_sheet import (
    PanelLabel,
    PlacedHands,
    SheetLayout,
    common_camera,
    contact_sheet,
    draw_hands,
)
from qdgrasp_tools.rendering.ray_renderer import ParallelCamera

WIDTH, HEIGHT = 160, 140
LABEL = PanelLabel(
    "12345678  dead end", "fitness 6 of 6, margin 0.0123, and words that do not fit", "#2a73b9"
)


@pytest.fixture(scope="module")
def hands() -> PlacedHands:
    rows = rows_of([Outcome.HELD] * 5)
    poses, joints = rows["base_to_object"].astype(float), rows["joints"].astype(float)
    return PlacedHands(made_scene(), rows, poses, joints)


@pytest.fixture(scope="module")
def camera(hands: PlacedHands) -> ParallelCamera:
    return common_camera(hands, WIDTH, HEIGHT)


@pytest.fixture(scope="module")
def pictures(hands: PlacedHands, camera: ParallelCamera) -> list[np.ndarray]:
    return list(draw_hands(hands, camera))


def test_each_picture_has_one_hand_and_the_object_at_one_place(pictures: list[np.ndarray]) -> None:
    assert {picture.shape for picture in pictures} == {(HEIGHT, WIDTH, 3)}
    is_same = np.all([picture == pictures[0] for picture in pictures], axis=(0, -1))
    is_object = is_same & (pictures[0] < 250).any(axis=-1)
    assert 200 < is_object.sum() < (pictures[0] < 250).any(axis=-1).sum()
    assert len({picture.tobytes() for picture in pictures}) == len(pictures)


def test_every_hand_is_in_the_picture_as_a_whole(pictures: list[np.ndarray]) -> None:
    for picture in pictures:
        assert (picture[[0, -1]] == 255).all()
        assert (picture[:, [0, -1]] == 255).all()


def test_words_cover_no_pixel_of_hand_or_object(pictures, camera, hands) -> None:
    title = "a title that is much too long for a sheet as narrow as this one is " * 3
    sheet = np.array(contact_sheet(iter(pictures), [LABEL] * 5, title, camera))
    bare = np.array(contact_sheet(iter(pictures), [LABEL] * 5, title, camera, has_labels=False))
    for has_labels, image in ((True, sheet), (False, bare)):
        layout = SheetLayout(5, WIDTH, HEIGHT, has_labels)
        assert image.shape == (*layout.size[::-1], 3)
        for place, picture in enumerate(pictures):
            left, top = layout.corner(place)
            drawn = (picture < 255).any(axis=-1)
            assert (image[top : top + HEIGHT, left : left + WIDTH][drawn] == picture[drawn]).all()
    assert (sheet < 200).any(axis=-1).sum() > (bare < 200).any(axis=-1).sum() + 300


def test_a_label_is_of_the_panel_above_it(pictures: list[np.ndarray], camera: ParallelCamera) -> None:
    labels = [PanelLabel(str(place), "", f"#0000{place:02x}") for place in range(5)]
    sheet = np.array(contact_sheet(iter(pictures), labels, "", camera))
    layout = SheetLayout(5, WIDTH, HEIGHT, has_labels=True)
    for place in range(5):
        left, top = layout.corner(place)
        foot = sheet[top + HEIGHT + 1 : top + HEIGHT + layout.foot, left : left + WIDTH]
        assert (foot == [0, 0, place]).all(axis=-1).any()


def test_no_further_picture_is_drawn_after_a_signal(pictures, camera) -> None:
    sheet = contact_sheet(iter(pictures), [LABEL] * 5, "", camera, has_labels=False, is_stopped=lambda: True)
    assert (np.array(sheet) == 255).all()


@pytest.mark.parametrize("n", [1, 2, 5, 12, 48])
def test_panels_stand_beside_each_other_within_the_sheet(n: int) -> None:
    layout = SheetLayout(n, WIDTH, HEIGHT, has_labels=True)
    corners = np.array([layout.corner(place) for place in range(n)])
    ends = corners + np.array([WIDTH, HEIGHT + layout.foot])
    assert (ends.max(axis=0) == layout.size).all()
    for place in range(n):
        others = np.arange(n) != place
        beside = (corners[others] >= ends[place]) | (ends[others] <= corners[place])
        assert beside.any(axis=1).all()
