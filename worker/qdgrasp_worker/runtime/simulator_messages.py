"""Messages between a worker and its simulator, and the socket that carries them.

Frozen structs in MessagePack, each behind its length, over a pair of sockets. Answers come in the order of
the questions, so that neither carries a number.
"""

import socket
import struct
from contextlib import suppress
from typing import TypeAlias

import msgspec
from msgspec import Struct

from qdgrasp_protocol.errors import MessageError
from qdgrasp_protocol.messages import Failure

LENGTH_HEADER = struct.Struct("<I")
MAX_FRAME_SIZE = 1 << 30  # The longest frame [bytes]; a greater length is an error


class SimulatorMessage(Struct, frozen=True, kw_only=True, tag=True, forbid_unknown_fields=True):
    """The root of all messages."""


class SimulatorSettings(SimulatorMessage, frozen=True, kw_only=True):
    """Worker to simulator, first of all: its limits."""

    row_seconds: float
    """CPU seconds that a row, or a slice of rows, may take."""
    memory: int
    """Memory that it may allocate [bytes]."""
    nice: int
    """Niceness of its process, 0 to 19."""


class EvaluateRows(SimulatorMessage, frozen=True, kw_only=True):
    """Worker to simulator: evaluate rows of a batch."""

    scene: str
    """The digest of the scene."""
    bundle: bytes | None
    """The scene, unless the simulator has it."""
    prior: str
    n: int
    genes: int
    columns: dict[str, bytes]
    """`index`, `trial` and `genome`."""
    is_careful: bool
    """Each row is evaluated by itself, and its result sent before the next begins."""


class SimulatorReady(SimulatorMessage, frozen=True, kw_only=True):
    """Simulator to worker: it has evaluated the probes."""

    platform: dict[str, str]


class SceneLoaded(SimulatorMessage, frozen=True, kw_only=True):
    """Simulator to worker: the scene that came with the batch is loaded."""


class PartialResult(SimulatorMessage, frozen=True, kw_only=True):
    """Simulator to worker: the results of the next rows of the batch."""

    n: int
    joints: int = 0
    descriptors: int = 0
    contact_slots: int = 0
    columns: dict[str, bytes] = {}
    """All of `rows.RESULT`; rows named in `failures` hold zeros."""
    failures: list[Failure] = []
    """Failures by the place of the row in this part."""
    cpu_seconds: float = 0.0


class BatchRejected(SimulatorMessage, frozen=True, kw_only=True):
    """Simulator to worker: no row of the batch can be evaluated, with the reason."""

    reason: str


class SceneMissing(SimulatorMessage, frozen=True, kw_only=True):
    """Simulator to worker: it does not have the scene; send the batch again, with it."""


class SimulatorCrashed(SimulatorMessage, frozen=True, kw_only=True):
    """Simulator to worker: it raised this error, and ends."""

    reason: str


AnySimulatorMessage: TypeAlias = (
    SimulatorSettings
    | EvaluateRows
    | SimulatorReady
    | SceneLoaded
    | PartialResult
    | BatchRejected
    | SceneMissing
    | SimulatorCrashed
)
_ENCODER = msgspec.msgpack.Encoder()
_DECODER: msgspec.msgpack.Decoder[AnySimulatorMessage] = msgspec.msgpack.Decoder(AnySimulatorMessage)


class FramedSocket:
    """One end of a stream socket, whose messages follow their lengths."""

    def __init__(self, end: socket.socket) -> None:
        self._end = end

    def send(self, message: SimulatorMessage) -> None:
        """Send a message, waiting while the other side is behind; an OSError if that is closed."""
        frame = _ENCODER.encode(message)
        self._end.sendall(LENGTH_HEADER.pack(len(frame)))
        self._end.sendall(frame)

    def receive(self) -> AnySimulatorMessage | None:
        """The next message; None where the socket is closed, a MessageError if it is not one."""
        head = self._read(LENGTH_HEADER.size)
        if head is None:
            return None
        (length,) = LENGTH_HEADER.unpack(head)
        if length > MAX_FRAME_SIZE:
            raise MessageError(f"a frame of {length} bytes, and at most {MAX_FRAME_SIZE} are read")
        frame = self._read(length)
        try:
            return None if frame is None else _DECODER.decode(frame)
        except msgspec.MsgspecError as error:
            raise MessageError(f"not a frame: {str(error)!a}") from None

    def close(self) -> None:
        """Close the socket, for both sides; closing twice is allowed."""
        with suppress(OSError):
            self._end.shutdown(socket.SHUT_RDWR)
        self._end.close()

    def _read(self, length: int) -> bytes | None:
        buffer = bytearray(length)
        view, have = memoryview(buffer), 0
        with suppress(OSError):
            while have < length and (came := self._end.recv_into(view[have:])):
                have += came
        return bytes(buffer) if have == length else None
