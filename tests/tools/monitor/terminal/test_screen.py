"""The screen on a terminal, in the room that it has, and the effect of keys."""

import io
import re
from collections.abc import Callable
from datetime import UTC, datetime
from functools import reduce
from pathlib import Path
from typing import Any, get_args, get_type_hints

import pytest
from hypothesis import HealthCheck, Phase, given, settings
from hypothesis import strategies as st
from msgspec import Struct, structs
from rich.cells import cell_len
from rich.console import Console
from tests.tools.monitor.sample_jobs import ENDPOINT, NOW, event, figures, job, run, shown, worker

from qdgrasp_coordinator.metrics import job_status
from qdgrasp_coordinator.metrics.run_stats import NO_TOTALS, CurvePoint, GrowthCurve
from qdgrasp_protocol.keys import Keys
from qdgrasp_protocol.spec import RunSpec
from qdgrasp_tools.campaign.object_library import SkippedObject
from qdgrasp_tools.campaign.object_table import ObjectRun, list_objects
from qdgrasp_tools.monitor.feed import summary_lines as told
from qdgrasp_tools.monitor.job_model import JobModels
from qdgrasp_tools.monitor.job_view import JobView
from qdgrasp_tools.monitor.terminal import charts, screen
from qdgrasp_tools.monitor.terminal import text_tables as tables
from qdgrasp_tools.monitor.terminal.keyboard import parse_keys
from qdgrasp_tools.monitor.terminal.screen import ScreenSelection, ScreenState
from qdgrasp_tools.monitor.terminal.text_tables import ASCII, UNICODE, Glyphs

JOBS = ["a", "b", "c"]
GOOD = structs.replace(NO_TOTALS, evaluations=100, successes=50, grasps=20, cells=10)


def after(*pressed: str) -> ScreenSelection:
    return reduce(lambda choice, key: choice.after_key(key, JOBS, 10), pressed, ScreenSelection())


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
    assert ScreenSelection(job="gone").index(JOBS) == 0
    assert ScreenSelection(job="b").index(["new", "a", "b"]) == 2


@pytest.mark.parametrize(
    ("key", "long"), [("o", "objects"), ("r", "runs"), ("w", "workers"), ("e", "events")]
)
def test_a_list_takes_all_the_room_and_gives_it_back(key: str, long: str) -> None:
    assert after(key).list == long
    assert after(key, key).list == after(key, "a").list == after(key, "escape").list == ""


def test_a_long_list_is_scrolled_line_by_line_and_page_by_page() -> None:
    assert after("w", "down", "down", "up").top == 1
    assert after("w", "pagedown", " ", "pageup").top == 10
    assert [after("w", *keys).top for keys in (["up"], ["pagedown", "home"], ["pagedown", "e"])] == [0, 0, 0]
    assert after("w", "down").job == ""


def test_keys_without_a_meaning_and_without_a_job_change_nothing() -> None:
    assert after("x", "pagedown") == ScreenSelection(job="a")
    assert ScreenSelection().after_key("tab", [], 10) == ScreenSelection()


@pytest.mark.parametrize(
    ("sent", "found"),
    [
        (b"q", ["q"]), (b"\x1b[A\x1b[B", ["up", "down"]), (b"\x1bOA", ["up"]), (b"\x1b", ["escape"]),
        (b"\t\x1b[Z", ["tab", "backtab"]), (b"w\x1b[6~2", ["w", "pagedown", "2"]), (b"\x00\xff", []),
        (b"\r\x7f", ["enter", "backspace"]),
    ],
)  # fmt: skip
def test_what_terminals_send_is_understood(sent: bytes, found: list[str]) -> None:
    assert parse_keys(sent) == found


ONE = shown(job())
MANY = shown(
    job("cubes", runs=24), job("mugs"), job("a-job-with-a-name-that-is-much-too-long-for-its-column")
)
SIZES = [(80, 24), (200, 60), (100, 30), (120, 40), (60, 20), screen.MIN_SIZE]


