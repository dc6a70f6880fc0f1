"""Reads keys from a terminal, one at a time."""

import os
import re
import select
import signal
import sys
import termios
import tty
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from types import FrameType
from typing import Self

from qdgrasp_protocol.process import Stop

SEQUENCES = {
    b"\x1b[A": "up", b"\x1b[B": "down", b"\x1b[C": "right", b"\x1b[D": "left",
    b"\x1bOA": "up", b"\x1bOB": "down", b"\x1bOC": "right", b"\x1bOD": "left",
    b"\x1b[5~": "pageup", b"\x1b[6~": "pagedown", b"\x1b[Z": "backtab",
    b"\x1b[H": "home", b"\x1b[F": "end", b"\x1bOH": "home", b"\x1bOF": "end", b"\x1b[1~": "home",
    b"\x1b[4~": "end", b"\x1b": "escape", b"\t": "tab",
    b"\r": "enter", b"\n": "enter", b"\x7f": "backspace", b"\b": "backspace",
}  # fmt: skip
"""Bytes that terminals send for keys that are no characters."""
KEY = re.compile(b"|".join([*map(re.escape, sorted(SEQUENCES, key=len, reverse=True)), b"[ -~]"]))
"""One key: the longest sequence that fits, or a printable character."""


def parse_keys(data: bytes) -> list[str]:
    """Return the keys in the bytes from a terminal; unknown ones are left out."""
    return [SEQUENCES.get(key) or key.decode() for key in KEY.findall(data)]


class Keyboard:
    """Waits for keys, for a new size of the terminal, and for the end of this process.

    While its context lasts keys are read at once, without echo. Without a source there are no keys.
    """

    is_suspended = False  # Ctrl-Z was pressed: restore the terminal, then call `suspend`

    def __init__(self, stop: Stop, source: int | None) -> None:
        self._stop = stop
        self._source = source
        self._before = None if source is None else termios.tcgetattr(source)
        self._wake_end, self._wake_start = os.pipe()
        os.set_blocking(self._wake_start, False)
        stop.tell(self.wake)

    def __enter__(self) -> Self:
        if self._source is not None:
            tty.setcbreak(self._source)
        return self

    def __exit__(self, *_: object) -> None:
        if self._source is not None and self._before is not None:
            termios.tcsetattr(self._source, termios.TCSADRAIN, self._before)

    def wake(self) -> None:
        """End the waiting; may be called by a signal's handler."""
        with suppress(BlockingIOError):  # it is awake
            os.write(self._wake_start, b"!")

    def suspend(self) -> None:
        """Stop as Ctrl-Z asks, until the shell continues this process."""
        self.is_suspended = False
        self.__exit__()
        os.kill(0, signal.SIGSTOP)
        self.__enter__()

    def wait(self, seconds: float) -> list[str]:
        """Return the keys that were pressed; none after so many seconds, or after another event."""
        sources = [self._wake_end] if self._source is None else [self._wake_end, self._source]
        ready, _, _ = select.select(sources, [], [], 0.0 if self._stop.is_set else seconds)
        if self._wake_end in ready:
            os.read(self._wake_end, 64)
        if self._source not in ready or self._source is None:
            return []
        if not (data := os.read(self._source, 64)):
            self._source = None  # the terminal is gone
        return parse_keys(data)


@contextmanager
def keyboard(stop: Stop) -> Iterator[Keyboard]:
    """Open the keyboard of this terminal; without keys where standard input is no terminal."""
    source = sys.stdin.fileno() if sys.stdin is not None and sys.stdin.isatty() else None
    with Keyboard(stop, source) as keys:

        def handle(number: int, _frame: FrameType | None) -> None:
            keys.is_suspended |= number == signal.SIGTSTP
            keys.wake()

        before = {number: signal.signal(number, handle) for number in (signal.SIGWINCH, signal.SIGTSTP)}
        try:
            yield keys
        finally:
            for number, handler in before.items():
                signal.signal(number, handler)
