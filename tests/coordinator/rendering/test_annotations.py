"""Labels stand where they are read: beside what they name, and none over another."""

from qdgrasp_coordinator.rendering.annotations import (
    EDGE_MARGIN,
    Anchor,
    Label,
    LabelSpot,
    PixelBox,
    arrange_labels,
)

WIDTH = 100.0


def label(words: str, *spots: tuple[float, float], side: Anchor = "l", is_needed: bool = True) -> Label:
    return Label(words, 10, "black", [LabelSpot(*spot, side) for spot in spots], is_needed)


def placed(
    *labels: Label, lines: tuple[PixelBox, ...] = (), dots: tuple[PixelBox, ...] = ()
) -> dict[str, LabelSpot]:
    """Spots of labels of which each letter is as long as high."""
    found = arrange_labels(labels, lines, dots, WIDTH, lambda label: 10.0 * len(label.words))
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


def test_a_name_stands_though_no_spot_is_free() -> None:
    assert placed(label("ab", (10, 10)), label("cd", (12, 10), (14, 10)))["cd"] == LabelSpot(12, 10, "l")


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
