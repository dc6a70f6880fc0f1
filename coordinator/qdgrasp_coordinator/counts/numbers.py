"""Arrays of numbers that others give: of the right kind and shape, or refused in words."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from qdgrasp_protocol.errors import ImpossibleValue, InputError

REAL = "fiu"
"""Kinds of arrays that hold real numbers."""


def numbers(name: str, values: ArrayLike, shape: tuple[int | str, ...]) -> NDArray[np.float64]:
    """Real numbers of a shape; NaN and infinity are some.

    Parameters
    ----------
    name
        What is given, for errors.
    shape
        A length for each axis, or a letter where any will do: ("n", 3).

    Raises
    ------
    InputError
        They are no real numbers, or of another shape.
    """
    expected = "numbers of shape ({}{})".format(", ".join(map(str, shape)), "," * (len(shape) == 1))
    try:
        array = np.asarray(values)
    except (TypeError, ValueError, OverflowError) as error:
        raise InputError(f"{name} must be {expected}; {error}.") from None
    if array.dtype.kind not in REAL:
        raise InputError(f"{name} must be {expected}, and its type is {array.dtype}.")
    if not _fits(array.shape, shape):
        raise ImpossibleValue(name, array.shape, expected)
    return array.astype(np.float64)


def finite(name: str, values: ArrayLike, shape: tuple[int | str, ...]) -> NDArray[np.float64]:
    """The same without NaN and infinity."""
    array = numbers(name, values, shape)
    if not np.isfinite(array).all():
        raise InputError(f"{name} holds a number that is not finite.")
    return array


def _fits(came: tuple[int, ...], wanted: tuple[int | str, ...]) -> bool:
    return len(came) == len(wanted) and all(
        isinstance(length, str) or length == n for n, length in zip(came, wanted, strict=True)
    )
