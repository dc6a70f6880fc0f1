"""A process of this package: its end, and its log. Those that it starts are in `supervisor`.

A process lives until its work is done, a signal comes, or its parent process is gone. A service waits on an
inbox; stopping puts one more event into it. So no loop polls for signals, and a process ends within the time
that its present piece of work takes.

Logs are sentences with fields on standard error; a person reads the sentence, a machine the fields.
"""

import logging
import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from traceback import TracebackException
from types import FrameType
from typing import TextIO, cast

import structlog
from setproctitle import setproctitle
from structlog.typing import EventDict, ExcInfo

from qdgrasp_protocol.text import printable, printable_lines

SUPERVISED = "QDGRASP_SUPERVISED"
"""Set for a process that ends when its standard input is closed by its parent process."""
ONE_THREAD = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
"""Environment that limits each process to one thread."""
STOP_SIGNALS = (signal.SIGINT, signal.SIGTERM)
SIGNAL_REPEAT_INTERVAL = 0.1  # seconds in which the main thread hears a signal, as a rule
ORPHAN_GRACE = 3.0  # seconds that an orphan may take to end by itself


class Stop:
    """Request to stop this process, with its signal."""

    def __init__(self) -> None:
        self.signal: int | None = None
        self.latest: int | None = None  # Last signal of several; the first decides the exit code
        self._told: list[Callable[[], None]] = []

    @property
    def is_set(self) -> bool:
        """True once this process was asked to stop."""
        return self.signal is not None

    @property
    def exit_code(self) -> int:
        """0, or 128 plus the signal that ended the process: 130 for Ctrl-C, 143 for SIGTERM."""
        return 0 if self.signal is None else 128 + self.signal

    def tell(self, callback: Callable[[], None]) -> None:
        """Register `callback` for the stop request; runs in a signal handler: put and return."""
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
    """Set the process title, and turn SIGINT, SIGTERM and the parent's end into a `Stop`.

    Blanks in the title become dashes: Slurm 22.05, which reads names in /proc up to the first blank, does not
    find a process with one, nor signal it.
    """
    setproctitle(title.replace(" ", "-"))
    stop = Stop()
    end, begin = os.pipe()
    os.set_blocking(begin, False)
    threading.Thread(target=_repeat_signal, args=(end, stop), name="signals", daemon=True).start()
    notes = signal.set_wakeup_fd(begin, warn_on_full_buffer=False)
    before = {number: signal.signal(number, stop.set) for number in STOP_SIGNALS}
    if os.environ.pop(SUPERVISED, None):
        threading.Thread(target=_end_with_parent, name="starter", daemon=True).start()
    try:
        yield stop
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
        signal.set_wakeup_fd(notes)
        os.close(begin)


def _repeat_signal(end: int, stop: Stop) -> None:
    """Repeat a signal until it is handled: one right before a wait in C would be lost."""
    main = threading.main_thread().ident or 0
    while note := os.read(end, 1):
        while note[0] in STOP_SIGNALS and not stop.is_set:
            time.sleep(SIGNAL_REPEAT_INTERVAL)
            if not stop.is_set:
                signal.pthread_kill(main, note[0])
    os.close(end)


def _end_with_parent() -> None:
    """End this process once the other end of its standard input is closed."""
    while os.read(0, 1024):
        pass
    os.kill(os.getpid(), signal.SIGTERM)
    time.sleep(ORPHAN_GRACE)  # what is left after it hangs in a call that never returns
    os._exit(128 + signal.SIGTERM)


STANDARD_ERROR = 2


class UnbufferedStderr:
    """Standard error without a buffer; write errors, as on a full disk, are ignored."""

    def write(self, text: str) -> None:
        """Write text at once."""
        with suppress(OSError):
            os.write(STANDARD_ERROR, text.encode(errors="replace"))

    def flush(self) -> None:
        """Do nothing: no text waits."""


def escape_event(_logger: object, _method: str, event: EventDict) -> EventDict:
    """Escape untrusted text; values that are not strings are shown by `repr`, which escapes too."""
    return {name: printable(value) if isinstance(value, str) else value for name, value in event.items()}


def write_traceback(sink: TextIO, error: ExcInfo) -> None:
    """Write a traceback without the values of variables, and with untrusted text escaped."""
    for piece in TracebackException(*error).format():
        is_frame = piece.startswith("  ")  # some lines of code; anything else is a sentence
        for line in piece.rstrip().split("\n") if is_frame else [piece.strip()]:
            sink.write(f"\n{printable(line)}")


class LogFormatter(logging.Formatter):
    """Formats the records of libraries, with untrusted text escaped."""

    def format(self, record: logging.LogRecord) -> str:
        """Return the lines of a record."""
        return printable_lines(super().format(record))


def configure_logging(role: str, *, level: int = logging.INFO) -> None:
    """Send this process's log to standard error, each line marked with its role."""
    structlog.configure(
        processors=[
            structlog.contextvars.merge_contextvars,
            structlog.processors.add_log_level,
            structlog.processors.TimeStamper(fmt="%H:%M:%S", utc=False),
            escape_event,
            structlog.dev.ConsoleRenderer(
                colors=sys.stderr.isatty(), pad_event_to=0, exception_formatter=write_traceback
            ),
        ],
        wrapper_class=structlog.make_filtering_bound_logger(level),
        logger_factory=structlog.PrintLoggerFactory(file=cast(TextIO, UnbufferedStderr())),
    )
    structlog.contextvars.bind_contextvars(role=role)
    if logging.lastResort is not None:  # it prints what no handler takes
        logging.lastResort.setFormatter(LogFormatter())