def text(
    what: ScreenState, width: int = 80, height: int = 24, glyphs: Glyphs = UNICODE, **choice: Any
) -> str:
    """Return the screen of a terminal of that size, with a list or a job selected."""
    file = io.StringIO()
    console = Console(file=file, width=width, height=height, force_terminal=True, color_system=None)
    for line in screen.screen_lines(what, ScreenSelection(**choice), width, height, glyphs):
        console.print(line)
    return file.getvalue().removesuffix("\n")


def check_fits(shown: str, width: int, height: int) -> None:
    lines = shown.splitlines()
    assert len(lines) == height
    assert max(map(cell_len, lines)) <= width


class TestRoom:
    @pytest.mark.parametrize(("width", "height"), SIZES)
    @pytest.mark.parametrize("what", [ONE, MANY, shown()], ids=["one", "many", "none"])
    @pytest.mark.parametrize("long", ["", "objects", "runs", "workers", "events"])
    @pytest.mark.parametrize("glyphs", [UNICODE, ASCII], ids=["unicode", "ascii"])
    def test_a_frame_fills_its_terminal_exactly(self, width, height, what, long, glyphs) -> None:
        check_fits(text(what, width, height, glyphs, list=long, top=3), width, height)

    def test_eighty_columns_and_24_lines_show_the_essential(self) -> None:
        seen = text(ONE)
        for words in (
            ENDPOINT, "mugs", "running", "24 900 of 100 000 evaluations", "25 %", "about 15 min left",
            "83/s lately", "2 766 successes", "498 cells", "830 robust", "0 errors", "overlap 40%",
            "no contact", "dropped", "held", "evaluations/s 83", "cells 498",
            "15 working, 15 idle on 7 hosts", "node-0", "310 MB", "leases", "rows/s",
            "Worker 19 joined.", "q quit", "(27 more)",
        ):  # fmt: skip
            assert words in seen

    def test_a_large_terminal_shows_more(self) -> None:
        small, large = text(MANY), text(MANY, 200, 60)
        assert "panda-mug-aimed-s1" not in small
        for words in ("panda-mug-aimed-s0", "panda-mug-aimed-s1", "Worker 15 joined.", "restarts"):
            assert words in large
        assert large.count("node-") > small.count("node-")
        assert large.count("Worker 1") > small.count("Worker 1")

    def test_ascii_is_ascii(self) -> None:
        for width, height in SIZES:
            assert text(MANY, width, height, glyphs=ASCII).isascii()

    def test_a_terminal_that_is_too_small_says_how_large_it_must_be(self) -> None:
        assert text(ONE, 30, 8) == "40 columns, 12 lines"


class TestLongLists:
    def test_a_long_list_has_all_the_room_and_scrolls(self) -> None:
        first, later = text(ONE, list="workers"), text(ONE, list="workers", top=12)
        assert "workers of mugs: 1 to 18 of 30" in first
        assert "workers of mugs: 13 to 30 of 30" in later
        assert first.count("node-") == later.count("node-") == 18 == screen.list_rows(ONE, 80, 24, UNICODE)

    def test_the_job_that_is_chosen_is_among_those_that_are_seen(self) -> None:
        many = shown(*(job(f"job-{number:02}", seconds=2) for number in range(40)))
        for number in (0, 20, 39):
            seen = text(many, job=f"job-{number:02}")
            assert f"▸{'' if number > 8 else f'  {number + 1}'}" in seen
            assert f"── job-{number:02} ──" in seen


LIBRARY = shown(
    job("parts", runs=80),
    objects=list_objects(
        [
            ObjectRun(f"panda-part_{n}-s0", RunSpec(gripper="panda", object=f"part_{n}"), GOOD, is_done=True)
            for n in range(40)
        ],
        [SkippedObject("torn", "torn.stl", "it is not closed", "--remesh")],
    ),
)


