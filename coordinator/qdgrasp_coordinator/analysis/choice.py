"""What a picture shows: from which side, and which grasps.

The object from its broad side, and its best grasps, far from one another and not between object and eye.
"""

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation

from qdgrasp_assets.mesh import Mesh
from qdgrasp_assets.scene import SceneGripper
from qdgrasp_coordinator.analysis.rays import Camera, camera
from qdgrasp_protocol.outcome import Outcome
from qdgrasp_protocol.rows import Rows

MOST, LEAST = 8, 3
"""Grasps in one picture: many of a jaw, few of a hand."""
LINKS = 24
"""Finger links in one picture, at which it is still clear."""
CANDIDATES = 4000
"""Grasps looked at; of more, evenly many are left out."""
APART = 0.035
"""Hands are drawn at least this far apart on the image [m], so that each can be told from the others."""
FACING = 0.3
"""A hand whose approach makes a smaller angle with the line of sight than arccos of this hides the object."""
SIDES = np.radians(np.arange(-165, 180, 30))
"""Azimuths that are tried."""
BROAD = 0.97
"""A side counts as broad when the object's outline fills this share of its largest one."""


def best_side(thing: Mesh, rows: Rows, gripper: SceneGripper, elevation: float) -> float:
    """The azimuth [rad] that shows most of the object, and of these the one that shows grasps farthest apart.

    Parameters
    ----------
    thing
        The object.
    rows, gripper
        As in `well_spread`.
    elevation
        How high the camera stands [rad].
    """
    views = [camera(thing.vertices, azimuth, elevation, 100, 100) for azimuth in SIDES]
    outlines = np.array([ConvexHull(view.seen(thing.vertices)[:, :2]).volume for view in views])
    broad = np.flatnonzero(outlines > BROAD * outlines.max())
    seen = [_spread(well_spread(rows, gripper, views[side]), gripper, views[side]) for side in broad]
    return float(SIDES[broad[int(np.argmax(seen))]])


def _spread(chosen: Rows, gripper: SceneGripper, view: Camera) -> float:
    """How far each hand is from the next one on the image [m], in sum; hands seen from aside count most."""
    if len(chosen) < 2:
        return 0.0
    positions, approaches = (view.seen(vectors) for vectors in _placed(chosen, gripper))
    gaps = np.linalg.norm(positions[:, None, :2] - positions[None, :, :2], axis=2)
    return float(np.sort(gaps, axis=1)[:, 1] @ np.linalg.norm(approaches[:, :2], axis=1))


def well_spread(rows: Rows, gripper: SceneGripper, camera: Camera) -> Rows:
    """A few rows: robust ones where there are any, else grasps, else successes.

    Parameters
    ----------
    rows
        Successes.
    gripper
        The hand.
    camera
        Where they are seen from.
    """
    best = _best(rows)
    if not len(best):
        return best
    positions, approaches = (camera.seen(vectors) for vectors in _placed(best, gripper))
    aside = np.flatnonzero(-approaches[:, 2] < FACING)
    aside = aside if len(aside) else np.arange(len(best))
    most = int(np.clip(LINKS // len(gripper.finger_links), LEAST, MOST))
    return best[aside[_farthest(positions[aside], approaches[aside], most)]]


def _placed(rows: Rows, gripper: SceneGripper) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Where hands stand (n, 3) [m] and where their approach axes point (n, 3), CoM frame."""
    pose = rows["base_to_object"].astype(np.float64)
    return pose[:, :3], Rotation.from_quat(pose[:, 3:]).apply(gripper.approach_axis)


def _best(rows: Rows) -> Rows:
    for least in (Outcome.HELD, Outcome.SHAKEN, Outcome.DROPPED):
        best = rows[rows["outcome"] >= least]
        if len(best):
            return best[:: -(-len(best) // CANDIDATES)]
    return rows[:0]


def _farthest(positions: NDArray[np.floating], approaches: NDArray[np.floating], most: int) -> list[int]:
    """Places of hands: the outermost first, then ever the one that is farthest from those chosen."""
    features = np.hstack([positions[:, :2], 0.5 * APART * approaches])
    chosen = [int(np.argmax(np.linalg.norm(positions[:, :2], axis=1)))]
    nearest = np.linalg.norm(features - features[chosen[0]], axis=1)
    while len(chosen) < most and nearest.max() > APART:
        chosen.append(int(np.argmax(nearest)))
        nearest = np.minimum(nearest, np.linalg.norm(features - features[chosen[-1]], axis=1))
    return chosen
