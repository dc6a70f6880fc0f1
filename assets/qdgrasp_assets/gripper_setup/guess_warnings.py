"""Signs that the guess of a hand is wrong, each with the flag of `qdgrasp gripper new` that mends it."""

from collections.abc import Collection, Iterator
from itertools import combinations

import numpy as np

from qdgrasp_assets.geometry.mesh import Floats
from qdgrasp_assets.gripper_setup.closing_motion import PARALLEL, ClosingMotion
from qdgrasp_assets.gripper_setup.finger_contact import closing_leaders
from qdgrasp_assets.grippers.hand_model import Finger, finger_root, fixed_limbs
from qdgrasp_protocol.text import join_numbers

NEARER = 0.9  # Fingertips that keep more than this share of their distances as the hand closes do not close
SHORT_FINGER = 0.35  # A finger is short beside the longest if it has at most this share of its length
EARLY = 0.1  # Fingers meet early before this share of their way
COURSE = np.linspace(0.0, 1.0, 9)  # Shares of the way at which the distances of fingertips are compared


def guess_warnings(closing: ClosingMotion, axis: Floats, told: Collection[str]) -> Iterator[str]:
    """Yield what looks wrong in a guess; `axis` (3,) is the approach axis, `told` the keys not guessed."""
    yield from _finger_warnings(closing)
    yield from _spread_warnings(closing, axis)
    yield from _distance_warnings(closing)
    yield from _early_warnings(closing)
    if "approach_axis" not in told and np.abs(axis).max() < 1 - 1e-9:
        yield (
            f"the approach axis, ({join_numbers(axis.round(3))}), is none of the base link's axes: if the "
            "palm looks along one of them, say so with --approach-axis, such as 0,0,1"
        )


def _finger_warnings(closing: ClosingMotion) -> Iterator[str]:
    lengths = [_length(closing, finger) for finger in closing.fingers]
    fixed = fixed_limbs(closing.body)
    for finger, length in zip(closing.fingers, lengths, strict=True):
        root = closing.body.joint(finger.joints[0]).child
        if not closing_leaders(closing.body, finger, closing.closed) and finger.joints[0] not in fixed:
            yield (
                f"nothing closes the finger that begins with '{root}': say where its joints close to with "
                "--closed JOINT=POSITION; if it is no finger, name those that are, each with --finger LINK"
            )
        elif length <= SHORT_FINGER * max(lengths):
            yield (
                f"the finger that begins with '{root}' is {1000 * length:.0f} mm long, and the longest "
                f"{1000 * max(lengths):.0f} mm: if it is no finger, name the links that begin the others, "
                "each with --finger LINK"
            )


def _length(closing: ClosingMotion, finger: Finger) -> float:
    tip = finger.tip(closing.body.robot.forward({}))
    return float(np.linalg.norm(tip - finger_root(closing.body, finger)))


def _spread_warnings(closing: ClosingMotion, axis: Floats) -> Iterator[str]:
    """Warn of joints that close by turning a finger about the approach axis, as joints that spread do."""
    frames = closing.body.robot.forward(closing.posture(0.0))
    for finger in closing.fingers:
        for name in closing_leaders(closing.body, finger, closing.closed):
            joint = closing.body.joint(name)
            about = frames[joint.child][:3, :3] @ joint.axis
            if joint.kind != "prismatic" and abs(about @ axis) > PARALLEL:
                yield (
                    f"the joint '{name}' closes by turning about the approach axis, as joints do that spread "
                    f"fingers: if it does not close the hand, say --not-closing {name}"
                )


def _distance_warnings(closing: ClosingMotion) -> Iterator[str]:
    if len(closing.fingers) < 2 or not closing.closed:
        return
    distances = [
        float(np.mean([np.linalg.norm(one - other) for one, other in combinations(closing.tips(share), 2)]))
        for share in COURSE
    ]
    if min(distances) > NEARER * distances[0]:
        yield (
            f"the fingertips come hardly nearer to each other as the hand closes, {1000 * distances[0]:.0f} "
            f"mm apart when open and {1000 * min(distances):.0f} mm at their nearest: say which joints do "
            "not close with --not-closing JOINT, or where they close to with --closed JOINT=POSITION"
        )


def _early_warnings(closing: ClosingMotion) -> Iterator[str]:
    for name in closing.stopped:
        low, high = closing.body.range(name)
        way = abs(closing.closed[name] - closing.opened[name])
        if way < EARLY * (high - low):
            yield (
                f"the joint '{name}' {closing.stopped[name]}: if it begins elsewhere, say where with "
                f"--open {name}=POSITION; if it must go on, with --closed {name}=POSITION"
            )
