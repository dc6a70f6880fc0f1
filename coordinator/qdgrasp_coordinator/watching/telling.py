"""Telling what a command is at that takes its time: as it goes on on a terminal, elsewhere now and then."""

import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager

from rich.console import Console
from rich.progress import Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

from qdgrasp_assets.convex import Tell
from qdgrasp_coordinator.watching.progress import QUIET_INTERVAL
from qdgrasp_protocol.printable import printable


@contextmanager
def telling() -> Iterator[Tell]:
    """What hears a sentence whenever a command begins with something else; nothing is left on a terminal."""
    console = Console(stderr=True)
    if not console.is_terminal:
        with now_and_then(_print, QUIET_INTERVAL) as tell:
            yield tell
        return
    columns = SpinnerColumn(), TextColumn("{task.description}", markup=False), TimeElapsedColumn()
    with Progress(*columns, console=console, transient=True) as shown:
        task = shown.add_task("")
        yield lambda sentence: shown.update(task, description=printable(sentence))


@contextmanager
def now_and_then(say: Tell, interval: float) -> Iterator[Tell]:
    """What hears sentences, and has the latest said every `interval` seconds, with the time since it came."""
    latest, over = _Latest(), threading.Event()

    def speak() -> None:
        while not over.wait(interval):
            say(latest.words)

    thread = threading.Thread(target=speak, name="telling", daemon=True)
    thread.start()
    try:
        yield latest.hear
    finally:
        over.set()
        thread.join()


class _Latest:
    """The sentence that was heard last."""

    def __init__(self) -> None:
        self._heard = "starting", time.monotonic()

    def hear(self, sentence: str) -> None:
        """Hear one."""
        self._heard = printable(sentence), time.monotonic()

    @property
    def words(self) -> str:
        """It, and for how long that has been so."""
        sentence, since = self._heard
        return f"{sentence}, {time.monotonic() - since:.0f} s"


def _print(sentence: str) -> None:
    print(sentence, file=sys.stderr, flush=True)  # noqa: T201  # progress is what this prints
