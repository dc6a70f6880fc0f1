"""Link hulls of `barrett` and `robotiq_2f`, made from dimensions.

Run as `python -m qdgrasp_assets.grippers.builtin_hulls`, this writes all of them.

Each is the convex hull of a few turned parts and corners, and is written as STL beside this file. They are
in the frames of their links; dimensions are millimetres, and follow the published hands' to half of one.
"""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

Points = NDArray[np.float64]  # (n, 3) [mm]
HERE = Path(__file__).parent
CORNERS = 16  # Number of corners of a circle
BULGE = 2.0 / (1.0 + np.cos(np.pi / CORNERS))
"""Factor on the radius: corners are as far outside the circle as sides are inside it."""
AXES = {"y": (2, 0, 1), "z": (0, 1, 2)}  # Indices of a circle's two coordinates and of its height, by axis


def disc(axis: str, centre: Sequence[float], rings: Sequence[tuple[float, float]]) -> Points:
    """Return a turned part: circles about an axis through `centre`, each with height and radius."""
    angles = 2.0 * np.pi * np.arange(CORNERS) / CORNERS
    circle = BULGE * np.stack([np.cos(angles), np.sin(angles)], axis=1)
    flat = [np.column_stack([radius * circle, np.full(CORNERS, height)]) for height, radius in rings]
    points: Points = np.concatenate(flat)[:, np.argsort(AXES[axis])] + np.array(centre)
    return points


def mirrored(axis: str, points: ArrayLike, middle: float = 0.0) -> Points:
    """Return points and their mirror images across the plane at `middle` on an axis."""
    direction = np.arange(3) == "xyz".index(axis)
    right = np.array(points, float)
    left = right * np.where(direction, -1.0, 1.0)
    both: Points = np.concatenate([right, left]) + middle * direction
    return both


def barrett_palm() -> Points:
    """Return the palm: a bevelled drum, with the seat of the fixed finger behind and above."""
    drum = disc("z", (0, 0, 0), [(0, 43), (5, 44.4), (62, 44.2)])
    rim = disc("z", (0, 0, 0), [(75, 44.2)])
    front = [
        (12.5, 40.1, 70),
        (18, 33.7, 73),
        (26.8, 22.7, 78),
        (36.1, 23.9, 75.6),
        (38.6, 15.7, 78),
        (42, -2, 78),
    ]
    seat = [(6.8, -51.6, 20), (10, -61.6, 43), (11.7, -65, 50), (11.7, -65, 74), (11.7, -62.6, 83)]
    top = [(11.7, -58.6, 87.4), (11, -51.4, 90.4), (13.5, -47, 89.4), (9, -48.3, 90.4)]
    return np.concatenate([drum, rim[rim[:, 1] < 18], mirrored("x", [*front, *seat, *top])])


def barrett_knuckle() -> Points:
    """Return the first link of a spreading finger: a drum, and the seat of the next link."""
    drum = disc("z", (0, 0, 0), [(-5, 9), (-1.5, 12.3), (24.8, 12.3), (30, 9)])
    seat = disc("y", (-50, 0, 33.9), [(-12.3, 13.8), (-11.2, 14.9), (11.2, 14.9), (12.3, 13.8)])
    foot = [(-64.8, 11.3, 8.8), (-64.1, 12.3, 9.6), (-50, 11.3, 0.5), (-49.8, 12.3, 1.4)]
    return np.concatenate([drum, seat, mirrored("y", foot)])


def barrett_finger() -> Points:
    """Return the link between knuckle and fingertip: a drum at either end, a flat back."""
    near = disc("z", (0, 0, 0.8), [(-10.5, 10), (-2.5, 12.4), (2.5, 12.4), (10.5, 10)])
    far = disc("z", (-69.5, 3.3, 0), [(-8.7, 5.5), (-2.2, 9.9), (5.5, 9.9), (9.3, 3.5)])
    back = [(-25.5, 15, 5.5), (-54.6, 15, 5.5), (-13.5, 12.2, 9.5), (-58.4, 12.4, 9.5), (-59, -6.4, 8.4)]
    return np.concatenate([near, far, mirrored("z", back, 0.8)])


