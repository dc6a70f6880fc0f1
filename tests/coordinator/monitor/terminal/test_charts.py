"""Charts of one job in characters."""

import pytest
from hypothesis import given
from hypothesis import strategies as st
from tests.coordinator.monitor.sample_jobs import figures, job

from qdgrasp_coordinator.monitor.terminal.charts import (
    curve_charts,
    obstacle_text,
    outcome_counts,
    outcome_lines,
    plot_curve,
    progress_line,
    sample_curve,
    split_width,
)
from qdgrasp_coordinator.monitor.terminal.text_tables import (
    ASCII,
    UNICODE,
    Glyphs,
    count_text,
    percent_text,
    short_count,
    size_text,
    span_text,
)


def test_every_genome_ends_at_one_stage() -> None:
    found = figures(dead_ends=5, overlaps=10, simulated=100, successes=60, grasps=40, robust=25)
    assert outcome_counts(found) == {
        "no pose": 5, "overlap": 10, "no contact": 40, "dropped": 20, "shaken": 15, "held": 25,
    }  # fmt: skip
    assert sum(outcome_counts(found).values()) == 115


@given(st.lists(st.integers(0, 10**9), min_size=1, max_size=6), st.integers(12, 200))
def test_a_bar_is_as_wide_as_it_is_to_be_and_shows_whatever_is_there(numbers: list[int], width: int) -> None:
    parts = split_width(numbers, width)
    assert sum(parts) == (width if any(numbers) else 0)
    assert all((wide > 0) == (number > 0) for wide, number in zip(parts, numbers, strict=True))


@pytest.mark.parametrize("width", [80, 100, 200])
def test_all_stages_are_named_beside_their_bar(width: int) -> None:
    bar, legend = outcome_lines(job(), width, UNICODE)
    assert bar.cell_len == width
    for name in ("no pose", "overlap", "no contact", "dropped", "shaken", "held"):
        assert name in legend.plain


@pytest.mark.parametrize(("evaluations", "full"), [(0, 0), (50_000, 0.5), (100_000, 1), (120_000, 1)])
def test_a_bar_is_full_when_the_budget_is_spent(evaluations: int, full: float) -> None:
    words = progress_line(job(evaluations=evaluations), 80, ASCII).plain
    marks = words.count("#") + words.count(".")
    assert len(words) == 80
    assert words.count("#") == int(full * marks)


def test_a_run_is_drawn_over_evaluations_and_many_runs_over_time() -> None:
    alone, many = curve_charts(job(runs=1)), curve_charts(job(runs=3))
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
    assert expected in obstacle_text(view, ASCII)
    assert ("left" in progress_line(view, 80, ASCII).plain) == (state != "cancelled")


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (count_text(1_234_567.4), "1 234 567"),
        (short_count(0), "0"),
        (short_count(0.84), "0.8"),
        (short_count(41_234), "41.2k"),
        (short_count(9_876), "9876"),
        (short_count(1.2e6), "1.2M"),
        (percent_text(0, 0), "0 %"),
        (percent_text(1, 1000), "<1 %"),
        (percent_text(62, 100), "62 %"),
        (span_text(4.2), "4 s"),
        (span_text(59.7), "1:00"),
        (span_text(725), "12:05"),
        (span_text(11_520), "3:12 h"),
        (span_text(216_000), "2.5 d"),
        (size_text(0), "0 B"),
        (size_text(310e6), "310 MB"),
        (size_text(1.5e9), "1.5 GB"),
    ],
)
def test_figures_are_said_in_a_few_characters(words: str, expected: str) -> None:
    assert words == expected


@given(st.floats(0, 1e12), st.floats(0, 1e9))
def test_figures_never_take_more_room_than_they_have(number: float, seconds: float) -> None:
    assert len(short_count(number)) <= 5
    assert len(size_text(number)) <= 6
    assert len(span_text(seconds)) <= 7


@pytest.mark.parametrize("glyphs", [ASCII, UNICODE], ids=["ascii", "unicode"])
@given(
    values=st.lists(st.floats(0, 1e6), max_size=50),
    width=st.integers(1, 40),
    height=st.integers(1, 10),
)
def test_a_curve_takes_exactly_its_room(glyphs: Glyphs, values: list[float], width: int, height: int) -> None:
    lines = plot_curve(range(len(values)), values, width, height, max(values, default=0.0), glyphs)
    assert [len(line) for line in lines] == [width] * height
    assert (glyphs is UNICODE) or "".join(lines).isascii()


def test_a_straight_line_is_drawn_as_one() -> None:
    assert plot_curve([0, 10], [0, 10], 5, 5, 10, ASCII) == ["    *", "   * ", "  *  ", " *   ", "*    "]


def test_a_jump_is_drawn_without_a_gap() -> None:
    lines = plot_curve([0, 5, 5.001, 10], [0, 0, 10, 10], 4, 4, 10, ASCII)
    assert all("*" in line for line in lines)


def test_braille_has_two_by_four_dots() -> None:
    assert plot_curve([0, 1], [0, 7], 1, 2, 8, UNICODE) == ["⢸", "⡸"]
    assert plot_curve([0, 1], [3, 3], 1, 1, 4, UNICODE) == ["⠉"]


def test_one_point_and_none_are_curves_as_well() -> None:
    assert plot_curve([], [], 4, 1, 0, ASCII) == ["    "]
    assert plot_curve([3], [5], 4, 1, 5, ASCII) == ["*   "]


def test_a_curve_is_read_between_its_points() -> None:
    assert sample_curve([0, 10, 20], [0, 10, 10], 5) == [0, 5, 10, 10, 10]
    assert sample_curve([], [], 5) == []
