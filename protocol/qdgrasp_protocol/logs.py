"""How a process speaks: sentences with fields on standard error; a person reads one, a machine the other."""

import logging
import os
import sys
from contextlib import suppress
from typing import TextIO, cast

import structlog

STANDARD_ERROR = 2


class Voice:
    """Standard error without a buffer; what is said on a full disk is lost, and nobody dies of it."""

    def write(self, text: str) -> None:
        """Say it now or never."""
        with suppress(OSError):
            os.write(STANDARD_ERROR, text.encode(errors="replace"))

    def flush(self) -> None:
        """Nothing waits."""


def speak(role: str, *, level: int = logging.INFO) -> None:
    """Send this process's log to standard error, each line marked with its role."""
    structlog.configure(
        processors=[
            structlog.contextvars.merge_contextvars,
            structlog.processors.add_log_level,
            structlog.processors.TimeStamper(fmt="%H:%M:%S", utc=False),
            structlog.dev.ConsoleRenderer(colors=sys.stderr.isatty(), pad_event_to=0),
        ],
        wrapper_class=structlog.make_filtering_bound_logger(level),
        logger_factory=structlog.PrintLoggerFactory(file=cast(TextIO, Voice())),
    )
    structlog.contextvars.bind_contextvars(role=role)
