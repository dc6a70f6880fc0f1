"""The live progress of a job on standard error: a moving bar on a terminal, now and then a line elsewhere."""

import sys
import time
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from typing import Protocol

from rich.console import Console, RenderableType
from rich.progress import BarColumn, Progress, TextColumn
from rich.text import Text

from qdgrasp_coordinator.counts.figures import JobFigures
from qdgrasp_protocol.printable import printable

QUIET_INTERVAL = 5.0  # seconds between lines where nobody sees a moving one


class Display(Protocol):
    """Shows the figures of a job."""

    def show(self, figures: JobFigures) -> None:
        """Show how far the job is."""

    def say(self, sentence: str) -> None:
        """Say something that happened, in one line."""


class Bar(Progress):
    """A job's name, a bar and the time left; below them all figures, in as many lines as they need."""

    def __init__(self, console: Console) -> None:
        name = TextColumn("{task.description}", markup=False)
        left = TextColumn("{task.percentage:.0f} %  {task.fields[left]}", markup=False)
        super().__init__(name, BarColumn(None), left, console=console, expand=True)

    def get_renderables(self) -> Iterable[RenderableType]:
        """What stands on the terminal."""
        yield from super().get_renderables()
        for task in self.tasks:
            yield Text(task.fields["words"])


class LiveBar:
    """A moving bar on a terminal."""

    def __init__(self, bar: Bar, name: str, budget: int) -> None:
        self._bar = bar
        self._task = bar.add_task(name, total=budget, words="starting", left="")

    def show(self, figures: JobFigures) -> None:
        """Move the bar on."""
        self._bar.update(
            self._task,
            completed=figures.evaluations,
            total=max(1, figures.evaluations + figures.remaining),
            words=printable(figures.words),
            left=figures.left,
        )

    def say(self, sentence: str) -> None:
        """Print a line above the bar."""
        self._bar.console.print(sentence, highlight=False, markup=False)


class PlainLines:
    """A line every few seconds, for logs."""

    def __init__(self, name: str) -> None:
        self._name = name
        self._next = 0.0
        self._trouble = ""

    def show(self, figures: JobFigures) -> None:
        """Print a line if the last one is long enough ago, or if trouble came or went."""
        if time.monotonic() >= self._next or figures.obstacle != self._trouble:
            self._trouble = figures.obstacle
            self._next = time.monotonic() + QUIET_INTERVAL
            self.say(f"{self._name}: {printable(figures.words)}, {figures.left}")

    def say(self, sentence: str) -> None:
        """Print a line."""
        print(sentence, file=sys.stderr, flush=True)  # noqa: T201  # progress is what this prints


@contextmanager
def display(name: str, budget: int) -> Iterator[Display]:
    """The display that fits where standard error goes."""
    console = Console(stderr=True)
    if not console.is_terminal:
        yield PlainLines(name)
        return
    with Bar(console) as bar:
        yield LiveBar(bar, name, budget)
