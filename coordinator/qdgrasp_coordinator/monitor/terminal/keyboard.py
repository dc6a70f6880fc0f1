"""Reads keys from a terminal, one at a time."""

import os
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
}  # fmt: skip
"""What terminals send for keys that are no characters."""
LONGEST = max(map(len, SEQUENCES))


def parse_keys(data: bytes) -> list[str]:
    """The keys in what a terminal sent; what is unknown is left out."""
    found: list[str] = []
    while data:
        sizes = [size for size in range(LONGEST, 0, -1) if data[:size] in SEQUENCES]
        if sizes:
            found.append(SEQUENCES[data[: sizes[0]]])
        elif 0x20 <= data[0] < 0x7F:
            found.append(chr(data[0]))
        data = data[sizes[0] if sizes else 1 :]
    return found


class Keyboard:
    """Waits for keys, for another size of the terminal, and for the end of this process.

    While its context lasts each key is heard at once, and none is shown.
    """

    is_to_rest = False
    """Ctrl-Z was pressed: the terminal is to be left as it was, and `rest` to be called."""

    def __init__(self, stop: Stop, source: int | None) -> None:
        self._stop = stop
        self._source = source
        self._before = None if source is None else termios.tcgetattr(source)
        self._end, self._begin = os.pipe()
        os.set_blocking(self._begin, False)
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
            os.write(self._begin, b"!")

    def rest(self) -> None:
        """Stand still as Ctrl-Z asks, until the shell lets this process go on."""
        self.is_to_rest = False
        self.__exit__()
        os.kill(0, signal.SIGSTOP)
        self.__enter__()

    def wait(self, seconds: float) -> list[str]:
        """The keys that were pressed; none after so many seconds, or when something else happened."""
        heard = [self._end] if self._source is None else [self._end, self._source]
        ready, _, _ = select.select(heard, [], [], 0.0 if self._stop.is_set else seconds)
        if self._end in ready:
            os.read(self._end, 64)
        if self._source not in ready or self._source is None:
            return []
        if not (data := os.read(self._source, 64)):
            self._source = None  # whoever sat there is gone
        return parse_keys(data)


@contextmanager
def keyboard(stop: Stop) -> Iterator[Keyboard]:
    """The keyboard of this terminal; where standard input is none there are no keys."""
    source = sys.stdin.fileno() if sys.stdin is not None and sys.stdin.isatty() else None
    with Keyboard(stop, source) as heard:

        def resized(_number: int, _frame: FrameType | None) -> None:
            heard.wake()

        def to_rest(_number: int, _frame: FrameType | None) -> None:
            heard.is_to_rest = True
            heard.wake()

        handlers = {signal.SIGWINCH: resized, signal.SIGTSTP: to_rest}
        before = {number: signal.signal(number, handler) for number, handler in handlers.items()}
        try:
            yield heard
        finally:
            for number, handler in before.items():
                signal.signal(number, handler)
