"""How long a process lives: until its work is done, a signal comes, or whoever started it is gone.

A service waits on an inbox; stopping puts one more thing into it. So no loop polls for signals, and a
process ends within the time that its present piece of work takes.
"""

import os
import signal
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType

from setproctitle import setproctitle

SUPERVISED = "QDGRASP_SUPERVISED"
"""Set for a process that lives only as long as the process at the other end of its standard input."""
HEARD = (signal.SIGINT, signal.SIGTERM)
KNOCK_INTERVAL = 0.1  # seconds in which the main thread hears a signal, as a rule
ORPHAN_GRACE = 3.0  # seconds that an orphan may take to end by itself


class Stop:
    """Whether this process is asked to stop, and by what."""

    def __init__(self) -> None:
        self.signal: int | None = None
        self.latest: int | None = None
        """The last signal of several; the first decides the exit code."""
        self._told: list[Callable[[], None]] = []

    @property
    def is_set(self) -> bool:
        """A signal asked this process to stop."""
        return self.signal is not None

    @property
    def exit_code(self) -> int:
        """0, or 128 plus the signal that ended the process: 130 for Ctrl-C, 143 for SIGTERM."""
        return 0 if self.signal is None else 128 + self.signal

    def tell(self, callback: Callable[[], None]) -> None:
        """Call `callback` when the process is asked to stop. It runs in a signal handler: put and return."""
        self._told.append(callback)

    def set(self, number: int, _frame: FrameType | None = None) -> None:
        """Ask this process to stop; the first reason stays."""
        self.latest = number
        if self.signal is None:
            self.signal = number
        for callback in self._told:
            callback()


@contextmanager
def lifetime(title: str) -> Iterator[Stop]:
    """Name this process for `ps`, and turn SIGINT, SIGTERM and the end of its starter into a `Stop`."""
    setproctitle(title)
    stop = Stop()
    notes = signal.set_wakeup_fd(begin := _knocking(stop), warn_on_full_buffer=False)
    before = {number: signal.signal(number, stop.set) for number in HEARD}
    if os.environ.pop(SUPERVISED, None):
        threading.Thread(target=_outlive_no_starter, name="starter", daemon=True).start()
    try:
        yield stop
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
        signal.set_wakeup_fd(notes)
        os.close(begin)


def _knocking(stop: Stop) -> int:
    """Start a thread that takes the kernel's notes of signals; gives where they are to be written."""
    end, begin = os.pipe()
    os.set_blocking(begin, False)
    threading.Thread(target=_knock, args=(end, stop), name="signals", daemon=True).start()
    return begin


def _knock(end: int, stop: Stop) -> None:
    """Send a signal again until it is heard: one that comes right before a wait in C wakes nobody."""
    main = threading.main_thread().ident or 0
    while note := os.read(end, 1):
        while note[0] in HEARD and not stop.is_set:
            time.sleep(KNOCK_INTERVAL)
            if not stop.is_set:
                signal.pthread_kill(main, note[0])
    os.close(end)


def _outlive_no_starter() -> None:
    """End this process once nobody holds the other end of its standard input."""
    while os.read(0, 1024):
        pass
    os.kill(os.getpid(), signal.SIGTERM)
    time.sleep(ORPHAN_GRACE)  # what is left after it hangs in a call that never returns
    os._exit(128 + signal.SIGTERM)
