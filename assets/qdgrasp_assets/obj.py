"""OBJ files: their corners and triangles, group by group; materials, normals and texture are left aside.

Groups are those that the simulator makes a hull of each; a material begins none.
"""

import re
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
START = re.compile(r"[ \t]*[og][ \t]")
"""What begins another group, for Bullet's reader too: a word that stands alone on its line does not."""


@dataclass(frozen=True)
class Obj:
    """What an OBJ file holds."""

    vertices: Floats
    """(v, 3), those of all groups."""
    groups: tuple[NDArray[np.int64], ...]
    """(f, 3) each: indices of vertices, in the order of the file; groups without triangles are left out."""


def read_obj(text: str) -> Obj:
    """Read an OBJ file; faces of more than three corners become fans of triangles.

    Raises
    ------
    ValueError, IndexError
        It is none.
    """
    vertices: list[list[float]] = []
    groups: list[list[tuple[int, int, int]]] = [[]]
    for line in text.splitlines():
        word, *values = line.split() or [""]
        if word == "v":
            vertices.append([float(value) for value in values[:3]])
        elif word == "f":
            groups[-1] += _fan([_index(value, len(vertices)) for value in values])
        elif START.match(line):
            groups.append([])
    return Obj(np.array(vertices).reshape(-1, 3), tuple(np.array(group) for group in groups if group))


def _index(value: str, known: int) -> int:
    """The vertex that a corner such as `7/1/3` names; negative numbers count from the last one known."""
    number = int(value.split("/")[0])
    return number - 1 if number > 0 else known + number


def _fan(corners: list[int]) -> Iterator[tuple[int, int, int]]:
    first, *rest = corners
    return ((first, a, b) for a, b in pairwise(rest))