def barrett_fingertip() -> Points:
    """Return the last link: a drum, bent by 45 degrees, and a rounded end."""
    drum = disc("z", (0, 0, 0.6), [(-11.5, 6.4), (-9.7, 8.6), (-7, 9.4), (7, 9.4), (9.7, 8.6), (11.5, 6.4)])
    inset = {
        6.0: [(-47.7, 34.9), (-40.2, 39.9), (-37, 40.3), (-33.8, 39.8), (-20.6, 31.2), (-7, 20.1)],
        9.7: [(-44.9, 33.2), (-41.8, 36.7), (-38.4, 38.1), (-34.6, 38), (-21.5, 29.7), (-8.5, 19)],
        11.5: [(-40.9, 33), (-39.8, 34.4), (-36.3, 35.4), (-34.6, 34.9), (-23.3, 27.5), (-10, 15.5)],
    }
    end = [(x, y, height) for height, outline in inset.items() for x, y in outline]
    return np.concatenate([drum, mirrored("z", end, 0.6)])


def robotiq_palm() -> Points:
    """Return the palm: a drum whose front narrows to the flat between the fingers."""
    drum = disc("z", (0, 0, 0), [(-3, 12.9), (0, 37), (40, 37.5)])
    rim = [(41.6, 4.9, 52), (40.8, 8.6, 52), (42.3, 5, 63), (40.3, 9.1, 66), (41.5, 4.9, 67.2), (37, 9.1, 72)]
    front = [(24.5, 4.7, 91.7), (23.2, 8.5, 91.8), (15.8, 5, 97.9), (14.8, 9.1, 97.9)]
    flank = [(5, 28.3, 59), (11, 31, 51), (12.5, 25, 64), (37.5, 12.8, 59)]
    return np.concatenate([drum, mirrored("x", mirrored("y", [*rim, *front, *flank]))])


def robotiq_knuckle() -> Points:
    """Return the inner knuckle: a bar between two pins, wider at the palm."""
    pins = [disc("y", (0, 0, 0), [(-19.5, 6), (19.5, 6)]), disc("y", (34.4, 0, 45.4), [(-12, 6), (12, 6)])]
    outer = [(0, 19.5, 9.8), (12.9, 17.5, 26.9), (20.8, 15.5, 37.2), (24.3, 15.5, 38.5), (26.8, 13.5, 44.8)]
    inner = [(9.5, 19.5, 2.4), (22.5, 17.5, 19.7), (30.2, 15.5, 30), (30.6, 15.5, 33.7), (36, 13.5, 37.8)]
    end = [(36.9, 13.5, 46.5), (34.9, 13.5, 48)]
    return np.concatenate([*pins, mirrored("y", [*outer, *inner, *end])])


def robotiq_finger() -> Points:
    """Return the inner finger, which is the fingertip: a flat pad in front, a pin behind it."""
    pin = disc("y", (18, 0, -6.6), [(-7.1, 5.9), (7.1, 5.9)])
    pad = [(-7.8, 11, 7), (-7.8, 11, 40), (-7.8, 10, 42), (-7.8, 8, 43.8), (-7.8, 7, 44), (-7.8, 9.5, 7)]
    tip = [(-0.3, 11, 37.6), (-1, 11, 40), (-1, 10, 42), (-1, 8, 43.8), (-1, 7, 44), (4, 7.1, 38)]
    foot = [(-6.2, 9, 1.6), (-5.6, 7.1, -2.1), (-4.6, 7.1, -3.9), (-3, 7.1, -5.2), (-7, 10, 4.3)]
    back = [(-0.3, 11, 6.6), (-0.7, 10, 1.7), (4.6, 10, 1.7), (5.8, 10, 26.2)]
    bend = [(6.4, 9, -3.5), (10.3, 9, -3.5), (12.7, 9, -0.7), (12.6, 9, 13.5)]
    return np.concatenate([pin, mirrored("y", [*pad, *tip, *foot, *back, *bend])])


HULLS: dict[str, Callable[[], Points]] = {
    "barrett_palm": barrett_palm,
    "barrett_knuckle": barrett_knuckle,
    "barrett_finger": barrett_finger,
    "barrett_fingertip": barrett_fingertip,
    "robotiq_2f_palm": robotiq_palm,
    "robotiq_2f_knuckle": robotiq_knuckle,
    "robotiq_2f_finger": robotiq_finger,
}


def hull(points: Points) -> Any:
    """Return the convex hull of points [mm] as a mesh [m]."""
    import trimesh

    return trimesh.convex.convex_hull(np.round(points, 3) / 1000.0)


def main() -> None:
    """Write all hulls as STL files."""
    for name, points in HULLS.items():
        hull(points()).export(HERE / f"{name}.stl")


if __name__ == "__main__":
    main()