class TestObjects:
    def test_a_campaign_shows_its_objects_with_what_they_got(self) -> None:
        seen = text(LIBRARY, list="objects")
        assert "objects of parts: 1 to 18 of 41" in seen
        assert "part_17" in seen
        assert "part_18" not in seen
        assert "s sort  S turn the order  / search" in seen
        assert "1/1" in seen.splitlines()[6]

    def test_objects_are_sorted_and_turned(self) -> None:
        seen = text(LIBRARY, list="objects", sort="object", down=True)
        assert "by object, greatest first" in seen
        assert seen.index("torn") < seen.index("part_39") < seen.index("part_38")

    def test_a_search_shows_what_is_typed_and_what_it_leaves(self) -> None:
        seen = text(LIBRARY, list="objects", search="remesh", is_typing=True)
        assert "1 to 1 of 1; search: remesh_" in seen
        assert "left out" in seen
        assert "enter keep the search" in seen
        assert "objects of parts: none; search: nothing" in text(LIBRARY, list="objects", search="nothing")

    def test_a_job_whose_objects_are_not_known_says_so(self) -> None:
        assert "No recorder has told of the objects yet." in text(MANY, list="objects")
        assert "There is no recorder." in text(shown(job(recorders=0)), list="objects")

    def test_keys_sort_and_search_where_objects_are_shown(self) -> None:
        assert after("o", "s").sort == "object"
        assert after("o", *(["s"] * 10)).sort == ""
        assert after("o", "S").down
        assert after("s", "S", "/") == ScreenSelection(job="a")
        typed = after("o", "pagedown", "/", "m", "u", "q", "2", "backspace")
        assert (typed.search, typed.is_typing, typed.top, typed.job) == ("muq", True, 0, "")
        assert (after("o", "/", "m", "enter").search, after("o", "/", "m", "enter").is_typing) == ("m", False)
        assert after("o", "/", "m", "escape") == ScreenSelection(list="objects")

    def test_shapes_are_counted_beside_runs(self) -> None:
        seen = text(shown(job(runs=3, scenes=40, scenes_done=12, scenes_failed=1)), 120)
        assert "12 of 40 shapes and 1 failed · 0 of 3 runs" in seen


class TestTrouble:
    def test_workers_in_trouble_come_first(self) -> None:
        states = {"well": "idle", "lost": "gone", "slow": "stuck"}
        workers = [worker(n, host=host, state=state) for n, (host, state) in enumerate(states.items())]
        seen = text(shown(job(workers=workers)))
        assert seen.index("lost") < seen.index("slow") < seen.index("well")

    @pytest.mark.parametrize(
        ("view", "words"),
        [
            (job(later=9.0), "nothing was heard of it for 9 s"),
            (job(trouble="the disk is full"), "waits: the disk is full"),
            (job(recorders=0), "no recorder is there"),
            (job(doing="building the shape of mug.stl"), "building the shape of mug.stl · all on disk"),
            (job(state="paused"), "paused until `qdgrasp continue mugs`"),
            (job(waiting=1234), "1 234 rows not on disk yet"),
            (job(requeued=3, strays=2), "3 batches given again · 2 results dropped"),
            (job(workers=[]), "workers: none has joined"),
            (job(state="cancelled"), f"ended before it was done: {charts.GO_ON}"),
            (job(state="ending", later=60.0), "nothing was heard of it"),
            (job(), "all on disk"),
        ],
        ids=[
            *("silent", "disk", "recorder", "doing", "paused", "behind", "requeued", "alone"),
            *("cancelled", "ending", "running"),
        ],
    )  # fmt: skip
    def test_what_is_in_the_way_is_said(self, view, words: str) -> None:
        assert words in text(shown(view))
        assert ("left" in charts.progress_line(view, 80, ASCII).plain) == (view.state != "cancelled")

    @pytest.mark.parametrize("views", [(job(),), (job(runs_done=1), job("bowls"))])
    def test_a_router_that_is_away_is_said(self, views: tuple[JobView, ...]) -> None:
        assert "The router is away" in text(shown(*views, is_linked=False))

    def test_a_router_that_left_with_the_last_job_is_not_missed(self) -> None:
        over = shown(job(runs_done=1), job("bowls", state="cancelled"), is_linked=False)
        assert "The router has left" in text(over)
        assert "away" not in text(over)
        words = screen.status_lines(over, 80, ASCII)
        assert (words[0][:6], words[-1][:19]) == ("mugs: ", "The router has left")

    def test_jobs_of_another_version_are_named(self) -> None:
        words = "Watch with their own version of qdgrasp-monitor: old"
        assert words in text(shown(foreign_jobs=["old"]))

    def test_where_there_is_no_job_it_is_said_what_to_do(self) -> None:
        seen = text(shown())
        assert f"No job is at {ENDPOINT}" in seen
        assert "qdgrasp run" in seen

    def test_a_job_without_an_evaluation_can_be_seen(self) -> None:
        for width, height in SIZES:
            assert "mugs" in text(shown(job(seconds=1, evaluations=0, budget=0, rate=0.0)), width, height)

    def test_what_others_wrote_is_escaped(self) -> None:
        evil = "\x1b[2J\n\u202eevil"
        view = job(
            trouble=evil, workers=[worker(0, host=evil, state=evil)], events=[event(1, evil, kind="trouble")]
        )
        for glyphs in (UNICODE, ASCII):
            for long in ("", "workers", "events"):
                seen = text(shown(view), 200, 60, glyphs, list=long)
                assert "\x1b" not in seen
                assert "\u202e" not in seen
                assert "\\x1b[2J\\n\\u202eevil" in seen


