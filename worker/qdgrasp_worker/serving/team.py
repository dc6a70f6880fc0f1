"""A team: several workers of one command, started again when they die, and stopped together."""

import os
from contextlib import suppress
from queue import Empty, SimpleQueue
from time import monotonic

import structlog
import typer
from setproctitle import setproctitle

from qdgrasp_protocol.crew import GRACE, Crew, Death
from qdgrasp_protocol.errors import InputError
from qdgrasp_protocol.lifetime import Stop

log = structlog.get_logger()

LOOK_INTERVAL = 0.2  # seconds between two looks at the workers
MARGIN = 0.5  # seconds beyond their grace after which workers are killed
OUR_OWN = ("workers", "pin")
"""Options of the team, which its workers are not given."""


class Team:
    """Workers that are looked after.

    Parameters
    ----------
    size
        How many.
    arguments
        What each is started with.
    grace
        Seconds that each may take to stop.
    is_pinned
        Each is kept on a core of its own, as far as there are so many.
    """

    def __init__(self, size: int, arguments: list[str], grace: float, *, is_pinned: bool) -> None:
        self._size = size
        self._arguments = arguments
        self._grace = max(GRACE, grace + MARGIN)
        self._is_pinned = is_pinned
        self._there: set[str] = set()

    def run(self, stop: Stop) -> None:
        """Look after the workers until a signal comes, or all have left.

        Raises
        ------
        Exit
            A worker ended with a sentence that names bad input: so would all.
        """
        setproctitle("qdgrasp-workers")
        woken: SimpleQueue[None] = SimpleQueue()
        stop.tell(lambda: woken.put(None))
        with Crew(None, self._grace) as crew:
            self._hire(crew)
            while self._there and not stop.is_set:
                for death in crew.deaths():
                    self._died(crew, death)
                crew.restart_due(monotonic())
                with suppress(Empty):
                    woken.get(timeout=LOOK_INTERVAL)
            if stop.signal is not None:
                crew.dismiss(stop.signal)

    def _hire(self, crew: Crew) -> None:
        cores = sorted(os.sched_getaffinity(0))
        for number in range(self._size):
            name, core = f"worker-{number}", cores[number % len(cores)] if self._is_pinned else None
            crew.hire(name, "qdgrasp_worker.cli", self._arguments, core)
            self._there.add(name)

    def _died(self, crew: Crew, death: Death) -> None:
        if death.exit_code == InputError.exit_code:
            raise typer.Exit(death.exit_code)
        if death.exit_code == 0:
            self._there.discard(death.name)
            return
        pause = crew.restart_later(death.name, monotonic())
        log.warning(f"{death.name} {death.words}; it is started again in {pause:.1f} s")


def arguments(context: typer.Context) -> list[str]:
    """The options of a command as they were given, but for those that are the team's own."""
    given: list[str] = []
    for option in context.command.params:
        value = context.params.get(option.name or "")
        if option.name in OUR_OWN or value is None or value is False:
            continue
        given += [option.opts[0]] if value is True else [option.opts[0], str(value)]
    return given
