"""Labels stand where they are read: beside what they name, and none over another."""

from qdgrasp_coordinator.looking.labels import RIM, Box, Label, Side, Spot, arranged

WIDTH = 100.0


def label(words: str, *spots: tuple[float, float], side: Side = "l", is_needed: bool = True) -> Label:
    return Label(words, 10, "black", [Spot(*spot, side) for spot in spots], is_needed)


def placed(*labels: Label, lines: tuple[Box, ...] = (), dots: tuple[Box, ...] = ()) -> dict[str, Spot]:
    """Where labels stand of which each letter is as long as high."""
    found = arranged(labels, lines, dots, WIDTH, lambda label: 10.0 * len(label.words))
    return {label.words: spot for label, spot in found}


def test_each_stands_at_its_best_spot_where_nothing_else_is() -> None:
    assert placed(label("ab", (10, 10), (50, 50)), label("cd", (10, 30))) == {
        "ab": Spot(10, 10, "l"),
        "cd": Spot(10, 30, "l"),
    }


def test_where_another_stands_the_next_spot_is_taken() -> None:
    found = placed(label("ab", (10, 10)), label("cd", (25, 12), (60, 12)))
    assert found["cd"] == Spot(60, 12, "l")


def test_names_come_before_letters_which_are_left_out_where_no_spot_is_free() -> None:
    assert list(placed(label("x", (10, 10), is_needed=False), label("name", (5, 10)))) == ["name"]


def test_a_name_stands_though_no_spot_is_free() -> None:
    assert placed(label("ab", (10, 10)), label("cd", (12, 10), (14, 10)))["cd"] == Spot(12, 10, "l")


def test_words_keep_clear_of_lines_and_letters_of_dots_too() -> None:
    here = (Box(12, 8, 14, 12),)
    name, letter = label("ab", (10, 10), (50, 50)), label("x", (10, 10), (70, 70), is_needed=False)
    assert placed(name, letter, lines=here) == {"ab": Spot(50, 50, "l"), "x": Spot(70, 70, "l")}
    assert placed(name, dots=here) == {"ab": Spot(10, 10, "l")}
    assert placed(letter, dots=here) == {"x": Spot(70, 70, "l")}


def test_no_letter_is_cut_off_at_an_edge() -> None:
    assert placed(label("abc", (90, 10)))["abc"].x == WIDTH - RIM - 30
    assert placed(label("abc", (10, 10), side="r"))["abc"].x == RIM + 30
    assert placed(label("abc", (0, 10), side="m"))["abc"].x == RIM + 15
