"""Messages of every kind: made from the schema, or with the values that most tests want."""

from collections.abc import Iterator, Sequence
from datetime import UTC, datetime
from itertools import count
from re import fullmatch
from typing import Any

import msgspec
from msgspec.inspect import type_info

from qdgrasp_protocol import build_messages, messages
from qdgrasp_protocol.bus import Bus, Channel
from qdgrasp_protocol.messages import VERSION, Join, Message, OpenRun, Result, worker_id

KINDS = sorted(
    (
        kind
        for kind in {**vars(messages), **vars(build_messages)}.values()
        if isinstance(kind, type) and issubclass(kind, Message) and kind is not Message
    ),
    key=messages.encoding,
)
"""All messages in the order of their encodings."""
WORDS = ("words", "run", "0123456789abcdef" * 2, "0123456789abcdef" * 4)
"""Values of text fields: the first that a field's pattern takes."""
KEYS_BY_ID: dict[str, bytes] = {}
"""The keys of the workers that tests make, by the ids that are made of them."""


def made_id(number: int) -> str:
    """The id of a worker with the key of this number."""
    key = number.to_bytes(32)
    KEYS_BY_ID[worker_id(key)] = key
    return worker_id(key)


ANN, BOB, EVE, FAY = (
    next(wid for wid in map(made_id, count()) if wid.startswith(letter)) for letter in "abef"
)
"""Workers, in the order of their ids."""
HERE = {"pybullet": "3.2.7"}
"""The platform of workers."""


def put(bus: Bus, key: str, message: Message, channel: Channel = Channel.DATA) -> None:
    bus.put(key, messages.encode(message), encoding=messages.encoding(type(message)), channel=channel)


def join_message(
    wid: str, number: int = 1, credit: int = 2, held: Sequence[bytes] = (), **values: Any
) -> Join:
    common = {"versions": [VERSION], "host": "node7", "pid": 9, "platform": HERE}
    common["key"] = KEYS_BY_ID.get(wid, bytes(32))
    return Join(**common | {"wid": wid, "number": number, "credit": credit, "held": list(held)} | values)


def result_message(**values: Any) -> Result:
    common = {"epoch": 1, "run": "run", "generation": 0, "batch": bytes(16), "attempt": 1, "wid": "0" * 32}
    sizes = {"n": 1, "joints": 1, "columns": {}, "cpu_seconds": 0.0}
    key = KEYS_BY_ID.get(str(values.get("wid")), b"")
    return Result(**common | sizes | {"key": key} | values)


def open_run(**values: Any) -> OpenRun:
    common = {"run": "run", "spec": b"", "scene": "0" * 64, "genes": 7, "joints": 2}
    return OpenRun(**common | values)


def example(kind: type[msgspec.Struct]) -> Any:
    """A struct with a value in every field, none of them the default; the same every time."""
    return _value(type_info(kind), count(1))


def _value(kind: msgspec.inspect.Type, numbers: Iterator[int]) -> Any:
    match kind:
        case msgspec.inspect.Metadata(type=inner):
            return _value(inner, numbers)
        case msgspec.inspect.IntType(le=most):
            return next(numbers) if most is None else min(next(numbers), most)
        case msgspec.inspect.FloatType():
            return next(numbers) + 0.5
        case msgspec.inspect.BoolType():
            return True
        case msgspec.inspect.StrType(pattern=pattern):
            return next(text for text in WORDS if pattern is None or fullmatch(pattern, text))
        case msgspec.inspect.LiteralType(values=values):
            return values[0]
        case msgspec.inspect.BytesType(min_length=least):
            return bytes(range(next(numbers), next(numbers) + (least or 3)))
        case msgspec.inspect.DateTimeType():
            return datetime(2026, 11, 22, 13, 2, next(numbers), tzinfo=UTC)
        case msgspec.inspect.ListType(item_type=item):
            return [_value(item, numbers), _value(item, numbers)]
        case msgspec.inspect.TupleType(item_types=items):
            return tuple(_value(item, numbers) for item in items)
        case msgspec.inspect.VarTupleType(item_type=item):
            return (_value(item, numbers), _value(item, numbers))
        case msgspec.inspect.DictType(value_type=item):
            return {name: _value(item, numbers) for name in ("one", "two")}
        case msgspec.inspect.UnionType(types=types):
            return _value(next(one for one in types if one != msgspec.inspect.NoneType()), numbers)
        case msgspec.inspect.StructType(cls=cls, fields=fields):
            return cls(**{field.name: _field(field, numbers) for field in fields})
    raise AssertionError(f"no example of {kind}")


def _field(field: msgspec.inspect.Field, numbers: Iterator[int]) -> Any:
    """A value of a field that is not its default."""
    value = _value(field.type, numbers)
    return not field.default if field.default is value is True else value
