"""What is shown of one job."""

import pytest
from hypothesis import given
from hypothesis import strategies as st
from tests.coordinator.monitor.shown import figures
from tests.coordinator.monitor.terminal.seen import job

from qdgrasp_coordinator.monitor.terminal.glyphs import ASCII, UNICODE
from qdgrasp_coordinator.monitor.terminal.parts import drawings, ends, hindrance, parted, progress, stages
from qdgrasp_coordinator.monitor.terminal.words import count, part, short, size, span


def test_every_genome_ends_at_one_stage() -> None:
    found = figures(dead_ends=5, overlaps=10, simulated=100, successes=60, grasps=40, robust=25)
    assert ends(found) == {
        "no pose": 5, "overlap": 10, "no contact": 40, "dropped": 20, "shaken": 15, "held": 25,
    }  # fmt: skip
    assert sum(ends(found).values()) == 115


@given(st.lists(st.integers(0, 10**9), min_size=1, max_size=6), st.integers(12, 200))
def test_a_bar_is_as_wide_as_it_is_to_be_and_shows_whatever_is_there(numbers: list[int], width: int) -> None:
    parts = parted(numbers, width)
    assert sum(parts) == (width if any(numbers) else 0)
    assert all((wide > 0) == (number > 0) for wide, number in zip(parts, numbers, strict=True))


@pytest.mark.parametrize("width", [80, 100, 200])
def test_all_stages_are_named_beside_their_bar(width: int) -> None:
    bar, legend = stages(job(), width, UNICODE)
    assert bar.cell_len == width
    for name in ("no pose", "overlap", "no contact", "dropped", "shaken", "held"):
        assert name in legend.plain


@pytest.mark.parametrize(("evaluations", "full"), [(0, 0), (50_000, 0.5), (100_000, 1), (120_000, 1)])
def test_a_bar_is_full_when_the_budget_is_spent(evaluations: int, full: float) -> None:
    words = progress(job(evaluations=evaluations), 80, ASCII).plain
    marks = words.count("#") + words.count(".")
    assert len(words) == 80
    assert words.count("#") == int(full * marks)


def test_a_run_is_drawn_over_evaluations_and_many_runs_over_time() -> None:
    alone, many = drawings(job(runs=1)), drawings(job(runs=3))
    assert [one.title for one in alone] == ["cells", "successes", "evaluations/s"]
    assert (alone[0].places[0], alone[0].values[0], alone[0].values[-1]) == (0, 0, 498)
    assert [one.places[0] for one in many] == [1001.0] * 3
    assert [(one.first, one.last) for one in many] == [("4:59 ago", "now")] * 3
    assert all(list(one.places) == sorted(one.places) for one in many)


@pytest.mark.parametrize(
    ("state", "later", "expected"),
    [
        ("cancelled", 0.5, "ended before it was done: `qdgrasp resume DIR` goes on"),
        ("ending", 60.0, "nothing was heard of it"),
        ("running", 0.5, "all on disk"),
    ],
)
def test_what_keeps_a_job_from_going_on_is_said(state: str, later: float, expected: str) -> None:
    view = job(state=state, later=later)
    assert expected in hindrance(view, ASCII)
    assert ("left" in progress(view, 80, ASCII).plain) == (state != "cancelled")


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (count(1_234_567.4), "1 234 567"), (short(0), "0"), (short(0.84), "0.8"), (short(41_234), "41.2k"),
        (short(9_876), "9876"), (short(1.2e6), "1.2M"), (part(0, 0), "0 %"), (part(1, 1000), "<1 %"),
        (part(62, 100), "62 %"),
        (span(4.2), "4 s"), (span(59.7), "1:00"), (span(725), "12:05"), (span(11_520), "3:12 h"),
        (span(216_000), "2.5 d"), (size(0), "0 B"), (size(310e6), "310 MB"), (size(1.5e9), "1.5 GB"),
    ],
)  # fmt: skip
def test_figures_are_said_in_a_few_characters(words: str, expected: str) -> None:
    assert words == expected


@given(st.floats(0, 1e12), st.floats(0, 1e9))
def test_figures_never_take_more_room_than_they_have(number: float, seconds: float) -> None:
    assert len(short(number)) <= 5
    assert len(size(number)) <= 6
    assert len(span(seconds)) <= 7
