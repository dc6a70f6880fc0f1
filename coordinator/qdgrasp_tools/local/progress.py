"""Progress on standard error: a moving bar on a terminal, now and then a line elsewhere."""

import sys
import time
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from typing import Protocol

from rich.console import Console, RenderableType
from rich.progress import BarColumn, Progress, SpinnerColumn, TextColumn, TimeElapsedColumn
from rich.text import Text

from qdgrasp_assets.geometry.collision_parts import Tell
from qdgrasp_coordinator.metrics.job_status import JobStatus
from qdgrasp_protocol.text import printable

STARTING = "starting coordinator, recorder and workers"
QUIET_INTERVAL = 5.0  # seconds between lines where there is no terminal


class ProgressDisplay(Protocol):
    """Shows the figures of a job."""

    def show(self, figures: JobStatus) -> None:
        """Show how far the job is."""

    def say(self, sentence: str) -> None:
        """Say something that happened, in one line."""


class LiveProgress(Progress):
    """A bar on a terminal with a job's name and time left; all figures stand below it."""

    def __init__(self, console: Console, name: str, budget: int) -> None:
        said = TextColumn("{task.description}", markup=False)
        left = TextColumn("{task.percentage:.0f} %  {task.fields[left]}", markup=False)
        super().__init__(said, BarColumn(None), left, console=console, expand=True)
        self._job = self.add_task(printable(name), total=budget, words=STARTING, left="")

    def get_renderables(self) -> Iterable[RenderableType]:
        """Yield the bar, then the figures."""
        yield from super().get_renderables()
        for task in self.tasks:
            yield Text(task.fields["words"])

    def show(self, figures: JobStatus) -> None:
        """Move the bar on."""
        self.update(
            self._job,
            completed=figures.done,
            total=1.0,
            words=printable(figures.words),
            left=figures.left,
        )

    def say(self, sentence: str) -> None:
        """Print a line above the bar."""
        self.console.print(printable(sentence), highlight=False, markup=False)


class LineProgress:
    """A line every few seconds, for logs."""

    def __init__(self, name: str = "", after: float = 0.0) -> None:
        self._name = name
        self._next = time.monotonic() + after
        self._trouble = ""

    def show(self, figures: JobStatus) -> None:
        """Print a line if the last one is long enough ago, or if trouble came or went."""
        self._next = self._next if figures.obstacle == self._trouble else 0.0
        self._trouble = figures.obstacle
        self.tell(f"{self._name}: {figures.words}, {figures.left}")

    def tell(self, sentence: str) -> None:
        """Print a line if the last one is long enough ago."""
        if time.monotonic() >= self._next:
            self._next = time.monotonic() + QUIET_INTERVAL
            self.say(sentence)

    def say(self, sentence: str) -> None:
        """Print a line."""
        print(printable(sentence), file=sys.stderr, flush=True)  # noqa: T201  # progress is what this prints


@contextmanager
def progress_display(name: str, budget: int) -> Iterator[ProgressDisplay]:
    """Yield a bar if standard error is a terminal, else plain lines."""
    console = Console(stderr=True)
    if not console.is_terminal:
        yield LineProgress(name)
        return
    with LiveProgress(console, name, budget) as bar:
        yield bar


@contextmanager
def progress_messages() -> Iterator[Tell]:
    """Yield a function that shows what a command does; nothing is left on a terminal."""
    console = Console(stderr=True)
    if not console.is_terminal:
        yield LineProgress(after=QUIET_INTERVAL).tell
        return
    columns = SpinnerColumn(), TextColumn("{task.description}", markup=False), TimeElapsedColumn()
    with Progress(*columns, console=console, transient=True) as shown:
        task = shown.add_task("")
        yield lambda sentence: shown.update(task, description=printable(sentence))
