"""Golden texts of the bus: every message with the bytes of an example, and every key.

Examples are made from the schema, and stand under the name that travels, not under that of the class.
"""

import inspect
from collections.abc import Iterator
from datetime import UTC, datetime
from itertools import count
from re import fullmatch
from typing import Any

import msgspec
from msgspec.inspect import type_info

from qdgrasp_coordinator.metrics.job_status import (
    JobEvent,
    JobEvents,
    JobMeta,
    JobStatus,
    RunListings,
    RunStatus,
    WorkersPage,
    to_json,
)
from qdgrasp_coordinator.metrics.run_stats import GrowthCurve
from qdgrasp_protocol import messages
from qdgrasp_protocol.keys import AnyJob, Keys
from qdgrasp_protocol.messages import Heartbeat, Message

SHOWN = {
    "stat/worker/<wid>": Heartbeat,
    "stat/job": JobStatus,
    "stat/run/<run>": RunStatus,
    "stat/team/<page>": WorkersPage,
    "stat/curve/<run>": GrowthCurve,
    "event/<kind>": JobEvent,
    "event/recent": JobEvents,
    "meta": JobMeta,
    "rec/runs": RunListings,
}
"""What is JSON, by the key that it travels on."""
WORDS = ("words", "run", "0123456789abcdef" * 2, "0123456789abcdef" * 4)
"""What stands in fields that are text: the first that the field's pattern takes."""
CHUNK = "0123456789abcdef" * 2


def message_text() -> str:
    """Each message by its encoding, and its example in hexadecimal digits."""
    return "".join(
        f'"{messages.encoding(kind)}" = "{messages.encode(example(kind)).hex()}"\n' for kind in kinds()
    )


def shown_text() -> str:
    """Each struct that is shown by its key, and its example as JSON."""
    return "".join(f"{key}\n    {to_json(example(kind)).decode()}\n" for key, kind in SHOWN.items())


def key_text() -> str:
    """The keys of a job, and the patterns over all jobs; with and without optional arguments."""
    return "\n".join(sorted({*_keys(Keys("mugs")), *_keys(AnyJob())})) + "\n"


def kinds() -> list[type[Message]]:
    """All messages in the order of their encodings."""
    found = [kind for kind in vars(messages).values() if isinstance(kind, type)]
    return sorted({kind for kind in found if issubclass(kind, Message)} - {Message}, key=messages.encoding)


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


def _keys(keys: Keys) -> Iterator[str]:
    """Every key that there is a method or a property for."""
    for name in dir(keys):
        if not name.startswith("_"):
            found = getattr(keys, name)
            yield from _built(found) if callable(found) else [found]


def _built(method: Any) -> Iterator[str]:
    (parameter,) = inspect.signature(method).parameters.values()
    yield method(7 if "int" in str(parameter.annotation) else CHUNK)
    if parameter.default is not parameter.empty:
        yield method()