WILD = st.integers(0, job_status.GREATEST_COUNT) | st.integers(0, 3)
WILD_FLOAT = st.floats(0, job_status.GREATEST_COUNT)
WILD_TEXT = st.text(max_size=40)


def wild(kind: type[Struct]) -> st.SearchStrategy[Struct]:
    """Any message of a kind."""
    of_type = {
        int: WILD,
        float: WILD_FLOAT,
        float | None: st.none() | WILD_FLOAT,
        str: WILD_TEXT,
        datetime: st.datetimes(timezones=st.just(UTC)),
        list[str]: st.lists(WILD_TEXT, max_size=3),
        dict[str, int]: st.dictionaries(WILD_TEXT, WILD, max_size=3),
        job_status.EventKind: st.sampled_from(get_args(job_status.EventKind)),
        list[job_status.WorkerStatus]: st.lists(
            st.deferred(lambda: wild(job_status.WorkerStatus)), max_size=3
        ),
        list[CurvePoint]: st.lists(st.builds(CurvePoint, *[WILD] * 5), max_size=5),
    }
    return st.builds(kind, **{name: of_type[hint] for name, hint in get_type_hints(kind).items()})


@settings(
    max_examples=25,
    suppress_health_check=[HealthCheck.too_slow],
    phases=[Phase.explicit, Phase.reuse, Phase.generate],
)
@given(
    meta=wild(job_status.JobMeta),
    figures=st.lists(wild(job_status.JobStatus), min_size=1, max_size=3),
    runs=st.lists(wild(job_status.RunStatus), max_size=3),
    pages=st.lists(wild(job_status.WorkersPage), max_size=2),
    events=st.lists(wild(job_status.JobEvent), max_size=3),
    curve=wild(GrowthCurve),
    size=st.sampled_from(SIZES),
)
def test_whatever_a_coordinator_says_fits(meta, figures, runs, pages, events, curve, size) -> None:
    jobs, keys = JobModels(), Keys("mugs")
    says = [(keys.stat(f"run/{number}"), one) for number, one in enumerate(runs)]
    says += [(keys.stat(f"team/{number}"), one) for number, one in enumerate(pages)]
    says += [(keys.stat("job"), one) for one in figures]
    says += [(keys.event("job"), one) for one in events]
    says += [(keys.meta, meta), (keys.stat("curve/a"), curve)]
    for number, (key, one) in enumerate(says):
        jobs.receive(key, job_status.to_json(one), 1000.0 + number)
    (view,) = jobs.views(1005.0)
    for long in ("", "runs", "workers", "events"):
        for glyphs in (UNICODE, ASCII):
            for line in screen.screen_lines(shown(view), ScreenSelection(list=long), *size, glyphs):
                assert line.cell_len <= size[0], line.plain
            check_fits(text(shown(view), *size, glyphs, list=long), *size)
    assert list(told(view, NOW))


