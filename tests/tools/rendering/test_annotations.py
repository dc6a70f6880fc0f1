"""Labels stand beside the parts that they name, and cover nothing."""

import numpy as np
import pytest

from qdgrasp_tools.rendering.annotations import (
    EDGE_MARGIN,
    Anchor,
    CoveredArea,
    Label,
    LabelSpot,
    PixelBox,
    arrange_labels,
)

WIDTH = 100
NOTHING = np.zeros((WIDTH, WIDTH), dtype=bool)


def label(words: str, *spots: tuple[float, float], side: Anchor = "l", is_needed: bool = True) -> Label:
    return Label(words, 10, "black", [LabelSpot(*spot, side) for spot in spots], is_needed)


def placed(
    *labels: Label,
    lines: tuple[PixelBox, ...] = (),
    dots: tuple[PixelBox, ...] = (),
    covered: np.ndarray = NOTHING,
) -> dict[str, LabelSpot]:
    """Spots of labels of which each letter is as long as high."""
    found = arrange_labels(labels, lines, dots, CoveredArea(covered), lambda label: 10.0 * len(label.words))
    return {label.words: spot for label, spot in found}


def test_each_stands_at_its_best_spot_where_nothing_else_is() -> None:
    assert placed(label("ab", (10, 10), (50, 50)), label("cd", (10, 30))) == {
        "ab": LabelSpot(10, 10, "l"),
        "cd": LabelSpot(10, 30, "l"),
    }


def test_where_another_stands_the_next_spot_is_taken() -> None:
    found = placed(label("ab", (10, 10)), label("cd", (25, 12), (60, 12)))
    assert found["cd"] == LabelSpot(60, 12, "l")


def test_names_come_before_letters_which_are_left_out_where_no_spot_is_free() -> None:
    assert list(placed(label("x", (10, 10), is_needed=False), label("name", (5, 10)))) == ["name"]


def test_a_name_without_a_free_spot_stands_at_the_nearest_place_with_room() -> None:
    found = placed(label("ab", (10, 10)), label("cd", (12, 10), (14, 10)))
    assert found["cd"] == LabelSpot(EDGE_MARGIN + 10, 30, "m")


def test_a_name_stands_over_lines_where_there_is_no_other_room() -> None:
    everywhere = (PixelBox(0, 0, WIDTH, WIDTH),)
    assert placed(label("ab", (30, 10)), lines=everywhere) == {"ab": LabelSpot(30, 10, "l")}
    assert not placed(label("x", (30, 10), is_needed=False), lines=everywhere)


@pytest.mark.parametrize("side", range(4))
def test_no_word_covers_what_is_drawn(side: int) -> None:
    drawn = NOTHING.copy()
    drawn[:70] = True
    drawn = np.rot90(drawn, side)
    found = placed(label("ab", (50, 50)), label("x", (50, 40), is_needed=False), covered=drawn)
    assert found.keys() == {"ab"}
    x, y, _ = found["ab"]
    assert not drawn[int(y) - 5 : int(y) + 6, int(x) - 10 : int(x) + 10].any()


def test_where_all_is_covered_there_are_no_words() -> None:
    assert not placed(label("ab", (50, 50)), covered=~NOTHING)


def test_a_box_overlaps_the_pixels_that_it_touches() -> None:
    drawn = NOTHING.copy()
    drawn[10, 20] = True
    area = CoveredArea(drawn)
    assert area.overlaps(PixelBox(20.5, 10.5, 20.6, 10.6))
    assert area.overlaps(PixelBox(-50, -50, 150, 150))
    for box in (PixelBox(21, 10, 30, 11), PixelBox(10, 10, 20, 11), PixelBox(20, 0, 21, 10)):
        assert not area.overlaps(box)


def test_words_keep_clear_of_lines_and_letters_of_dots_too() -> None:
    here = (PixelBox(12, 8, 14, 12),)
    name, letter = label("ab", (10, 10), (50, 50)), label("x", (10, 10), (70, 70), is_needed=False)
    assert placed(name, letter, lines=here) == {"ab": LabelSpot(50, 50, "l"), "x": LabelSpot(70, 70, "l")}
    assert placed(name, dots=here) == {"ab": LabelSpot(10, 10, "l")}
    assert placed(letter, dots=here) == {"x": LabelSpot(70, 70, "l")}


def test_no_letter_is_cut_off_at_an_edge() -> None:
    assert placed(label("abc", (90, 10)))["abc"].x == WIDTH - EDGE_MARGIN - 30
    assert placed(label("abc", (10, 10), side="r"))["abc"].x == EDGE_MARGIN + 30
    assert placed(label("abc", (0, 10), side="m"))["abc"].x == EDGE_MARGIN + 15
