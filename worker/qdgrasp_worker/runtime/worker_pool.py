"""Worker pool: several workers of one command, restarted when they die, stopped together."""

import os
import signal
from contextlib import suppress
from queue import Empty, SimpleQueue
from time import monotonic

import structlog
import typer
from setproctitle import setproctitle

from qdgrasp_protocol.errors import InputError
from qdgrasp_protocol.process import GRACE, GRACE_MARGIN, ProcessExit, ProcessGroup, Stop

log = structlog.get_logger()

LOOK_INTERVAL = 0.2  # seconds between two looks at the workers
STARTUP_SECONDS = 60.0  # seconds in which a worker that reaches its router begins to serve
POOL_OPTIONS = ("workers", "pin")  # Options of the pool, which its workers are not given


class StartupCheck:
    """Decides whether bad input ends each of `size` workers at its first start. Pure.

    The first process of each has begun by `until` [s], of any steady clock.
    """

    def __init__(self, size: int, until: float) -> None:
        self._size = size
        self._until = until
        self._seen: set[str] = set()
        self._rejected: set[str] = set()

    def is_hopeless(self, ended: ProcessExit, now: float) -> bool:
        """Note that a worker ended; True once bad input has ended the first process of each."""
        is_first = ended.name not in self._seen
        self._seen.add(ended.name)
        if is_first and now <= self._until and ended.exit_code == InputError.exit_code:
            self._rejected.add(ended.name)
            return len(self._rejected) == self._size
        return False


class WorkerPool:
    """Several workers with the same arguments, restarted when they die.

    Each may take `grace` seconds to stop and waits `wait` seconds for the router; if pinned, each is kept on
    a core of its own, as far as there are enough.
    """

    def __init__(
        self, size: int, arguments: list[str], *, grace: float, wait: float, is_pinned: bool
    ) -> None:
        self._size = size
        self._arguments = arguments
        self._grace = max(GRACE, grace + GRACE_MARGIN)
        self._is_pinned = is_pinned
        self._running: set[str] = set()
        self._startup = StartupCheck(size, monotonic() + wait + STARTUP_SECONDS)

    def run(self, stop: Stop) -> None:
        """Start the workers and watch them until a signal comes, or all have left.

        An Exit if the first process of each ended by bad input, as any would.
        """
        setproctitle("qdgrasp-workers")
        woken: SimpleQueue[None] = SimpleQueue()
        stop.tell(lambda: woken.put(None))
        with ProcessGroup(None, self._grace) as group:
            self._start(group)
            while self._running and not stop.is_set:
                for ended in group.exits():
                    self._on_exit(group, ended, monotonic())
                group.restart_due(monotonic())
                with suppress(Empty):
                    woken.get(timeout=LOOK_INTERVAL)
            if stop.signal is not None:
                self._stop(group, stop, woken)

    def _start(self, group: ProcessGroup) -> None:
        cores = sorted(os.sched_getaffinity(0))
        for number in range(self._size):
            name, core = f"worker-{number}", cores[number % len(cores)] if self._is_pinned else None
            group.start(name, "qdgrasp_worker.cli", self._arguments, core)
            self._running.add(name)

    def _on_exit(self, group: ProcessGroup, ended: ProcessExit, now: float) -> None:
        if self._startup.is_hopeless(ended, now):
            raise typer.Exit(ended.exit_code)
        if ended.exit_code == 0:
            self._running.discard(ended.name)
            return
        pause = group.restart_later(ended.name, now)
        log.warning(f"{ended.name} {ended.description}; it is started again in {pause:.1f} s")

    def _stop(self, group: ProcessGroup, stop: Stop, woken: "SimpleQueue[None]") -> None:
        """Ask the workers to stop by the first signal, then by SIGINT if that comes; end the others."""
        passed_on = stop.signal or signal.SIGTERM
        group.request_stop(passed_on)
        kill_at = monotonic() + self._grace
        while (pids := group.pids()) and monotonic() < kill_at:
            if stop.latest == signal.SIGINT != passed_on:
                passed_on = signal.SIGINT
                for pid in pids.values():
                    os.kill(pid, passed_on)
            with suppress(Empty):
                woken.get(timeout=LOOK_INTERVAL)
        group.stop(passed_on)


def worker_arguments(context: typer.Context) -> list[str]:
    """The options of a command as they were given, without the pool's own."""
    given: list[str] = []
    for option in context.command.params:
        value = context.params.get(option.name or "")
        if option.name in POOL_OPTIONS or value is None or value is False:
            continue
        given += [option.opts[0]] if value is True else [option.opts[0], str(value)]
    return given
