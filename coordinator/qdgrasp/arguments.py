"""Arguments: what a program hands in, looked at before anything is started or written."""

import os
from collections.abc import Callable, Iterable
from math import inf
from pathlib import Path
from sys import maxsize
from typing import TypeVar

from qdgrasp_protocol.errors import ImpossibleValue, InputError

Made = TypeVar("Made")


def path_of(name: str, value: str | os.PathLike[str]) -> Path:
    """A path.

    Raises
    ------
    ImpossibleValue
        It is none.
    """
    try:
        return Path(value)
    except TypeError:
        raise ImpossibleValue(name, value, "a path") from None


def check_text(name: str, value: object) -> None:
    """Check a text that may be left out; raises ImpossibleValue where it is none, or empty."""
    if value is not None and not (isinstance(value, str) and value):
        raise ImpossibleValue(name, value, "text")


def check_whole(name: str, value: object, least: int, most: float = inf) -> None:
    """Check a whole number that may be left out; raises ImpossibleValue where it is none or out of bounds."""
    if value is not None and not (isinstance(value, int) and _is_within(value, least, most)):
        bounds = f"at least {least}" if most == inf else f"from {least} to {most}"
        raise ImpossibleValue(name, value, f"a whole number, {bounds}")


def check_seconds(name: str, value: object, least: float) -> None:
    """Check a time [s]; raises ImpossibleValue where it is none, or out of bounds."""
    if not (isinstance(value, int | float) and _is_within(value, least, maxsize)):
        raise ImpossibleValue(name, value, f"seconds, at least {least:g}")


def _is_within(value: float, least: float, most: float) -> bool:
    return not isinstance(value, bool) and least <= value <= most


def made_by(name: str, make: Callable[..., Made], of: object, verbs: Iterable[str]) -> Made:
    """What a program's function makes of something.

    Parameters
    ----------
    verbs
        The methods that what it makes must have.

    Raises
    ------
    InputError
        It is no function, or makes something else. What it raises itself goes through.
    """
    if not callable(make):
        raise ImpossibleValue(name, make, "a class or function that is called with the genes")
    made = make(of)
    if missing := [verb for verb in verbs if not callable(getattr(made, verb, None))]:
        raise InputError(f"What {name} makes, {made!r}, has no {' and no '.join(missing)}.")
    return made
