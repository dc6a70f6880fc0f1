"""The monitor on a terminal, in the room that it has."""

import io

import pytest
from rich.cells import cell_len
from rich.console import Console
from tests.tools.monitor.sample_jobs import ENDPOINT, event, job, shown, worker

from qdgrasp_tools.monitor import terminal
from qdgrasp_tools.monitor.terminal import ScreenState

ONE = shown(job())
MANY = shown(
    job("cubes", runs=24), job("mugs"), job("a-job-with-a-name-that-is-much-too-long-for-its-column")
)
SIZES = [(80, 24), (200, 60), terminal.MIN_SIZE]


def text(what: ScreenState, width: int = 80, height: int = 24) -> str:
    """Return the screen of a terminal of that size."""
    console = Console(file=io.StringIO(), width=width, height=height, force_terminal=True, color_system=None)
    with console.capture() as seen:
        console.print(terminal.screen_layout(what, width, height), end="")
    return seen.get()


class TestRoom:
    @pytest.mark.parametrize(("width", "height"), SIZES)
    @pytest.mark.parametrize("what", [ONE, MANY, shown()], ids=["one", "many", "none"])
    def test_a_frame_fills_its_terminal_exactly(self, width, height, what) -> None:
        lines = text(what, width, height).removesuffix("\n").split("\n")
        assert len(lines) == height
        assert max(map(cell_len, lines)) <= width

    def test_eighty_columns_and_24_lines_show_the_essential(self) -> None:
        seen = text(ONE)
        for words in (
            ENDPOINT, "mugs", "running", "24 900 of 100 000 evaluations", "25 %", "about 15 min left",
            "83/s lately", "2 766 successes", "498 cells", "830 robust", "0 errors", "overlap 40%",
            "no contact", "dropped", "held",
            "15 working, 15 idle on 7 hosts: 1 to ", "node-0", "310 MB", "leases", "rows/s",
            "Worker 19 joined.", "Ctrl-C",
        ):  # fmt: skip
            assert words in seen

    def test_a_large_terminal_shows_more(self) -> None:
        small, large = text(MANY), text(MANY, 200, 60)
        assert "panda-mug-portfolio-s1" not in small
        for words in ("panda-mug-portfolio-s0", "panda-mug-portfolio-s1", "Worker 15 joined.", "restarts"):
            assert words in large


class TestTrouble:
    def test_workers_in_trouble_come_first(self) -> None:
        states = {"well": "idle", "lost": "gone", "slow": "stuck"}
        workers = [worker(n, host=host, state=state) for n, (host, state) in enumerate(states.items())]
        seen = text(shown(job(workers=workers)), height=40)
        assert seen.index("lost") < seen.index("slow") < seen.index("well")

    @pytest.mark.parametrize(
        ("view", "words"),
        [
            (job(later=9.0, recorders=0), "nothing was heard of it for 9 s"),
            (job(trouble="the disk is full", recorders=0), "waits: the disk is full"),
            (job(doing="building the shape of mug.stl"), "building the shape of mug.stl · all on disk"),
            (job(state="paused", waiting=1234), "paused until `qdgrasp continue mugs` · 1 234 rows not on"),
            (job(seconds=1, evaluations=0, budget=0, rate=0.0), "0 of 0 evaluations"),
        ],
        ids=["silent", "disk", "doing", "paused", "new"],
    )
    def test_what_is_in_the_way_is_said(self, view, words: str) -> None:
        assert words in text(shown(view))

    def test_a_router_that_left_with_the_last_job_is_not_missed(self) -> None:
        over = shown(job(runs_done=1), job("bowls", state="cancelled"), is_linked=False)
        assert "The router has left" in text(over)
        assert "away" not in text(over)

    def test_what_others_wrote_is_escaped(self) -> None:
        evil = "\x1b[2J\n\u202e[bold]evil"
        view = job(
            trouble=evil, workers=[worker(0, host=evil, state=evil)], events=[event(1, evil, kind="trouble")]
        )
        seen = text(shown(view), 200, 60)
        assert "\x1b" not in seen
        assert "\u202e" not in seen
        assert seen.count("\\x1b[2J\\n\\u202e[bold]evil") >= 3
