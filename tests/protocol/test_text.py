"""Names and numbers within sentences, and back."""

import pytest

from qdgrasp_protocol.text import counted, first_few, join_numbers, parse_numbers, quoted


@pytest.mark.parametrize(
    ("count", "words"), [(0, ""), (1, "a"), (2, "a, b"), (3, "a, b and 1 more"), (5, "a, b and 3 more")]
)
def test_of_many_names_some_are_told_and_how_many_more(count: int, words: str) -> None:
    assert first_few(list("abcde")[:count], 2) == words


def test_names_of_others_are_quoted() -> None:
    assert quoted(["a b", ""]) == ["'a b'", "''"]


def test_numbers_are_told_as_a_person_writes_them_and_read_again() -> None:
    assert join_numbers([0.0, -1.0, 0.25, 1e-9]) == "0, -1, 0.25, 1e-09"
    assert parse_numbers(join_numbers([0.0, -1.0, 0.25, 1e-9])) == [0.0, -1.0, 0.25, 1e-9]


@pytest.mark.parametrize("text", ["", "up", "1,", "1,two", "1 2", "1;2"])
def test_what_holds_anything_but_numbers_holds_none(text: str) -> None:
    assert parse_numbers(text) == []


def test_one_thing_is_told_from_several() -> None:
    assert [counted(n, "run") for n in (0, 1, 2)] == ["0 runs", "1 run", "2 runs"]
    assert counted(1, "success", "successes") == "1 success"
    assert counted(2000, "success", "successes", "{:,}".format) == "2,000 successes"
    assert counted(1, "run is", "runs are") == "1 run is"
