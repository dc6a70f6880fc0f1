"""What keys change."""

import pytest

from qdgrasp_coordinator.monitor.terminal.choice import Choice
from qdgrasp_coordinator.monitor.terminal.keyboard import keys

JOBS = ["a", "b", "c"]


def after(*pressed: str, choice: Choice | None = None) -> Choice:
    found = choice or Choice()
    for key in pressed:
        found = found.pressed(key, JOBS, 10)
    return found


@pytest.mark.parametrize(
    ("pressed", "job"),
    [
        (["tab"], "b"), (["tab", "tab", "tab"], "a"), (["backtab"], "c"), (["3"], "c"),
        (["right", "left"], "a"), (["down", "down", "up"], "b"), (["9"], "a"), (["0"], "a"),
    ],
)  # fmt: skip
def test_a_job_is_chosen_by_its_place(pressed: list[str], job: str) -> None:
    assert after(*pressed).job == job


def test_a_job_that_is_no_more_leaves_the_first_chosen() -> None:
    assert Choice(job="gone").place(JOBS) == 0
    assert Choice(job="b").place(["new", "a", "b"]) == 2


@pytest.mark.parametrize(("key", "long"), [("r", "runs"), ("w", "workers"), ("e", "events")])
def test_a_list_takes_all_the_room_and_gives_it_back(key: str, long: str) -> None:
    assert after(key).long == long
    assert after(key, key).long == after(key, "a").long == after(key, "escape").long == ""


def test_a_long_list_is_scrolled_line_by_line_and_page_by_page() -> None:
    assert after("w", "down", "down", "up").top == 1
    assert after("w", "pagedown", " ", "pageup").top == 10
    assert after("w", "up").top == 0
    assert after("w", "pagedown", "home").top == 0
    assert after("w", "pagedown", "e").top == 0
    assert after("w", "down").job == ""


def test_keys_without_a_meaning_and_without_a_job_change_nothing() -> None:
    assert after("x", "pagedown") == Choice(job="a")
    assert Choice().pressed("tab", [], 10) == Choice()


@pytest.mark.parametrize(
    ("sent", "found"),
    [
        (b"q", ["q"]), (b"\x1b[A\x1b[B", ["up", "down"]), (b"\x1bOA", ["up"]), (b"\x1b", ["escape"]),
        (b"\t\x1b[Z", ["tab", "backtab"]), (b"w\x1b[6~2", ["w", "pagedown", "2"]), (b"\x00\xff\x7f", []),
    ],
)  # fmt: skip
def test_what_terminals_send_is_understood(sent: bytes, found: list[str]) -> None:
    assert keys(sent) == found