def test_a_sheet_shows_everything_of_all_jobs() -> None:
    seen = [line.plain for line in screen.report_lines(MANY, 80, UNICODE)]
    assert max(map(cell_len, seen)) <= 80
    assert sum("node-" in line for line in seen) == 90
    assert sum(line.startswith("── ") and "running" in line for line in seen) == 3


@given(st.integers(0, 60), st.lists(st.tuples(st.integers(0, 5), st.integers(0, 30)), max_size=5))
def test_parts_share_the_room_and_the_first_come_first(room: int, wishes: list[tuple[int, int]]) -> None:
    wishes = [(least, max(least, most)) for least, most in wishes]
    given_ = screen.share_rows(room, wishes)
    assert sum(given_) <= room
    assert all(wide == 0 or least <= wide <= most for wide, (least, most) in zip(given_, wishes, strict=True))
    if wishes and wishes[0][0] <= room:
        assert given_[0] >= wishes[0][0]


def test_every_genome_ends_at_one_stage() -> None:
    found = figures(dead_ends=5, overlaps=10, simulated=100, successes=60, grasps=40, robust=25)
    assert charts.outcome_counts(found) == {
        "dead end": 5, "overlap": 10, "no contact": 40, "dropped": 20, "shaken": 15, "held": 25,
    }  # fmt: skip
    assert sum(charts.outcome_counts(found).values()) == 115


@given(st.lists(st.integers(0, 10**9), min_size=1, max_size=6), st.integers(12, 200))
def test_a_bar_is_as_wide_as_it_is_to_be_and_shows_whatever_is_there(numbers: list[int], width: int) -> None:
    parts = charts.split_width(numbers, width)
    assert sum(parts) == (width if any(numbers) else 0)
    assert all((wide > 0) == (number > 0) for wide, number in zip(parts, numbers, strict=True))


@pytest.mark.parametrize("width", [80, 100, 200])
def test_all_stages_are_named_beside_their_bar(width: int) -> None:
    bar, legend = charts.outcome_lines(job(), width, UNICODE)
    assert bar.cell_len == width
    for name in ("dead end", "overlap", "no contact", "dropped", "shaken", "held"):
        assert name in legend.plain


def test_the_stages_are_called_as_in_the_glossary() -> None:
    glossary = (Path(__file__).parents[4] / "docs" / "glossary.md").read_text(encoding="utf-8")
    (line,) = re.findall(r"^\| outcome \|.*", glossary, re.MULTILINE)
    assert {name for name in charts.outcome_counts(job().figures) if f"`{name}`" not in line} == set()


@pytest.mark.parametrize(("evaluations", "full"), [(0, 0), (50_000, 0.5), (100_000, 1), (120_000, 1)])
def test_a_bar_is_full_when_the_budget_is_spent(evaluations: int, full: float) -> None:
    words = charts.progress_line(job(evaluations=evaluations), 80, ASCII).plain
    marks = words.count("#") + words.count(".")
    assert len(words) == 80
    assert words.count("#") == int(full * marks)


def test_runs_whose_names_end_alike_are_told_apart_at_80_columns() -> None:
    long = [f"panda-tennis_ball-aimed-s{seed}" for seed in (0, 1)]
    listed = structs.replace(job(runs=2), runs=[run(name, finished="the budget is spent") for name in long])
    for width, last in ((80, "robust"), (160, "the budget is spent")):
        lines = [line.plain for line in tables.run_list(listed, width, UNICODE)]
        assert {line.split()[0] for line in lines[1:]} == set(long)
        assert last in "".join(lines)
    assert all(cell_len(line.plain) <= 40 for line in tables.run_list(listed, 40, UNICODE))


