"""Numbers as text that every reader takes for numbers."""

import numpy as np
from numpy.typing import NDArray

Words = list[list[str]]
"""Numbers of a table as text, line by line."""


def decimals(table: NDArray[np.floating]) -> Words:
    """The shortest decimals that give back each number of a table (n, k), in its own precision.

    Always with a point and never with an exponent: `1e-05` is a word, not a number, to readers of YAML 1.1.
    """
    flat = [_plain(word) for word in table.ravel().astype(str).tolist()]
    width = table.shape[1]
    return (
        [flat[start : start + width] for start in range(0, len(flat), width)] if width else [[]] * len(table)
    )


def _plain(word: str) -> str:
    return word if "e" not in word else np.format_float_positional(float(word), trim="0")
