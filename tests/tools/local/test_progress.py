"""Progress of a job on a terminal and elsewhere."""

import io

import pytest
from msgspec.structs import replace
from rich.console import Console
from tests.tools.monitor.sample_jobs import figures

from qdgrasp_coordinator.metrics.job_status import JobStatus
from qdgrasp_tools.local import progress
from qdgrasp_tools.local.progress import LineProgress, LiveProgress

EVIL = "\x1b[2J"
FIGURES = figures(
    runs=1545, runs_done=1233, workers=256, evaluations=80_000, budget=100_000, remaining=20_000
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
    assert bar.endswith("80 %  about 3 min left")
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
