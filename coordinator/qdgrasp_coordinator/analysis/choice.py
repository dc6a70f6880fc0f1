"""Which grasps a picture shows: the best, far from one another, and not between the object and the eye."""

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from qdgrasp_coordinator.analysis.rays import Camera
from qdgrasp_protocol.outcome import Outcome
from qdgrasp_protocol.rows import Rows

MOST = 8
"""Grasps in one picture."""
CANDIDATES = 4000
"""Grasps looked at; of more, evenly many are left out."""
APART = 0.035
"""Hands are drawn at least this far apart on the image [m], so that each can be told from the others."""
FACING = 0.3
"""A hand whose approach makes a smaller angle with the line of sight than arccos of this hides the object."""


def well_spread(rows: Rows, axis: NDArray[np.floating], camera: Camera) -> Rows:
    """At most `MOST` rows, robust ones where there are any, else grasps, else successes.

    Parameters
    ----------
    rows
        Successes.
    axis
        (3,): the gripper's approach axis, base frame.
    camera
        Where they are seen from.
    """
    best = _best(rows)
    if not len(best):
        return best
    pose = best["base_to_object"].astype(np.float64)
    turned = Rotation.from_quat(pose[:, 3:])
    approach = turned.apply(axis)
    aside = np.flatnonzero(-(approach @ camera.axes[2]) < FACING)
    aside = aside if len(aside) else np.arange(len(best))
    chosen = _farthest(camera.seen(pose[aside, :3]), camera.seen(approach[aside]))
    return best[aside[chosen]]


def _best(rows: Rows) -> Rows:
    for least in (Outcome.HELD, Outcome.SHAKEN, Outcome.DROPPED):
        best = rows[rows["outcome"] >= least]
        if len(best):
            return best[:: -(-len(best) // CANDIDATES)]
    return rows[:0]


def _farthest(positions: NDArray[np.floating], approaches: NDArray[np.floating]) -> list[int]:
    """Places of hands: the outermost first, then ever the one that is farthest from those chosen."""
    features = np.hstack([positions[:, :2], 0.5 * APART * approaches])
    chosen = [int(np.argmax(np.linalg.norm(positions[:, :2], axis=1)))]
    nearest = np.linalg.norm(features - features[chosen[0]], axis=1)
    while len(chosen) < MOST and nearest.max() > APART:
        chosen.append(int(np.argmax(nearest)))
        nearest = np.minimum(nearest, np.linalg.norm(features - features[chosen[-1]], axis=1))
    return chosen
