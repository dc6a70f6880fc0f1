"""Golden texts of the bus: every message with the bytes of an example, and every key.

Examples are made from the schema, and stand under the name that travels, not under that of the class.
"""

import inspect
from collections.abc import Iterator
from typing import Any

from tests.fakes.messages import KINDS, example

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
from qdgrasp_protocol import messages
from qdgrasp_protocol.keys import AnyJob, Keys
from qdgrasp_protocol.messages import Heartbeat

SHOWN = {
    "stat/worker/<wid>": Heartbeat,
    "stat/job": JobStatus,
    "stat/run/<run>": RunStatus,
    "stat/team/<page>": WorkersPage,
    "event/<kind>": JobEvent,
    "event/recent": JobEvents,
    "meta": JobMeta,
    "rec/runs": RunListings,
}
"""Structs that travel as JSON, by their keys."""
CHUNK = "0123456789abcdef" * 2


def message_text() -> str:
    """Each message by its encoding, and its example in hexadecimal digits."""
    return "".join(
        f'"{messages.encoding(kind)}" = "{messages.encode(example(kind)).hex()}"\n' for kind in KINDS
    )


def shown_text() -> str:
    """Each struct that is shown by its key, and its example as JSON."""
    return "".join(f"{key}\n    {to_json(example(kind)).decode()}\n" for key, kind in SHOWN.items())


def key_text() -> str:
    """The keys of a job, and the patterns over all jobs; with and without optional arguments."""
    return "\n".join(sorted({*_keys(Keys("mugs")), *_keys(AnyJob())})) + "\n"


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
