"""A gripper's file held against the geometry of its hand: postures, palm and axis that cannot be meant."""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from itertools import combinations

import numpy as np

from qdgrasp_assets.gripper_file import GripperFile
from qdgrasp_assets.hands import palm
from qdgrasp_assets.hands.body import Body
from qdgrasp_assets.hands.closing import Closing, between
from qdgrasp_assets.hands.fingers import find_fingers
from qdgrasp_assets.hands.overlap import Floats, depth
from qdgrasp_protocol.phrases import plain

DEEP = 2e-3
"""Links are in each other where a ball so large fits into both [m]; their hulls are larger than they are."""
AWAY = np.radians(100.0)
"""An approach axis that is so far from the fingers points away from them."""
NEARER = 0.97
"""A hand closes if its fingertips come to this share of their distance, or nearer."""
BESIDE = 0.03
"""Fingers that close farther from the line of approach than this do not grasp what the palm looks at [m]."""


@dataclass(frozen=True)
class Postures:
    """A hand as its file opens and closes it."""

    file: GripperFile
    body: Body

    @cached_property
    def closing(self) -> Closing:
        """The way from open to closed; every joint as the file says, followers too."""
        joints = {name: table for name, table in self.file.joints.items() if name in self.body.moving}
        opened = {name: table.open for name, table in joints.items()}
        closed = {
            name: table.closed for name, table in joints.items() if table.closed is not None and table.driven
        }
        course = [between(opened, closed, share) for share in (0.0, 0.5, 1.0)]
        return Closing(self.body, find_fingers(self.body, course), opened, closed, {})

    @cached_property
    def axis(self) -> Floats:
        """The approach axis (3,), unit."""
        axis = np.array(self.file.approach_axis)
        unit: Floats = axis / np.linalg.norm(axis)
        return unit

    def posture(self, share: float) -> dict[str, float]:
        """All joints between open (0) and closed (1), each by itself."""
        return between(self.closing.opened, self.closing.closed, share)


def posture_faults(file: GripperFile, body: Body) -> tuple[str, ...]:
    """What cannot be meant; empty when nothing is."""
    hand = Postures(file, body)
    touching = [link for link in file.finger_links if link in body.parts]
    if not touching:
        links = ", ".join(sorted(set(body.parts) - set(palm.palm_links(body)))) or "none"
        return (
            "no finger link has a collision shape, so that none could touch; those that move and have: "
            f"{links}",
        )
    return (*_mimicry(hand), *_open_overlaps(hand), *_opens(hand), *_looks_away(hand), *_beyond(hand))


def _mimicry(hand: Postures) -> Iterator[str]:
    """Followers that the file sends elsewhere than their leaders."""
    joints = hand.file.joints
    for name, follower in hand.body.followers.items():
        for label, share in (("open", 0.0), ("closed", 1.0)):
            posture = hand.posture(share)
            meant = float(np.clip(follower.at(posture[follower.leader]), *hand.body.range(name)))
            if (
                name in joints
                and joints[name].driven
                and abs(posture[name] - meant) > 1e-3 + 0.01 * abs(meant)
            ):
                yield (
                    f"joints.{name} is {label} at {posture[name]:g}, and by the URDF's <mimic> it is at "
                    f"{meant:g} where {follower.leader} is at {posture[follower.leader]:g}; "
                    f"write {label} = {meant:g}"
                )


def _open_overlaps(hand: Postures) -> Iterator[str]:
    """Links that are in each other in the open posture, and not on the way to the closed one."""
    for one, other, deep in deep_pairs(hand, 0.0):
        if not is_always_deep(hand, one, other):
            yield (
                f"the links '{one}' and '{other}' are {1000 * deep:.0f} mm in each other in the open "
                "posture; correct the open positions of the joints between them, or the place of their shapes"
            )


def is_always_deep(hand: Postures, one: str, other: str) -> bool:
    """Whether two links are deep in each other all the way, as those of one linkage are."""
    return min(depth_at(hand, one, other, share) for share in (0.25, 0.5, 0.75, 1.0)) >= DEEP


def deep_pairs(hand: Postures, share: float) -> Iterator[tuple[str, str, float]]:
    """Pairs of links that are no neighbours and deep in each other."""
    mounts = hand.body.mounts
    arms = {mounts[joint.child]: mounts[joint.parent] for joint in hand.body.robot.joints if joint.moves}
    for one, other in combinations(hand.body.parts, 2):
        first, second = mounts[one], mounts[other]
        are_near = first == second or arms.get(first) == second or arms.get(second) == first
        deep = 0.0 if are_near else depth_at(hand, one, other, share)
        if deep > DEEP:
            yield one, other, deep


def depth_at(hand: Postures, one: str, other: str, share: float) -> float:
    """How deep two links are in each other at a share of the way [m]."""
    placed = hand.body.placed(hand.posture(share), (one, other))
    return depth(placed[one], placed[other])


def _opens(hand: Postures) -> Iterator[str]:
    """A closed posture that brings no fingertips together."""
    closing = hand.closing
    if not closing.closed:
        yield "no joint closes: give those of the fingers a closed position that is not the open one"
        return
    if not closing.fingers:
        return
    courses = [_apart(hand, share) for share in np.linspace(0, 1, 9)]
    if min(courses) >= NEARER * courses[0] and len(closing.fingers) == 1:
        yield (
            "only one finger moves, it does not close on the line of approach, and nothing is fixed opposite "
            "to it: a hand grasps from two sides (suction is not simulated)"
        )
    elif min(courses) >= NEARER * courses[0]:
        yield (
            f"the fingers do not close: their tips are {1000 * courses[0]:.0f} mm apart when open and "
            f"{1000 * courses[-1]:.0f} mm when closed; swap open and closed, or correct them"
        )


def _apart(hand: Postures, share: float) -> float:
    """The mean distance between fingertips [m]; of a single one, that to the line of approach."""
    frames = hand.body.frames(hand.posture(share))
    tips = [finger.tip(frames) for finger in hand.closing.fingers]
    if len(tips) == 1:
        return float(np.linalg.norm(tips[0] - (tips[0] @ hand.axis) * hand.axis))
    return float(np.mean([np.linalg.norm(one - other) for one, other in combinations(tips, 2)]))


def angle(hand: Postures) -> float:
    """Between the approach axis and the way to the half closed fingertips [rad]."""
    if not hand.closing.fingers:
        return 0.0
    return float(np.arccos(np.clip(hand.axis @ palm.approach(hand.closing), -1, 1)))


def _looks_away(hand: Postures) -> Iterator[str]:
    if angle(hand) > AWAY:
        axis = plain(palm.approach(hand.closing))
        yield f"approach_axis points away from the fingers, which are toward [{axis}]; turn it round"


def _beyond(hand: Postures) -> Iterator[str]:
    if not hand.closing.fingers:
        return
    reach, offset = palm.reach(hand.closing, hand.axis), hand.file.palm_offset
    if offset >= reach:
        yield (
            f"palm_offset is {offset:g} m along the approach axis, and the fingers reach no farther than "
            f"{reach:.4g} m; the palm's shapes end at {palm.palm_surface(hand.body, hand.axis)[0]:.4g} m"
        )
