"""A simulator as its worker has it: a process that can be spoken to, heard, and killed."""

import signal
import socket
import subprocess
import threading
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from queue import SimpleQueue
from typing import Self

from qdgrasp_protocol.errors import MessageError
from qdgrasp_worker.serving import frames
from qdgrasp_worker.serving.frames import Frame, Said
from qdgrasp_worker.serving.limits import CLOCK_OVER, STALL, TIME_OVER
from qdgrasp_worker.serving.line import Line
from qdgrasp_worker.serving.vitals import Vitals, vitals

STANDARD_ERROR = 2
KILLED_FROM_OUTSIDE = (signal.SIGKILL, signal.SIGTERM, signal.SIGINT, signal.SIGHUP)
"""What ends a simulator without a word on what it was at."""


@dataclass(frozen=True)
class Heard:
    """A simulator said something."""

    simulator: "Simulator"
    frame: Said


@dataclass(frozen=True)
class Ended:
    """A simulator ended; nothing more is heard of it."""

    simulator: "Simulator"
    code: int
    """Its exit code; negative: the signal that killed it."""


News = Heard | Ended


class Simulator:
    """A simulator's process, with a thread that reads and one that writes: no call here waits for it.

    Parameters
    ----------
    command
        What is started, with the line as its standard input.
    hear
        Called from the reading thread.
    """

    def __init__(self, command: Sequence[str], settings: Frame, hear: Callable[[News], None]) -> None:
        ours, its = socket.socketpair()
        with its:
            self._process = subprocess.Popen(
                command, stdin=its.fileno(), stdout=STANDARD_ERROR, start_new_session=True
            )
        self._line = Line(ours)
        self._hear = hear
        self._outbox: SimpleQueue[Frame | None] = SimpleQueue()
        self.say(settings)
        for work in (self._read, self._write):
            threading.Thread(target=work, name="simulator", daemon=True).start()

    def say(self, frame: Frame) -> None:
        """Say something; it is heard when the simulator has done all that was said before."""
        self._outbox.put(frame)

    @property
    def pid(self) -> int:
        """The id of its process."""
        return self._process.pid

    @property
    def vitals(self) -> Vitals:
        """What it takes of the processor and the memory."""
        return vitals(self.pid)

    def stop(self) -> None:
        """End it for having said nothing for too long; its end is heard as any other."""
        self._process.send_signal(CLOCK_OVER)

    def close(self) -> None:
        """End it at once, whatever it is at; closing twice is allowed."""
        self._process.kill()
        self._process.wait()
        self._outbox.put(None)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _read(self) -> None:
        try:
            while (data := self._line.receive()) is not None:
                self._hear(Heard(self, frames.decode(data)))
        except MessageError:  # its memory is not what it was
            self._process.kill()
        self._hear(Ended(self, self._process.wait()))
        self._outbox.put(None)

    def _write(self) -> None:
        while (frame := self._outbox.get()) is not None:
            try:
                self._line.send(frames.encode(frame))
            except OSError:  # it ended; the reading thread tells
                break
        self._line.close()


def evidence(code: int, row_seconds: float) -> str | None:
    """Why a simulator ended, where that speaks against what it was at; None: it was killed from outside."""
    if code > 0:
        return f"the simulator ended with exit code {code}"
    if -code == TIME_OVER:
        return f"the simulator took more than {row_seconds:g} CPU seconds"
    if -code == CLOCK_OVER:
        return f"the simulator said nothing for {STALL * row_seconds:g} s"
    if code == 0 or -code in KILLED_FROM_OUTSIDE:
        return None
    return f"the simulator was ended by {signal.Signals(-code).name}"
