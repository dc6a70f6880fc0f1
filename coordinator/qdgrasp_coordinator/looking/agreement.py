"""Agreement: whether what is evaluated again is what was recorded, bit for bit, and what differs in words."""

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from qdgrasp_coordinator.folders import platforms
from qdgrasp_protocol.outcome import Outcome
from qdgrasp_protocol.replay import Answer
from qdgrasp_protocol.rows import RESULT, Rows

UNKNOWN = "On which platform it was recorded is not known."
SAME = "It was recorded on this very platform, on which it must be the same: please report it."


def differing(recorded: Rows, now: Rows) -> dict[str, NDArray[np.bool_]]:
    """For each result column which rows (n,) differ in any bit.

    Parameters
    ----------
    recorded, now
        (n,) of one shape, with the same keys.
    """
    return {column.name: _unlike(recorded[column.name], now[column.name]) for column in RESULT}


def _unlike(one: NDArray[np.generic], other: NDArray[np.generic]) -> NDArray[np.bool_]:
    first, second = (
        np.ascontiguousarray(values).reshape(len(values), -1).view(np.uint8) for values in (one, other)
    )
    unlike: NDArray[np.bool_] = (first != second).any(axis=1)
    return unlike


def replayed(row: np.void, answer: Answer) -> np.void:
    """A row with what its replay found in place of what is recorded."""
    now = row.copy()
    for name in ("outcome", "fitness", "joints", "contacts", "penetration"):
        now[name] = getattr(answer, name)
    return now


def words(recorded: np.void, now: np.void) -> list[str]:
    """What differs, column by column."""
    unlike = differing(recorded.reshape(1), now.reshape(1))
    return [
        f"{name} {told(now, name)} instead of {told(recorded, name)}" for name in unlike if unlike[name][0]
    ]


def told(row: np.void, column: str) -> str:
    """A column of a row as a person reads it, to the last bit."""
    value = row[column]
    if column == "outcome":
        return Outcome(value).name.lower() if value in set(Outcome) else str(value)
    return " ".join(str(number) for number in np.atleast_1d(value))


def compared(recorded: Mapping[str, str], now: Mapping[str, str]) -> str:
    """How two platforms differ, in a sentence."""
    if not recorded:
        return UNKNOWN
    if not (differing := platforms.differences(recorded, now)):
        return SAME
    return f"It was recorded on another platform; here is {differing}."
