"""Orientations: the 60 bins that the hand's rotations are counted in.

A rotation belongs to the nearest of the 60 that turn an icosahedron into itself. They lie in the rotations as
evenly as so many can: every bin is congruent to every other, a regular dodecahedron of unit quaternions. A
rotation is 29.5 degrees from the middle of its bin on average and 44.5 at most, and the middles of bins that
share a face are 72 degrees apart (Coxeter 1973, "Regular Polytopes": the 600-cell and its dual).
"""

from itertools import permutations, product

import numpy as np
from numpy.typing import ArrayLike, NDArray

from qdgrasp_assets.rotation import Floats, multiply, unit

BINS = 60
TURN = (-2.0, -2.0, -2.0, 3.0)
"""Turns the middles, so that the 24 rotations that put a hand's axes on those of the object are all at least
17 degrees from a border. Unturned, 12 of them lie where four bins meet, and rounding would spread them."""
GOLDEN = (1.0 + np.sqrt(5.0)) / 2.0


def orientations(quaternions: ArrayLike) -> NDArray[np.int64]:
    """The bin (n,), 0 to 59, of each rotation (n, 4), a quaternion xyzw; of bins equally near the first.

    Written out in products and sums of float64, so that it is the same on every machine.
    """
    x, y, z, w = np.asarray(quaternions, dtype=np.float64).T[..., None]
    a, b, c, d = MIDDLES.T
    nearest: NDArray[np.int64] = np.abs(x * a + y * b + z * c + w * d).argmax(axis=1)
    return nearest


def _icosahedral() -> Floats:
    """The rotations (60, 4) of an icosahedron; each of a quaternion and its negative the first."""
    axes = np.eye(4)
    halves = np.array(list(product((0.5, -0.5), repeat=4)))
    golden = np.array([(p * GOLDEN, q, r / GOLDEN, 0.0) for p, q, r in product((0.5, -0.5), repeat=3)])
    others = [golden[:, order] for order in permutations(range(4)) if _is_even(order)]
    vertices = np.concatenate([axes, -axes, halves, *others])
    leading = vertices[np.arange(len(vertices)), (vertices != 0).argmax(axis=1)]
    chosen: Floats = vertices[leading > 0]
    return chosen


def _is_even(order: tuple[int, ...]) -> bool:
    swaps = sum(first > second for i, first in enumerate(order) for second in order[i + 1 :])
    return swaps % 2 == 0


MIDDLES: Floats = multiply(_icosahedral(), np.broadcast_to(unit(np.array([TURN])), (BINS, 4)))
"""(60, 4): the middle of each bin."""
