"""Synergies of a hand with a thumb: which of its fingers close together with it."""

import numpy as np

from qdgrasp_assets.hands.closing import Closing
from qdgrasp_assets.hands.fingers import Finger
from qdgrasp_assets.hands.overlap import Floats

FEWEST = 3
"""A hand has so many fingers, or no thumb."""
ALIKE = 0.8
"""The cosine from which on two fingers turn the same way."""


def pinches(closing: Closing) -> tuple[dict[str, tuple[str, ...]], str]:
    """The thumb with each other finger, and all together, by name; none for a hand without a thumb."""
    thumb = find_thumb(closing)
    if thumb is None:
        return {}, ""
    others = [finger for finger in closing.fingers if finger is not thumb]
    pairs = {
        f"thumb_{number}": _joints(closing, thumb) + _joints(closing, finger)
        for number, finger in enumerate(others, 1)
    }
    everything = tuple(joint for finger in closing.fingers for joint in _joints(closing, finger))
    return {
        **pairs,
        "all": everything,
    }, f"the thumb ({thumb.links[-1]}) with each other finger, and all together"


def find_thumb(closing: Closing) -> Finger | None:
    """The one finger that closes round another way than all others do; None where there is no such one."""
    if len(closing.fingers) < FEWEST:
        return None
    turns = np.array([_turn(closing, finger) for finger in closing.fingers])
    alike = turns @ turns.T > ALIKE
    strangers = [which for which, row in enumerate(alike) if row.sum() == 1]
    if len(strangers) != 1 or alike.sum() != (len(turns) - 1) ** 2 + 1:
        return None
    return closing.fingers[strangers[0]]


def _turn(closing: Closing, finger: Finger) -> Floats:
    """What a finger's outermost joint turns about as it closes (3,), unit; zeros where none turns."""
    body, names = closing.body, [name for name in finger.joints if name in closing.closed]
    joint = body.joint(names[-1]) if names else None
    if joint is None or joint.kind == "prismatic":
        return np.zeros(3)
    sense = np.sign(closing.closed[joint.name] - closing.opened[joint.name])
    turn: Floats = sense * (body.frames(closing.posture(0.0))[joint.child][:3, :3] @ joint.axis)
    return turn


def _joints(closing: Closing, finger: Finger) -> tuple[str, ...]:
    """The joints of a finger that close, followers of such too."""
    followers = closing.body.followers
    return tuple(
        name
        for name in finger.joints
        if name in closing.closed or (name in followers and followers[name].leader in closing.closed)
    )
