"""A TCP proxy that imitates a long link: every byte arrives later, and some wait for a second sending."""

import socket
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from queue import SimpleQueue
from random import Random

from tests.common import HOST

RESENT_AFTER = 1.0  # seconds: the first time-out of TCP (RFC 6298)
PIECE = 1 << 16


class SlowLink:
    """A link to a port on loopback whose round trip takes so many seconds; a part of its pieces is lost once.

    Pieces after a lost one wait for it, as in a TCP stream. A connection costs a round trip too.
    """

    def __init__(self, port: int, round_trip: float, loss: float = 0.0, seed: int = 0) -> None:
        self._target = (HOST, port)
        self._one_way = round_trip / 2
        self._loss = loss
        self._draws = Random(seed)  # noqa: S311  # no secret
        self._server = socket.create_server((HOST, 0))
        self.port: int = self._server.getsockname()[1]
        self._open: list[socket.socket] = []
        self.connections = 0
        """How many have been opened through it."""

    def cut(self) -> None:
        """Cut every connection; new ones are taken."""
        while self._open:
            with suppress(OSError):
                self._open.pop().shutdown(socket.SHUT_RDWR)

    def serve(self) -> None:
        """Take connections until the link is closed."""
        with suppress(OSError):
            while True:
                near, _ = self._server.accept()
                try:
                    far = socket.create_connection(self._target)
                except ConnectionRefusedError:
                    near.close()
                    continue
                self.connections += 1
                self._open += [near, far]
                self._relay(near, far, 2 * self._one_way)  # its SYN is answered at once
                self._relay(far, near, 0.0)

    def close(self) -> None:
        """Close the link."""
        self._server.shutdown(socket.SHUT_RDWR)
        self._server.close()
        self.cut()

    def _relay(self, source: socket.socket, sink: socket.socket, first: float) -> None:
        """Carry bytes one way; the first ones are held back longer."""
        pieces: SimpleQueue[tuple[float, bytes]] = SimpleQueue()

        def read() -> None:
            free = time.monotonic() + first
            with suppress(OSError):
                while piece := source.recv(PIECE):
                    lost = RESENT_AFTER if self._draws.random() < self._loss else 0.0
                    free = max(free, time.monotonic()) + lost
                    pieces.put((free + self._one_way, piece))
            pieces.put((free, b""))

        def write() -> None:
            with suppress(OSError), sink:
                while (due := pieces.get()) and due[1]:
                    time.sleep(max(0.0, due[0] - time.monotonic()))
                    sink.sendall(due[1])
                sink.shutdown(socket.SHUT_RDWR)

        for carry in (read, write):
            threading.Thread(target=carry, daemon=True).start()


@contextmanager
def slow_link(port: int, round_trip: float, loss: float = 0.0, seed: int = 0) -> Iterator[SlowLink]:
    """Open a link to a port on loopback, and close it at the end."""
    link = SlowLink(port, round_trip, loss, seed)
    thread = threading.Thread(target=link.serve, daemon=True)
    thread.start()
    try:
        yield link
    finally:
        link.close()
        thread.join()