def test_a_run_is_drawn_over_evaluations_and_many_runs_over_time() -> None:
    alone, many = charts.curve_charts(job(runs=1)), charts.curve_charts(job(runs=3))
    assert [one.title for one in alone] == ["cells", "successes", "evaluations/s"]
    assert (alone[0].places[0], alone[0].values[0], alone[0].values[-1]) == (0, 0, 498)
    assert [one.places[0] for one in many] == [1001.0] * 3
    assert [(one.first, one.last) for one in many] == [("4:59 ago", "now")] * 3
    assert all(list(one.places) == sorted(one.places) for one in many)


@pytest.mark.parametrize(
    ("text_of", "texts"),
    [
        (tables.count_text, {1_234_567.4: "1 234 567"}),
        (tables.short_count, {0: "0", 0.84: "0.8", 41_234: "41.2k", 9_876: "9876", 1.2e6: "1.2M"}),
        (tables.span_text, {4.2: "4 s", 59.7: "1:00", 725: "12:05", 11_520: "3:12 h", 216_000: "2.5 d"}),
        (tables.size_text, {0: "0 B", 310e6: "310 MB", 1.5e9: "1.5 GB"}),
        (lambda some: tables.percent_text(*some), {(0, 0): "0 %", (1, 1000): "<1 %", (62, 100): "62 %"}),
    ],
)
def test_figures_are_said_in_a_few_characters(text_of: Callable[[Any], str], texts: dict[Any, str]) -> None:
    assert {figure: text_of(figure) for figure in texts} == texts


@given(st.floats(0, 1e12), st.floats(0, 1e9))
def test_figures_never_take_more_room_than_they_have(number: float, seconds: float) -> None:
    assert len(tables.short_count(number)) <= 5
    assert len(tables.size_text(number)) <= 6
    assert len(tables.span_text(seconds)) <= 7


@pytest.mark.parametrize("glyphs", [ASCII, UNICODE], ids=["ascii", "unicode"])
@given(values=st.lists(st.floats(0, 1e6), max_size=50), width=st.integers(1, 40), height=st.integers(1, 10))
def test_a_curve_takes_exactly_its_room(glyphs: Glyphs, values: list[float], width: int, height: int) -> None:
    lines = charts.plot_curve(range(len(values)), values, width, height, max(values, default=0.0), glyphs)
    assert [len(line) for line in lines] == [width] * height
    assert (glyphs is UNICODE) or "".join(lines).isascii()


def test_a_straight_line_is_drawn_as_one() -> None:
    diagonal = [f"{'*':>{width}}".ljust(5) for width in range(5, 0, -1)]
    assert charts.plot_curve([0, 10], [0, 10], 5, 5, 10, ASCII) == diagonal


def test_a_jump_is_drawn_without_a_gap() -> None:
    lines = charts.plot_curve([0, 5, 5.001, 10], [0, 0, 10, 10], 4, 4, 10, ASCII)
    assert all("*" in line for line in lines)


def test_braille_has_two_by_four_dots() -> None:
    assert charts.plot_curve([0, 1], [0, 7], 1, 2, 8, UNICODE) == ["⢸", "⡸"]
    assert charts.plot_curve([0, 1], [3, 3], 1, 1, 4, UNICODE) == ["⠉"]


def test_one_point_and_none_are_curves_as_well() -> None:
    assert charts.plot_curve([], [], 4, 1, 0, ASCII) == ["    "]
    assert charts.plot_curve([3], [5], 4, 1, 5, ASCII) == ["*   "]


def test_a_curve_is_read_between_its_points() -> None:
    assert charts.sample_curve([0, 10, 20], [0, 10, 10], 5) == [0, 5, 10, 10, 10]
    assert charts.sample_curve([], [], 5) == []
