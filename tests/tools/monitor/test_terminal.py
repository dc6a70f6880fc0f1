"""The monitor on a terminal, in the room that it has, and the effect of keys."""

import io
from functools import reduce
from typing import Any

import pytest
from msgspec import structs
from rich.cells import cell_len
from rich.console import Console
from tests.tools.monitor.sample_jobs import ENDPOINT, event, job, shown, worker

from qdgrasp_coordinator.metrics.run_stats import NO_TOTALS
from qdgrasp_tools.monitor import terminal
from qdgrasp_tools.monitor.terminal import ScreenSelection, ScreenState, parse_keys

JOBS = ["a", "b", "c"]
GOOD = structs.replace(NO_TOTALS, evaluations=100, successes=50, grasps=20, cells=10)


def after(*pressed: str) -> ScreenSelection:
    return reduce(lambda choice, key: choice.after_key(key, JOBS, 10), pressed, ScreenSelection())


class TestKeys:
    @pytest.mark.parametrize(
        ("pressed", "job"),
        [
            (["tab"], "b"), (["tab", "tab", "tab"], "a"), (["backtab"], "c"), (["3"], "c"),
            (["down", "down", "up"], "b"), (["9"], "a"), (["x", "pagedown"], "a"),
        ],
    )  # fmt: skip
    def test_a_job_is_chosen_by_its_place(self, pressed: list[str], job: str) -> None:
        assert after(*pressed).job == job

    def test_a_long_list_is_scrolled_line_by_line_and_page_by_page(self) -> None:
        assert after("w", "down", "down", "up").top == 1
        assert after("w", "pagedown", " ", "pageup").top == 10
        assert [after("w", *keys).top for keys in (["up"], ["pagedown", "e"])] == [0, 0]
        assert after("w", "down").job == ""

    @pytest.mark.parametrize(
        ("sent", "found"),
        [
            (b"q", ["q"]), (b"\x1b[A\x1b[B", ["up", "down"]), (b"\x1b", ["escape"]), (b"\x00\xff", []),
            (b"\t\x1b[Z", ["tab", "backtab"]), (b"w\x1b[6~2", ["w", "pagedown", "2"]),
        ],
    )  # fmt: skip
    def test_what_terminals_send_is_understood(self, sent: bytes, found: list[str]) -> None:
        assert parse_keys(sent) == found


ONE = shown(job())
MANY = shown(
    job("cubes", runs=24), job("mugs"), job("a-job-with-a-name-that-is-much-too-long-for-its-column")
)
SIZES = [(80, 24), (200, 60), terminal.MIN_SIZE]


def text(what: ScreenState, width: int = 80, height: int = 24, **choice: Any) -> str:
    """Return the screen of a terminal of that size, with a list or a job selected."""
    console = Console(file=io.StringIO(), width=width, height=height, force_terminal=True, color_system=None)
    with console.capture() as seen:
        console.print(terminal.screen_layout(what, ScreenSelection(**choice), width, height), end="")
    return seen.get()


class TestRoom:
    @pytest.mark.parametrize(("width", "height"), SIZES)
    @pytest.mark.parametrize("what", [ONE, MANY, shown()], ids=["one", "many", "none"])
    @pytest.mark.parametrize("long", ["", "events", "workers"])
    def test_a_frame_fills_its_terminal_exactly(self, width, height, what, long) -> None:
        lines = text(what, width, height, list=long, top=3).removesuffix("\n").split("\n")
        assert len(lines) == height
        assert max(map(cell_len, lines)) <= width

    def test_eighty_columns_and_24_lines_show_the_essential(self) -> None:
        seen = text(ONE)
        for words in (
            ENDPOINT, "mugs", "running", "24 900 of 100 000 evaluations", "25 %", "about 15 min left",
            "83/s lately", "2 766 successes", "498 cells", "830 robust", "0 errors", "overlap 40%",
            "no contact", "dropped", "held",
            "15 working, 15 idle on 7 hosts: 1 to ", "node-0", "310 MB", "leases", "rows/s",
            "Worker 19 joined.", "q quit",
        ):  # fmt: skip
            assert words in seen

    def test_a_large_terminal_shows_more(self) -> None:
        small, large = text(MANY), text(MANY, 200, 60)
        assert "panda-mug-portfolio-s1" not in small
        for words in ("panda-mug-portfolio-s0", "panda-mug-portfolio-s1", "Worker 15 joined.", "restarts"):
            assert words in large

    def test_a_long_list_has_all_the_room_and_scrolls(self) -> None:
        first, later = text(ONE, list="workers"), text(ONE, list="workers", top=12)
        assert "idle on 7 hosts: 1 to 18 of 30" in first
        assert "idle on 7 hosts: 13 to 30 of 30" in later
        rows = terminal.list_rows(ONE, ScreenSelection(list="workers"), 24)
        assert first.count("node-") == later.count("node-") == 18 == rows

    def test_the_job_that_is_chosen_is_among_those_that_are_seen(self) -> None:
        many = shown(*(job(f"job-{number:02}", seconds=2) for number in range(40)))
        for number in (0, 20, 39):
            lines = text(many, job=f"job-{number:02}").splitlines()
            assert any(line.startswith(">") and f"job-{number:02}" in line for line in lines)


class TestTrouble:
    def test_workers_in_trouble_come_first(self) -> None:
        states = {"well": "idle", "lost": "gone", "slow": "stuck"}
        workers = [worker(n, host=host, state=state) for n, (host, state) in enumerate(states.items())]
        seen = text(shown(job(workers=workers)), list="workers")
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
            (job(state="cancelled"), "ended before it was done: `qdgrasp resume"),
            (job(seconds=1, evaluations=0, budget=0, rate=0.0), "0 of 0 evaluations"),
        ],
        ids=["silent", "disk", "recorder", "doing", "paused", "behind", "requeued", "alone", "over", "new"],
    )  # fmt: skip
    def test_what_is_in_the_way_is_said(self, view, words: str) -> None:
        assert words in text(shown(view))

    def test_a_router_that_left_with_the_last_job_is_not_missed(self) -> None:
        over = shown(job(runs_done=1), job("bowls", state="cancelled"), is_linked=False)
        assert "The router has left" in text(over)
        assert "away" not in text(over)
        words = terminal.status_lines(over)
        assert (words[0][:6], words[-1][:19]) == ("mugs: ", "The router has left")

    def test_what_others_wrote_is_escaped(self) -> None:
        evil = "\x1b[2J\n\u202e[bold]evil"
        view = job(
            trouble=evil, workers=[worker(0, host=evil, state=evil)], events=[event(1, evil, kind="trouble")]
        )
        for long in ("", "workers", "events"):
            seen = text(shown(view), 200, 60, list=long)
            assert "\x1b" not in seen
            assert "\u202e" not in seen
            assert "\\x1b[2J\\n\\u202e[bold]evil" in seen
