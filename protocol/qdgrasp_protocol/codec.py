"""Messages to bytes and back: MessagePack with hard limits, then the schema.

Nothing recurses into, or prints, what has not passed both. The default limits of msgpack let one
megabyte of `0x90` become a million objects.
"""

from typing import TypeVar

import msgpack
import msgspec

from qdgrasp_protocol.errors import MessageError
from qdgrasp_protocol.messages import Message

M = TypeVar("M", bound=Message)

MAX_PAYLOAD = 16 << 20
"""The largest payload that is looked at [bytes]."""
LIMITS = {
    "max_array_len": 4096,
    "max_map_len": 32,
    "max_str_len": 256,
    "max_bin_len": 1 << 20,
    "max_ext_len": 0,
    "strict_map_key": True,
    "raw": False,
}


def encoding(kind: type[Message]) -> str:
    """The encoding that a message of this kind travels with."""
    return f"application/msgpack;qdgrasp.{kind.__name__.lower()}.v1"


def encode(message: Message) -> bytes:
    """A message as MessagePack."""
    return bytes(msgpack.packb(msgspec.to_builtins(message, builtin_types=(bytes,)), use_bin_type=True))


def decode(payload: bytes, kind: type[M]) -> M:
    """The message of `kind` in `payload`.

    Raises
    ------
    MessageError
        The payload is not MessagePack within the limits, or not of the schema.
    """
    if len(payload) > MAX_PAYLOAD:
        raise MessageError(f"{len(payload)} bytes are more than a message may have ({MAX_PAYLOAD})")
    try:
        values = msgpack.unpackb(payload, **LIMITS)
    except (ValueError, msgpack.UnpackException, RecursionError) as error:
        raise MessageError(f"not MessagePack within the limits: {type(error).__name__}") from None
    try:
        return msgspec.convert(values, kind)
    except msgspec.ValidationError as error:
        raise MessageError(f"not a {kind.__name__.lower()}: {error}") from None
