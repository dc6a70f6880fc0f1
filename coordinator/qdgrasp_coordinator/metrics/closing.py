"""Closing: the hand's poses before and after it, and how far the object moved in between.

The object is free while the hand closes, so the open hand stands in its commanded pose and the closed one in
its settled pose, both in the object's frame. Commanded pose and closed joints do not belong together.
"""

import numpy as np
from numpy.typing import NDArray

from qdgrasp_assets.geometry.rotation import Floats, conjugate, rotate

Evaluations = NDArray[np.void]
"""(n,), with the columns `base_to_object` and `settled`: rows, or finds of a journal."""
NOT_SETTLED = "where hands settled is not recorded: drawn as commanded"


def is_settled(found: Evaluations) -> NDArray[np.bool_]:
    """Flag evaluations whose settled pose is recorded (n,): successes, later than 0.1.0."""
    return np.asarray(found["settled"].any(axis=1))


def commanded_poses(found: Evaluations) -> Floats:
    """Return the hand's root link before closing (n, 7): x y z [m], qx qy qz qw, CoM frame."""
    return np.asarray(found["base_to_object"].astype(np.float64))


def settled_poses(found: Evaluations) -> Floats:
    """Return the hand's root link after closing (n, 7), CoM frame.

    Where it is not recorded it is the commanded one.
    """
    poses, settled = commanded_poses(found), is_settled(found)
    if settled.any():  # rows of version 0.1.0 have no room for it
        poses[settled] = found["settled"][settled]
    return poses


def motion(found: Evaluations) -> Floats:
    """Return how far the object moved in the hand while it closed [m], and turned [rad]: (n, 2).

    The way of its centre of mass. NaN where the settled pose is not recorded.
    """
    before, after = commanded_poses(found), settled_poses(found)
    ways = [rotate(conjugate(poses[:, 3:]), -poses[:, :3]) for poses in (before, after)]
    cosines = np.abs((before[:, 3:] * after[:, 3:]).sum(axis=1)).clip(0.0, 1.0)
    moved = np.column_stack([np.linalg.norm(ways[1] - ways[0], axis=1), 2.0 * np.arccos(cosines)])
    return np.where(is_settled(found)[:, None], moved, np.nan)
