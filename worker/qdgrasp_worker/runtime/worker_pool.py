"""Worker pool: several workers of one command, restarted when they die, stopped together."""

import os
from contextlib import suppress
from queue import Empty, SimpleQueue
from time import monotonic

import structlog
import typer
from setproctitle import setproctitle

from qdgrasp_protocol.errors import InputError
from qdgrasp_protocol.process import Stop
from qdgrasp_protocol.supervisor import GRACE, GRACE_MARGIN, DiesAgain, ProcessExit, ProcessSupervisor

log = structlog.get_logger()

LOOK_INTERVAL = 0.2  # seconds between two looks at the workers
STEADY_SECONDS = 60.0  # seconds of life after which a worker's deaths count anew
POOL_OPTIONS = ("workers", "pin")  # Options of the pool, which its workers are not given


class WorkerPool:
    """Several workers with the same arguments, restarted when they die.

    Each may take `grace` seconds to stop; if pinned, each is kept on a core of its own, as far as there are
    enough. A worker is given up that left by itself, that bad input ended at its first start, as it would at
    any other, or that dies again and again.
    """

    def __init__(self, size: int, arguments: list[str], *, grace: float, is_pinned: bool) -> None:
        self._size = size
        self._arguments = arguments
        self._grace = max(GRACE, grace + GRACE_MARGIN)
        self._is_pinned = is_pinned
        self._served: set[str] = set()  # Workers that were started a second time
        self._running: set[str] = set()
        self.exit_code = 0
        """Exit code of the worker that was given up last."""

    def run(self, stop: Stop) -> None:
        """Start the workers and watch them until a signal comes, or all are given up."""
        setproctitle("qdgrasp-workers")
        woken: SimpleQueue[None] = SimpleQueue()
        stop.tell(lambda: woken.put(None))
        with ProcessSupervisor(None, self._grace, STEADY_SECONDS) as processes:
            self._start(processes)
            while self._running and not stop.is_set:
                for death in processes.exits():
                    self.on_death(processes, death, monotonic())
                processes.restart_due(monotonic())
                with suppress(Empty):
                    woken.get(timeout=LOOK_INTERVAL)
            passed_on = None  # Signal that the workers were sent last: SIGINT may follow on SIGTERM
            while stop.is_set and processes.pids() and not processes.is_late(monotonic()):
                if stop.latest is not None and stop.latest != passed_on:
                    passed_on = stop.latest
                    processes.request_stop(passed_on)
                with suppress(Empty):
                    woken.get(timeout=LOOK_INTERVAL)

    def _start(self, processes: ProcessSupervisor) -> None:
        cores = sorted(os.sched_getaffinity(0))
        for number in range(self._size):
            name, core = f"worker-{number}", cores[number % len(cores)] if self._is_pinned else None
            processes.start(name, "qdgrasp_worker.cli", self._arguments, core)
            self._running.add(name)

    def on_death(self, processes: ProcessSupervisor, death: ProcessExit, now: float) -> None:
        """Plan the next start of a worker that died, or give it up."""
        is_hopeless = death.exit_code == InputError.exit_code and death.name not in self._served
        if death.exit_code == 0 or is_hopeless:
            self._give_up(death)
            return
        self._served.add(death.name)
        try:
            pause = processes.restart_later(death, now)
        except DiesAgain as error:
            log.error(f"{error} It is not started again.")
            self._give_up(death)
        else:
            log.warning(f"{death.name} {death.description}; it is started again in {pause:.1f} s")

    def _give_up(self, death: ProcessExit) -> None:
        self._running.discard(death.name)
        self.exit_code = death.exit_code if death.exit_code >= 0 else 1


def worker_arguments(context: typer.Context) -> list[str]:
    """The options of a command as they were given, without the pool's own."""
    given: list[str] = []
    for option in context.command.params:
        value = context.params.get(option.name or "")
        if option.name in POOL_OPTIONS or value is None or value is False:
            continue
        given += [option.opts[0]] if value is True else [option.opts[0], str(value)]
    return given
