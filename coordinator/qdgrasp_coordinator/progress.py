"""The live progress of a job on standard error: a moving line on a terminal, now and then one elsewhere."""

import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Protocol

from rich.console import Console
from rich.progress import BarColumn, Progress, ProgressColumn, Task, TextColumn, TimeRemainingColumn
from rich.text import Text

from qdgrasp_coordinator.figures import JobFigures

QUIET_INTERVAL = 5.0  # seconds between lines where nobody sees a moving one


class Display(Protocol):
    """Shows the figures of a job."""

    def show(self, figures: JobFigures) -> None:
        """Show how far the job is."""

    def say(self, sentence: str) -> None:
        """Say something that happened, in one line."""


class FiguresColumn(ProgressColumn):
    """Evaluations, speed, successes and cells in words."""

    def render(self, task: Task) -> Text:
        """The column's text for a task that holds `figures`."""
        figures: JobFigures | None = task.fields.get("figures")
        return Text("starting" if figures is None else figures.words)


class LiveLine:
    """One moving line on a terminal."""

    def __init__(self, progress: Progress, name: str, budget: int) -> None:
        self._progress = progress
        self._task = progress.add_task(name, total=budget, figures=None)

    def show(self, figures: JobFigures) -> None:
        """Move the line on."""
        self._progress.update(
            self._task, completed=figures.evaluations, total=figures.budget, figures=figures
        )

    def say(self, sentence: str) -> None:
        """Print a line above the moving one."""
        self._progress.console.print(sentence, highlight=False)


class PlainLines:
    """A line every few seconds, for logs."""

    def __init__(self, name: str) -> None:
        self._name = name
        self._next = 0.0
        self._trouble = ""

    def show(self, figures: JobFigures) -> None:
        """Print a line if the last one is long enough ago, or if trouble came or went."""
        if time.monotonic() >= self._next or figures.trouble != self._trouble:
            self._trouble = figures.trouble
            self._next = time.monotonic() + QUIET_INTERVAL
            self.say(f"{self._name}: {figures.words}, {figures.left}")

    def say(self, sentence: str) -> None:
        """Print a line."""
        print(sentence, file=sys.stderr, flush=True)  # noqa: T201 - progress is what this prints


@contextmanager
def display(name: str, budget: int) -> Iterator[Display]:
    """The display that fits where standard error goes."""
    console = Console(stderr=True)
    if not console.is_terminal:
        yield PlainLines(name)
        return
    columns = (TextColumn("{task.description}"), BarColumn(24), FiguresColumn(), TimeRemainingColumn())
    with Progress(*columns, console=console) as progress:
        yield LiveLine(progress, name, budget)
