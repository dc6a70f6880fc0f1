"""Progress of a job on a terminal and elsewhere."""

import io

import pytest
from msgspec.structs import replace
from rich.console import Console

from qdgrasp_coordinator.metrics.job_status import JobStatus
from qdgrasp_tools.local import progress
from qdgrasp_tools.local.progress import LineProgress, LiveProgress

EVIL = "\x1b[2J"
FIGURES = JobStatus(
    job="paper",
    runs=1545,
    runs_done=1233,
    runs_failed=12,
    runs_open=20,
    evaluations=123_456_789,
    budget=154_500_000,
    remaining=31_043_211,
    simulated=100_000_000,
    steps=987_654_321,
    overlaps=20_000_000,
    dead_ends=3_456_789,
    successes=12_345_678,
    grasps=2_345_678,
    robust=1_345_678,
    errors=0,
    cells=1_234_567,
    contact_niches=234_567,
    trials=0,
    workers=256,
    seconds=50_000.0,
    rate=2400.0,
    seconds_left=12_935.0,
)


def seen(figures: JobStatus, width: int = 80) -> list[str]:
    """The lines on a terminal."""
    console = Console(file=io.StringIO(), width=width, force_terminal=True, color_system=None)
    bar = LiveProgress(console, "paper", figures.budget)
    bar.show(figures)
    with console.capture() as captured:
        console.print(*bar.get_renderables())
    return [line.rstrip() for line in captured.get().splitlines()]


def test_a_terminal_shows_a_bar_with_the_time_left_and_every_figure_below_it() -> None:
    bar, *words = seen(FIGURES)
    assert bar.startswith("paper ━")
    assert bar.endswith("80 %  about 3 h 40 min left")
    assert " ".join(words).split() == FIGURES.words.split()


def test_what_a_coordinator_says_is_escaped(capsys: pytest.CaptureFixture[str]) -> None:
    figures = replace(FIGURES, trouble=EVIL)
    LineProgress("paper").show(figures)
    for said in (capsys.readouterr().err, "\n".join(seen(figures, 200))):
        assert r"paused: \x1b[2J" in said
        assert EVIL not in said


def test_a_terminal_shows_it_and_is_left_clean(monkeypatch: pytest.MonkeyPatch) -> None:
    terminal = io.StringIO()
    monkeypatch.setattr(
        progress, "Console", lambda stderr: Console(file=terminal, force_terminal=True, width=60)
    )
    with progress.progress_messages() as tell:
        tell("reading [mugs].yaml")
    shown = terminal.getvalue()
    assert "reading [mugs].yaml" in shown
    assert shown.endswith("\x1b[2K")
