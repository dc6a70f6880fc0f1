"""What a worker and its simulator say to each other: frozen structs, in MessagePack.

Answers come in the order of the questions, so that neither carries a number.
"""

from typing import TypeAlias

import msgspec
from msgspec import Struct

from qdgrasp_protocol.errors import MessageError
from qdgrasp_protocol.messages import Failure


class Frame(Struct, frozen=True, kw_only=True, tag=True, forbid_unknown_fields=True):
    """The root of all frames."""


class Settings(Frame, frozen=True, kw_only=True):
    """Worker to simulator, first of all: within which limits it works."""

    row_seconds: float
    """The CPU seconds that a row, or a slice of rows, may take."""
    memory: int
    """The memory that it may ask for [bytes]."""
    nice: int
    """How far it stands back behind other processes, 0 to 19."""


class Evaluate(Frame, frozen=True, kw_only=True):
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
    """Whether each row is evaluated by itself, and told before the next begins."""


class Ready(Frame, frozen=True, kw_only=True):
    """Simulator to worker: it has evaluated the probes."""

    platform: dict[str, str]


class Begun(Frame, frozen=True, kw_only=True):
    """Simulator to worker: the scene that came with the batch stands."""


class Part(Frame, frozen=True, kw_only=True):
    """Simulator to worker: the results of the next rows of the batch."""

    n: int
    joints: int = 0
    descriptors: int = 0
    columns: dict[str, bytes] = {}
    """All of `rows.RESULT`; rows named in `failures` hold zeros."""
    failures: list[Failure] = []
    """By the place of the row in this part."""
    cpu_seconds: float = 0.0


class Unfit(Frame, frozen=True, kw_only=True):
    """Simulator to worker: no row of the batch can be evaluated, and why."""

    reason: str


class Lacking(Frame, frozen=True, kw_only=True):
    """Simulator to worker: it does not have the scene, or no longer; send the batch again, with it."""


class Broken(Frame, frozen=True, kw_only=True):
    """Simulator to worker: it raised this, and ends."""

    reason: str


Said: TypeAlias = Settings | Evaluate | Ready | Begun | Part | Unfit | Lacking | Broken
_ENCODER = msgspec.msgpack.Encoder()
_DECODER: msgspec.msgpack.Decoder[Said] = msgspec.msgpack.Decoder(Said)


def encode(frame: Frame) -> bytes:
    """A frame as bytes."""
    return _ENCODER.encode(frame)


def decode(data: bytes) -> Said:
    """The frame in `data`.

    Raises
    ------
    MessageError
        There is none in it.
    """
    try:
        return _DECODER.decode(data)
    except msgspec.MsgspecError as error:
        raise MessageError(f"not a frame: {str(error)!a}") from None
