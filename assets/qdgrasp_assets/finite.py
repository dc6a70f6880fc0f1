"""Numbers in what a file says: TOML knows nan and inf, and no hand has them."""

import math
from collections.abc import Iterator
from typing import Any

import msgspec
from msgspec import Struct


def endless(said: Struct) -> Iterator[str]:
    """Each number that is none, or infinite: "joints.finger.open must be a finite number, got nan"."""
    for name, number in _numbers("", msgspec.to_builtins(said)):
        if not math.isfinite(number):
            yield f"{name} must be a finite number, got {number:g}"


def _numbers(name: str, value: Any) -> Iterator[tuple[str, float]]:
    """The numbers within a value, by the keys that lead to them; those of a list go by its name."""
    match value:
        case float():
            yield name, value
        case dict():
            for key, inner in value.items():
                yield from _numbers(f"{name}.{key}" if name else str(key), inner)
        case list() | tuple():
            for inner in value:
                yield from _numbers(name, inner)
