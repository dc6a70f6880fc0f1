"""Choosing grasps: good enough, the best, and well spread ones."""

import numpy as np
from numpy.typing import NDArray

from qdgrasp_assets.rotation import Floats, multiply
from qdgrasp_assets.scene import SceneGripper
from qdgrasp_coordinator.counts.order import best_first
from qdgrasp_coordinator.exchange.frames import COM
from qdgrasp_coordinator.exchange.grasps import Grasps
from qdgrasp_protocol.errors import ImpossibleValue


def choose(
    grasps: Grasps, min_fitness: float = 1, top: int | None = None, diverse: int | None = None
) -> Grasps:
    """Some of the grasps: first those that are good enough, of these the best, of these well spread ones.

    Parameters
    ----------
    min_fitness
        Shakes survived in the nominal evaluation, at least: 0, 1 or 2. 0 takes all successes.
    top
        So many at most, best first (`order.best_first`: by eta where it is known, then by fitness).
    diverse
        So many at most, each as far as can be from those before it (`spread`), the best one first.

    Returns
    -------
    chosen
        In journal order, unless `top` or `diverse` is given.

    Raises
    ------
    ImpossibleValue
        A number is none of the kind.
    """
    _check_number("min_fitness", min_fitness, whole=False)
    for name, value in (("top", top), ("diverse", diverse)):
        if value is not None:
            _check_number(name, value, whole=True)
    chosen = grasps[grasps.is_success & (grasps.fitness >= min_fitness)]
    if top is None and diverse is None:
        return chosen
    chosen = chosen[best_first(chosen.rows, chosen.eta)[:top]]
    return chosen if diverse is None else chosen[spread(chosen, diverse)]


def _check_number(name: str, value: object, *, whole: bool) -> None:
    kinds = (int, np.integer) if whole else (int, float, np.integer, np.floating)
    if isinstance(value, bool) or not isinstance(value, kinds) or not 0 <= value < np.inf:
        raise ImpossibleValue(name, value, f"{'an integer' if whole else 'a number'} not less than 0")


def spread(grasps: Grasps, most: int) -> NDArray[np.int64]:
    """The places (m,) of at most `most` well-spread grasps: the first, then ever the farthest from those.

    The distance of two hands is the root of the sum of two squares: how far their root links are apart, and
    how far a point at the hand's reach from its root link moves when the one hand is turned as the other,
    2 reach sin(angle / 2). A jaw turned by 180 degrees about its approach axis is the same jaw. Of equally
    far ones the first is taken (Gonzalez 1985, "Clustering to minimize the maximum intercluster distance").
    """
    poses, hand = grasps.poses(COM), grasps.scene.gripper
    nearest = np.full(len(poses), np.inf)
    chosen: list[int] = []
    while len(chosen) < min(most, len(poses)):
        place = int(np.argmax(nearest)) if chosen else 0
        chosen.append(place)
        nearest = np.minimum(nearest, _squares(poses, poses[place], hand))
        nearest[place] = -1.0
    return np.array(chosen, dtype=np.int64)


def _squares(poses: Floats, other: Floats, hand: SceneGripper) -> Floats:
    """The squared distances (n,) [m2] of poses (n, 7) from another one (7,)."""
    apart, cosine = poses[:, :3] - other[:3], _alike(poses[:, 3:], other[3:])
    if hand.jaw:
        half = np.array([*hand.approach_axis, 0.0])  # the quaternion of 180 degrees
        cosine = np.maximum(cosine, _alike(poses[:, 3:], multiply(other[None, 3:], half[None])[0]))
    x, y, z = apart.T
    squares: Floats = x * x + y * y + z * z + 4.0 * hand.reach**2 * (1.0 - np.minimum(cosine, 1.0) ** 2)
    return squares


def _alike(quaternions: Floats, other: Floats) -> Floats:
    """The cosine (n,) of half the angle between rotations (n, 4) and another one (4,)."""
    x, y, z, w = quaternions.T
    cosine: Floats = np.abs(x * other[0] + y * other[1] + z * other[2] + w * other[3])
    return cosine
