"""How a process speaks: sentences with fields on standard error; a person reads one, a machine the other."""

import logging
import os
import sys
from contextlib import suppress
from traceback import TracebackException
from typing import TextIO, cast

import structlog
from structlog.typing import EventDict, ExcInfo

from qdgrasp_protocol.printable import printable

STANDARD_ERROR = 2


class Voice:
    """Standard error without a buffer; what is said on a full disk is lost, and nobody dies of it."""

    def write(self, text: str) -> None:
        """Say it now or never."""
        with suppress(OSError):
            os.write(STANDARD_ERROR, text.encode(errors="replace"))

    def flush(self) -> None:
        """Nothing waits."""


def escape(_logger: object, _method: str, event: EventDict) -> EventDict:
    """Escape what others wrote; values that are no strings are shown by their `repr`, which does so too."""
    return {name: printable(value) if isinstance(value, str) else value for name, value in event.items()}


def traceback(sink: TextIO, error: ExcInfo) -> None:
    """Write a traceback without the values of variables, and with what others wrote escaped."""
    for piece in TracebackException(*error).format():
        is_frame = piece.startswith("  ")  # some lines of code; anything else is a sentence
        for line in piece.rstrip().split("\n") if is_frame else [piece.strip()]:
            sink.write(f"\n{printable(line)}")


def speak(role: str, *, level: int = logging.INFO) -> None:
    """Send this process's log to standard error, each line marked with its role."""
    structlog.configure(
        processors=[
            structlog.contextvars.merge_contextvars,
            structlog.processors.add_log_level,
            structlog.processors.TimeStamper(fmt="%H:%M:%S", utc=False),
            escape,
            structlog.dev.ConsoleRenderer(
                colors=sys.stderr.isatty(), pad_event_to=0, exception_formatter=traceback
            ),
        ],
        wrapper_class=structlog.make_filtering_bound_logger(level),
        logger_factory=structlog.PrintLoggerFactory(file=cast(TextIO, Voice())),
    )
    structlog.contextvars.bind_contextvars(role=role)
