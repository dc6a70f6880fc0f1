"""The keys that are pressed at a terminal, one at a time, while somebody looks at it."""

import os
import select
import signal
import sys
import termios
import tty
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

from qdgrasp_protocol.lifetime import Stop

SEQUENCES = {
    b"\x1b[A": "up", b"\x1b[B": "down", b"\x1b[C": "right", b"\x1b[D": "left",
    b"\x1bOA": "up", b"\x1bOB": "down", b"\x1bOC": "right", b"\x1bOD": "left",
    b"\x1b[5~": "pageup", b"\x1b[6~": "pagedown", b"\x1b[Z": "backtab",
    b"\x1b[H": "home", b"\x1b[F": "end", b"\x1bOH": "home", b"\x1bOF": "end", b"\x1b[1~": "home",
    b"\x1b[4~": "end", b"\x1b": "escape", b"\t": "tab",
}  # fmt: skip
"""What terminals send for keys that are no characters."""
LONGEST = max(map(len, SEQUENCES))


def keys(data: bytes) -> list[str]:
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
    """Waits for keys, for another size of the terminal, and for the end of this process."""

    def __init__(self, stop: Stop, source: int | None) -> None:
        self._stop = stop
        self._source = source
        self._end, self._begin = os.pipe()
        os.set_blocking(self._begin, False)
        stop.tell(self.wake)

    def wake(self) -> None:
        """End the waiting; may be called by a signal's handler."""
        os.write(self._begin, b"!")

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
        return keys(data)


@contextmanager
def keyboard(stop: Stop) -> Iterator[Keyboard]:
    """Hear each key at once and show none; where standard input is no terminal there are none."""
    source = sys.stdin.fileno() if sys.stdin is not None and sys.stdin.isatty() else None
    before = None if source is None else termios.tcgetattr(source)
    heard = Keyboard(stop, source)

    def resized(_number: int, _frame: FrameType | None) -> None:
        heard.wake()

    previous = signal.signal(signal.SIGWINCH, resized)
    try:
        if source is not None:
            tty.setcbreak(source)
        yield heard
    finally:
        signal.signal(signal.SIGWINCH, previous)
        if source is not None:
            termios.tcsetattr(source, termios.TCSADRAIN, before or [])
