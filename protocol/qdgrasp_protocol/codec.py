"""Messages to bytes and back: MessagePack with hard limits, then the schema.

Nothing recurses into, or prints, what has not passed both. The default limits of msgpack let one
megabyte of `0x90` become a million objects.
"""

from functools import cache
from typing import TYPE_CHECKING, Any, TypeVar

import msgpack
import msgspec

from qdgrasp_protocol.errors import MessageError
from qdgrasp_protocol.messages import Message
from qdgrasp_protocol.printable import printable

if TYPE_CHECKING:  # a simulator reads scenes, and has no bus
    from qdgrasp_protocol.bus import Sample

M = TypeVar("M", bound=Message)
C = TypeVar("C", list[Any], dict[str, Any])

MAX_PAYLOAD = 16 << 20
"""The largest payload that is looked at [bytes]."""
MAX_CONTAINERS = 8192
"""The most lists and maps in one message: a result with 4096 failures has half of them."""
MAX_REASON = 200
"""The most characters that a refusal repeats of what came."""
LIMITS = {
    "max_array_len": 4096,
    "max_map_len": 32,
    "max_str_len": 256,
    "max_bin_len": 1 << 20,
    "max_ext_len": 0,
    "strict_map_key": True,
    "raw": False,
}
MAX_BUNDLE = 128 << 20
"""The largest scene bundle that is fetched [bytes]; those of the built-in hands and objects have 0.2 MB."""
MAX_BUNDLE_CONTAINERS = 1 << 16
"""The most lists and maps in one; those have 50."""
BUNDLE_LIMITS = {
    "max_array_len": 1 << 16,
    "max_map_len": 256,
    "max_str_len": MAX_PAYLOAD,
    "max_bin_len": MAX_BUNDLE,
    "max_ext_len": 0,
}


@cache
def encoding(kind: type[Message]) -> str:
    """The encoding that a message of this kind travels with."""
    return f"application/msgpack;qdgrasp.{kind.wire_name}.v1"


def encode(message: Message) -> bytes:
    """A message as MessagePack."""
    return msgspec.msgpack.encode(message)


def decode(payload: bytes, kind: type[M]) -> M:
    """The message of `kind` in `payload`.

    Raises
    ------
    MessageError
        The payload is not MessagePack within the limits, or not of the schema.
    """
    if len(payload) > MAX_PAYLOAD:
        raise MessageError(f"{len(payload)} bytes are more than a message may have ({MAX_PAYLOAD})")
    values = _unfolded(payload, MAX_CONTAINERS, LIMITS)
    try:
        return msgspec.convert(values, kind, builtin_types=(bytes,))  # not base64 text in place of bytes
    except msgspec.ValidationError as error:
        raise MessageError(f"not a {kind.wire_name}: {printable(str(error), MAX_REASON)}") from None


def decoded(sample: "Sample", kind: type[M]) -> M:
    """The message of `kind` in a sample.

    Raises
    ------
    MessageError
        It is said to be of another encoding, which is not even looked at, or is no such message.
    """
    if sample.encoding != encoding(kind):
        raise MessageError(f"expected {encoding(kind)}, got {printable(sample.encoding, MAX_REASON)}")
    return decode(sample.payload, kind)


def check_bundle(payload: bytes) -> None:
    """See that the bytes of a scene are MessagePack that does not unfold without end.

    Raises
    ------
    MessageError
        They are not.
    """
    _unfolded(payload, MAX_BUNDLE_CONTAINERS, BUNDLE_LIMITS)


def _unfolded(payload: bytes, containers: int, limits: dict[str, Any]) -> Any:
    """The values in a payload that has at most so many lists and maps."""
    count = _Budget(containers).count
    try:
        return msgpack.unpackb(payload, list_hook=count, object_hook=count, **limits)
    except (ValueError, msgpack.UnpackException) as error:
        raise MessageError(f"not MessagePack within the limits: {type(error).__name__}") from None


class _Budget:
    """How many lists and maps a payload may still unfold to."""

    def __init__(self, left: int) -> None:
        self._left = left

    def count(self, container: C) -> C:
        self._left -= 1
        if self._left < 0:
            raise ValueError("too many lists and maps")
        return container
