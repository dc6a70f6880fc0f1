"""The line between a worker and its simulator: frames over a pair of sockets, each behind its length."""

import socket
import struct
from contextlib import suppress

HEAD = struct.Struct("<I")
MOST = 1 << 30
"""The longest frame [bytes]; a length above it is not one of ours."""


class Line:
    """One end of the line.

    Parameters
    ----------
    end
        A connected stream socket.
    """

    def __init__(self, end: socket.socket) -> None:
        self._end = end

    def send(self, frame: bytes) -> None:
        """Send a frame; waits while the other side is behind.

        Raises
        ------
        OSError
            Nobody is at the other end.
        """
        self._end.sendall(HEAD.pack(len(frame)))
        self._end.sendall(frame)

    def receive(self) -> bytes | None:
        """The next frame; None where the line ended, or carries something else than frames."""
        head = self._read(HEAD.size)
        if head is None:
            return None
        (length,) = HEAD.unpack(head)
        return self._read(length) if length <= MOST else None

    def close(self) -> None:
        """End the line, for both sides; closing twice is allowed."""
        with suppress(OSError):
            self._end.shutdown(socket.SHUT_RDWR)
        self._end.close()

    def _read(self, length: int) -> bytes | None:
        buffer = bytearray(length)
        view, have = memoryview(buffer), 0
        while have < length:
            try:
                came = self._end.recv_into(view[have:])
            except OSError:
                return None
            if not came:
                return None
            have += came
        return bytes(buffer)
