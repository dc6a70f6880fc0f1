"""Aim: from where an evaluation is looked at, so that all of it is in the picture."""

from collections.abc import Iterable, Sequence
from itertools import product

import numpy as np

from qdgrasp_assets.rotation import Floats
from qdgrasp_worker.replaying.eye import Eye
from qdgrasp_worker.replaying.lens import Lens, lens
from qdgrasp_worker.replaying.moment import Moment

AZIMUTHS, ELEVATIONS = range(0, 360, 20), (12, 30)
"""The sides that are tried [deg]."""
OF_OBJECT = -8
"""Where in the corners of all that is there those of the object begin."""
GLANCE = (160, 120)
"""Columns and rows of a picture that is only counted."""


def aimed(
    eye: Eye, moments: Sequence[Moment], still: Moment, view: tuple[float, float], aspect: float
) -> Lens:
    """The lens that has all of `moments` in its picture."""
    return lens(around(eye, moments, still), *view, aspect)


def best_view(eye: Eye, still: Moment) -> tuple[float, float]:
    """Azimuth and elevation [deg] from where the most is seen of both the fingers and the object."""
    corners = around(eye, [still], still)
    eye.show(still)
    views = list(product(AZIMUTHS, ELEVATIONS))
    scores = [_score(eye, lens(corners, *view, GLANCE[0] / GLANCE[1])) for view in views]
    azimuth, elevation = views[int(np.argmax(scores))]
    return float(azimuth), float(elevation)


def around(eye: Eye, moments: Iterable[Moment], still: Moment) -> Floats:
    """(n, 3) [m]: corners around hand and object in all moments; an object that is lost is not followed."""
    eye.show(still)
    corners = [eye.corners()]
    for moment in moments:
        eye.show(moment)
        here = eye.corners()
        corners.append(here if moment.touches else here[:OF_OBJECT])
    return np.concatenate(corners)


def _score(eye: Eye, seen_by: Lens) -> float:
    seen = eye.tell(seen_by, *GLANCE)
    fingers = np.isin(seen.links, list(eye.fingers)).sum()
    return float(fingers * seen.is_object.sum())
