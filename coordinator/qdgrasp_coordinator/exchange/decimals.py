"""Numbers as text that every reader takes for numbers."""

import numpy as np
from numpy.typing import NDArray

Words = list[list[str]]
"""Numbers of a table as text, line by line."""


def decimals(table: NDArray[np.floating]) -> Words:
    """The decimals of a table (n, k), line by line."""
    flat, width = shortest(table.ravel()), table.shape[1]
    return (
        [flat[start : start + width] for start in range(0, len(flat), width)] if width else [[]] * len(table)
    )


def shortest(numbers: NDArray[np.floating]) -> list[str]:
    """The shortest decimals that give back each of some numbers (n,), in their own precision.

    Always with a point and never with an exponent: `1e-05` is a word, not a number, to readers of YAML 1.1.
    """
    import pyarrow as pa  # several times as fast as numpy

    words: list[str] = pa.array(np.ascontiguousarray(numbers)).cast(pa.string()).to_pylist()
    return [word if "." in word and "e" not in word else _plain(word) for word in words]


def _plain(word: str) -> str:
    """The same of a word of Arrow's with an exponent, or without a point."""
    if "e" in word:
        return np.format_float_positional(float(word), trim="0")
    return f"{word}.0" if word[-1].isdecimal() else word  # nan and inf
