"""Where a hand looks and how far it reaches: approach axis, palm, stand-off, and the jaw of two fingers."""

import numpy as np

from qdgrasp_assets.hands.body import Body
from qdgrasp_assets.hands.closing import Closing
from qdgrasp_assets.hands.fingers import Finger, fixed_limbs, root
from qdgrasp_assets.hands.overlap import Floats, ray

HALF_CLOSED = (0.5, 0.75)
"""Shares of the way from open to closed at which fingertips are in front of the palm."""
COURSE = (0.0, 0.25, 0.5, 0.75, 1.0)
SNAP = np.cos(np.radians(25.0))
"""The cosine from which on a direction is taken for the axis of the frame next to it."""
SHORT = 5e-3
"""A way from roots to tips that is shorter has no direction to go by [m]."""
PAD = 0.35
"""The inner sides of two fingers face each other over this share of their reach, from the tips on."""


def grasp_centre(closing: Closing) -> Floats:
    """The middle of the fingertips of the half closed hand (3,) [m], base link's frame."""
    centre: Floats = np.mean([closing.tips(share).mean(axis=0) for share in HALF_CLOSED], axis=0)
    return centre


def approach(closing: Closing) -> Floats:
    """The direction (3,) in which a hand looks, as `way` has it; an axis if near one."""
    return snapped(way(closing)[0])


def way(closing: Closing) -> tuple[Floats, str]:
    """How objects come to be between the fingers (3,) [m], and by what that is said.

    From the fingers' roots to the tips of the half closed hand. Where this says nothing, because joints lie
    in the middle of the fingers, or one finger is fixed: from the middle of the palm to that of the fingers.
    """
    roots = np.mean([root(closing.body, finger) for finger in closing.fingers], axis=0)
    outward = grasp_centre(closing) - roots
    palm = closing.body.corners(carriers(closing), {})
    if not len(palm) or (np.linalg.norm(outward) >= SHORT and not fixed_limbs(closing.body)):
        return outward, "from the fingers' roots to the fingertips of the half closed hand"
    opened = closing.posture(0.0)
    fingers = [_middle(closing.body.corners(finger.links, opened)) for finger in closing.fingers]
    return np.mean(fingers, axis=0) - _middle(palm), "from the middle of the palm to that of the fingers"


def carriers(closing: Closing) -> tuple[str, ...]:
    """The links on which the fingers hang; where these have no shapes, the whole palm."""
    body = closing.body
    parents = {body.joint(finger.joints[0]).parent for finger in closing.fingers}
    return tuple(link for link in palm_links(body) if link in parents) or palm_links(body)


def _middle(corners: Floats) -> Floats:
    """The middle (3,) of the box around corners (n, 3)."""
    middle: Floats = (corners.min(axis=0) + corners.max(axis=0)) / 2
    return middle


def snapped(direction: Floats) -> Floats:
    """The unit vector of a direction (3,), or the axis that is next to it."""
    length = np.linalg.norm(direction)
    unit = direction / length if length else np.array([0.0, 0.0, 1.0])
    largest = int(np.abs(unit).argmax())
    axis = np.zeros(3)
    axis[largest] = np.sign(unit[largest])
    found: Floats = axis if abs(unit[largest]) >= SNAP else unit.round(3)
    return found


def palm_links(body: Body) -> tuple[str, ...]:
    """The base link and what is fixed to it, where they have shapes and are no fingers."""
    fixed = [body.robot.subtree(body.joint(name).child).links for name in fixed_limbs(body)]
    return tuple(
        link
        for link in body.parts
        if body.mounts[link] == body.robot.root and not any(link in links for links in fixed)
    )


def palm_surface(body: Body, axis: Floats) -> tuple[float, bool]:
    """How far from the base link the palm ends along the approach axis [m], and whether the axis meets it.

    Where it passes the palm by, the palm's farthest point counts.
    """
    links = palm_links(body)
    found = ray([part for parts in body.placed({}, links).values() for part in parts], axis)
    if found is not None:
        return max(found, 0.0), True
    return float((body.corners(links, {}) @ axis).max(initial=0.0)), False


def reach(closing: Closing, axis: Floats) -> float:
    """How far the fingers come along the approach axis while they close [m], from the base link."""
    links = [link for finger in closing.fingers for link in finger.links]
    corners = [closing.body.corners(links, closing.posture(share)) for share in COURSE]
    return float((np.concatenate(corners) @ axis).max(initial=0.0))


def aside(closing: Closing, axis: Floats) -> float:
    """How far the grasp centre is from the line through the base link along the approach axis [m]."""
    centre = grasp_centre(closing)
    return float(np.linalg.norm(centre - (centre @ axis) * axis))


def opposed(closing: Closing, axis: Floats) -> Floats | None:
    """The unit vector (3,) from one finger to the other, at right angles to the approach axis.

    None where there are not two fingers that move toward each other.
    """
    if len(closing.fingers) != 2:
        return None
    opened, closed = closing.tips(0.0), closing.tips(0.5)
    moved = (closed - opened) - ((closed - opened) @ axis)[:, None] * axis
    if not moved[0] @ moved[1] < 0:
        return None
    between = moved[1] - moved[0]
    direction = snapped(between)
    direction = direction if abs(direction @ axis) < 1e-6 else between / np.linalg.norm(between)
    return np.abs(direction) if np.count_nonzero(direction) == 1 else direction


def opening(closing: Closing, axis: Floats, across: Floats) -> float:
    """The room between the inner sides of two open fingers along `across` [m]."""
    least = reach(closing, axis)
    low = least - PAD * (least - palm_surface(closing.body, axis)[0])
    sides = [_pad(closing, finger, axis, low) @ across for finger in closing.fingers]
    one, other = sorted(sides, key=np.mean)
    return float(max(other.min() - one.max(), 0.0))


def _pad(closing: Closing, finger: Finger, axis: Floats, low: float) -> Floats:
    """Corners (n, 3) of an open finger beyond `low` [m] along the approach axis."""
    corners = closing.body.corners(finger.links, closing.posture(0.0))
    heights = corners @ axis
    beyond: Floats = corners[heights >= min(low, heights.max())]
    return beyond
