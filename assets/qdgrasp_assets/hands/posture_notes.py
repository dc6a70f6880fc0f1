"""What is worth a thought in a gripper's file: it can be used, and something in it is unlikely."""

from collections.abc import Iterator
from itertools import combinations, product

import numpy as np

from qdgrasp_assets.gripper_file import GripperFile
from qdgrasp_assets.hands import palm
from qdgrasp_assets.hands.body import Body
from qdgrasp_assets.hands.motors import CLOSING_TIME
from qdgrasp_assets.hands.postures import (
    AWAY,
    BESIDE,
    DEEP,
    Postures,
    angle,
    deep_pairs,
    depth_at,
    is_always_deep,
)
from qdgrasp_protocol.phrases import counted, plain

OFF = np.radians(35.0)
"""An approach axis that is so far from where the fingers close is noted [rad]."""
PALM_OFF, FAR, JAW_OFF = 0.03, 0.02, 0.015
"""How far palm_offset, the stand-off and the jaw's opening may be from what the shapes say [m]."""
CROSSED = 5e-3
"""Finger links that end so deep in each other have gone through each other [m]."""
COURSE = np.linspace(0.0, 1.0, 21)
"""The shares of the way at which it is looked where they meet."""
SLOW = 1.05
"""A joint closes in time if it needs this share of the time, or less."""


def posture_notes(file: GripperFile, body: Body) -> tuple[str, ...]:
    """What is worth a thought."""
    hand = Postures(file, body)
    notes = (
        _shapeless,
        _inclined,
        _beside,
        _palm,
        _standoff,
        _jaw,
        _crossing,
        _slow,
        _driven_genes,
        _linkage,
    )
    return tuple(words for note in notes for words in note(hand))


def _linkage(hand: Postures) -> Iterator[str]:
    found = [
        f"'{one}' and '{other}'"
        for one, other, _ in deep_pairs(hand, 0.0)
        if is_always_deep(hand, one, other)
    ]
    if found:
        yield f"in each other in every posture, as links of one linkage are: {', '.join(found)}"


def _inclined(hand: Postures) -> Iterator[str]:
    if AWAY >= angle(hand) > OFF:
        axis = plain(palm.approach(hand.closing))
        yield (
            f"approach_axis is {np.degrees(angle(hand)):.0f} degrees from where the fingers close, [{axis}]"
        )


def _shapeless(hand: Postures) -> Iterator[str]:
    bare = [link for link in hand.file.finger_links if link not in hand.body.parts]
    if bare:
        yield f"finger links without a collision shape, which touch nothing: {', '.join(bare)}"


def _beside(hand: Postures) -> Iterator[str]:
    if hand.closing.fingers and (aside := palm.aside(hand.closing, hand.axis)) > BESIDE:
        yield (
            f"the fingers close {1000 * aside:.0f} mm beside the line through the base link along the "
            "approach axis, which is where objects are: few grasps will be found, unless the base link is "
            "in the middle (`qdgrasp gripper new --mend` puts one there)"
        )


def _palm(hand: Postures) -> Iterator[str]:
    surface, is_met = palm.palm_surface(hand.body, hand.axis)
    if palm.palm_links(hand.body) and is_met and abs(surface - hand.file.palm_offset) > PALM_OFF:
        yield f"palm_offset is {hand.file.palm_offset:g} m, and the palm's shapes end at {surface:.4g} m"


def _standoff(hand: Postures) -> Iterator[str]:
    if not hand.closing.fingers:
        return
    room = palm.reach(hand.closing, hand.axis) - hand.file.palm_offset
    if hand.file.standoff[1] > room + FAR:
        yield (
            f"standoff goes to {hand.file.standoff[1]:g} m, and the fingers reach {room:.4g} m "
            "beyond the palm"
        )


def _jaw(hand: Postures) -> Iterator[str]:
    across = palm.opposed(hand.closing, hand.axis) if hand.closing.fingers else None
    jaw = hand.file.jaw
    if across is None or (room := palm.opening(hand.closing, hand.axis, across)) <= 0:
        return
    axis = plain(across)
    if jaw is None:
        yield (
            f"two fingers that oppose each other and no [jaw]: with axis = [{axis}], opening = {room:.4g} "
            "it could use antipodal methods"
        )
    elif abs(across @ jaw.packed.axis) < np.cos(OFF):
        yield f"jaw.axis is [{plain(jaw.axis)}], and the fingers oppose each other along [{axis}]"
    elif abs(room - jaw.opening) > JAW_OFF:
        yield f"jaw.opening is {jaw.opening:g} m, and between the shapes of the open fingers are {room:.4g} m"


def _crossing(hand: Postures) -> Iterator[str]:
    """Fingers that close through each other."""
    found = sorted(_crossed(hand), reverse=True)
    if not found:
        return
    (deep, one, other), others = found[0], len(found) - 1
    meets = next(share for share in COURSE if depth_at(hand, one, other, share) >= DEEP)
    more = f" (and {counted(others, 'other pair')} of links)" if others else ""
    yield (
        f"the fingers close through each other: '{one}' and '{other}', which are apart when open, meet at "
        f"{100 * meets:.0f} % of the way and end {1000 * deep:.0f} mm in each other{more}; the simulator "
        "lets them, so that they may hold thin objects as no real hand can: close them less far"
    )


def _crossed(hand: Postures) -> Iterator[tuple[float, str, str]]:
    """How deep finger links of different fingers are in each other when closed [m], which open are apart."""
    touching = set(hand.file.finger_links)
    for finger, another in combinations(hand.closing.fingers, 2):
        for one, other in product(finger.links, another.links):
            deep = depth_at(hand, one, other, 1.0) if {one, other} <= touching else 0.0
            if deep >= CROSSED and depth_at(hand, one, other, 0.0) < DEEP:
                yield deep, one, other


def _slow(hand: Postures) -> Iterator[str]:
    late = {name: _time(hand, name) for name in hand.closing.closed}
    late = {name: time for name, time in late.items() if time > SLOW * CLOSING_TIME}
    if late:
        names = ", ".join(f"{name} needs {time:.2g} s" for name, time in late.items())
        yield (
            f"an evaluation closes the hand for {CLOSING_TIME:.2f} s, in which it does not close wholly: "
            f"{names}"
        )


def _time(hand: Postures, name: str) -> float:
    table, joint = hand.file.joints[name], hand.body.joint(name)
    velocity = joint.velocity if table.velocity is None else table.velocity
    return abs(hand.closing.closed[name] - table.open) / velocity if velocity > 0 else 0.0


def _driven_genes(hand: Postures) -> Iterator[str]:
    driven = [name for name in hand.file.free_joints if hand.file.joints[name].driven]
    if driven:
        yield (
            "free joints that are driven go back to their open place while the hand closes: "
            f"{', '.join(driven)}"
        )
