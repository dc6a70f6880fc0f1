"""Checks of a gripper's file against its hand's geometry, and the links that may overlap."""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from itertools import combinations, product

import numpy as np

from qdgrasp_assets.geometry.mesh import Floats
from qdgrasp_assets.geometry.voxels import Hull
from qdgrasp_assets.gripper_setup import closing_motion
from qdgrasp_assets.gripper_setup.closing_motion import (
    CLOSING_TIME,
    DEEP_OVERLAP,
    ClosingMotion,
    interpolate_posture,
)
from qdgrasp_assets.grippers.gripper_file import NOTHING_CLOSES, GripperFile
from qdgrasp_assets.grippers.hand_model import HandModel, depth, find_fingers
from qdgrasp_assets.scene import unit_vector
from qdgrasp_protocol.text import join_numbers

LOOKS_AWAY = np.radians(100.0)  # Angle to the fingers from which an approach axis points away from them [rad]
NEARER = 0.97  # A hand closes if its fingertips come to at most this share of their distance
BESIDE = 0.03  # Distance of the closing fingers from the approach line above which grasps miss [m]


@dataclass(frozen=True)
class HandPostures:
    """A hand with the postures of its file."""

    file: GripperFile
    body: HandModel

    @cached_property
    def closing(self) -> ClosingMotion:
        """The way from open to closed; every joint as the file says, followers too."""
        joints = {name: table for name, table in self.file.joints.items() if name in self.body.moving}
        opened = {name: table.open for name, table in joints.items()}
        closed = {
            name: table.closed for name, table in joints.items() if table.closed is not None and table.driven
        }
        course = [interpolate_posture(opened, closed, share) for share in (0.0, 0.5, 1.0)]
        return ClosingMotion(self.body, find_fingers(self.body, course), opened, closed, {})

    @cached_property
    def axis(self) -> Floats:
        """The approach axis (3,), unit."""
        return np.array(unit_vector(self.file.approach_axis))

    def posture(self, share: float) -> dict[str, float]:
        """Return all joints between open (0) and closed (1), each by itself."""
        return interpolate_posture(self.closing.opened, self.closing.closed, share)


def posture_faults(hand: HandPostures) -> tuple[str, ...]:
    """Return the impossible postures, palm and axis of a file in words."""
    parts = hand.body.parts
    if not any(link in parts for link in hand.file.finger_links):
        links = ", ".join(sorted(set(parts) - set(closing_motion.palm_links(hand.body)))) or "none"
        return (
            "no finger link has a collision shape, so that none could touch; those that move and have: "
            f"{links}",
        )
    return (*_mimic_faults(hand), *_open_overlaps(hand), *_closing_faults(hand), *_approach_faults(hand))


def _mimic_faults(hand: HandPostures) -> Iterator[str]:
    joints = hand.file.joints
    for name, follower in hand.body.followers.items():
        for label, share in (("open", 0.0), ("closed", 1.0)):
            posture = hand.posture(share)
            meant = float(np.clip(follower.position(posture[follower.leader]), *hand.body.range(name)))
            is_off = abs(posture[name] - meant) > 1e-3 + 0.01 * abs(meant)
            if name in joints and joints[name].driven and is_off:
                yield (
                    f"joints.{name} is {label} at {posture[name]:g}, and by the URDF's <mimic> it is at "
                    f"{meant:g} where {follower.leader} is at {posture[follower.leader]:g}; "
                    f"write {label} = {meant:g}"
                )


def _open_overlaps(hand: HandPostures) -> Iterator[str]:
    for one, other in combinations(hand.body.parts, 2):
        deep = 0.0 if hand.body.are_neighbours(one, other) else depth_at(hand, one, other, 0.0)
        if deep > DEEP_OVERLAP and not is_always_deep(hand, one, other):
            yield (
                f"the links '{one}' and '{other}' are {1000 * deep:.0f} mm in each other in the open "
                "posture; correct the open positions of the joints between them (--open JOINT=POSITION), or "
                "the place of their shapes"
            )


def is_always_deep(hand: HandPostures, one: str, other: str) -> bool:
    """Return whether two links overlap in all postures, or are on two branches of one linkage."""
    fingers = [finger for finger in hand.closing.fingers if {one, other} <= set(finger.links)]
    branches = [hand.body.robot.subtree(link).links for link in (one, other)]
    if fingers and other not in branches[0] and one not in branches[1]:
        return True
    return min(depth_at(hand, one, other, share) for share in (0.25, 0.5, 0.75, 1.0)) >= DEEP_OVERLAP


def depth_at(hand: HandPostures, one: str, other: str, share: float) -> float:
    """Return the depth of two links in each other at a share of the way [m]."""
    placed = hand.body.parts_at(hand.posture(share), (one, other))
    return max(depth(ours, theirs) for ours, theirs in product(placed[one], placed[other]))


def _closing_faults(hand: HandPostures) -> Iterator[str]:
    closing = hand.closing
    if not closing.closed:
        yield NOTHING_CLOSES
        return
    if not closing.fingers:
        return
    distances = [_tip_distance(hand, share) for share in np.linspace(0, 1, 9)]
    if min(distances) >= NEARER * distances[0] and len(closing.fingers) == 1:
        yield (
            "only one finger moves, it does not close on the line of approach, and nothing is fixed opposite "
            "to it: a hand grasps from two sides (suction is not simulated)"
        )
    elif min(distances) >= NEARER * distances[0]:
        yield (
            f"the fingers do not close: their tips are {1000 * distances[0]:.0f} mm apart when open and "
            f"{1000 * distances[-1]:.0f} mm when closed; swap open and closed, or correct them "
            "(--open, --closed, --not-closing JOINT)"
        )


def _approach_faults(hand: HandPostures) -> Iterator[str]:
    if approach_angle(hand) > LOOKS_AWAY:
        axis = join_numbers(closing_motion.approach_direction(hand.closing))
        yield f"approach_axis points away from the fingers, which are toward [{axis}]; turn it round"
    if not hand.closing.fingers:
        return
    reach, offset = closing_motion.finger_reach(hand.closing, hand.axis), hand.file.palm_offset
    if offset >= reach:
        end = closing_motion.palm_surface(hand.body, hand.axis)[0]
        yield (
            f"palm_offset is {offset:g} m along the approach axis, and the fingers reach no farther than "
            f"{reach:.4g} m; the palm's shapes end at {end:.4g} m"
        )


def _tip_distance(hand: HandPostures, share: float) -> float:
    """Return the mean distance of fingertips [m]; of a single one, to the approach line."""
    tips = hand.closing.tips(share)
    if len(tips) == 1:
        return float(np.linalg.norm(tips[0] - (tips[0] @ hand.axis) * hand.axis))
    return float(np.mean([np.linalg.norm(one - other) for one, other in combinations(tips, 2)]))


def approach_angle(hand: HandPostures) -> float:
    """Return the angle of the approach axis to the half closed fingertips [rad]."""
    if not hand.closing.fingers:
        return 0.0
    return float(np.arccos(np.clip(hand.axis @ closing_motion.approach_direction(hand.closing), -1, 1)))


AXIS_OFF = np.radians(35.0)  # Angle between approach axis and fingers from which it is noted [rad]
PALM_OFF, STANDOFF_OFF, JAW_OFF = 0.03, 0.02, 0.015
"""Tolerances of palm_offset, stand-off and jaw opening against the shapes [m]."""
SLOW = 1.05  # A joint is too slow if it needs more than this multiple of the closing time


def posture_notes(hand: HandPostures) -> tuple[str, ...]:
    """Return the notes on a gripper's file."""
    return (*_approach_notes(hand), *_jaw_notes(hand), *_closing_notes(hand))


def _approach_notes(hand: HandPostures) -> Iterator[str]:
    file, closing, angle = hand.file, hand.closing, approach_angle(hand)
    if bare := ", ".join(link for link in file.finger_links if link not in hand.body.parts):
        yield f"finger links without a collision shape, which touch nothing: {bare}"
    if LOOKS_AWAY >= angle > AXIS_OFF:
        axis = join_numbers(closing_motion.approach_direction(closing))
        yield f"approach_axis is {np.degrees(angle):.0f} degrees from where the fingers close, [{axis}]"
    if closing.fingers and (aside := closing_motion.axis_offset(closing, hand.axis)) > BESIDE:
        yield (
            f"the fingers close {1000 * aside:.0f} mm beside the line through the base link along the "
            "approach axis, which is where objects are: few grasps will be found, unless the base link is "
            "in the middle (`qdgrasp gripper new --repair` puts one there)"
        )
    surface, is_met = closing_motion.palm_surface(hand.body, hand.axis)
    if closing_motion.palm_links(hand.body) and is_met and abs(surface - file.palm_offset) > PALM_OFF:
        yield f"palm_offset is {file.palm_offset:g} m, and the palm's shapes end at {surface:.4g} m"
    if closing.fingers:
        far = closing_motion.finger_reach(closing, hand.axis) - file.palm_offset
        if file.standoff[1] > far + STANDOFF_OFF:
            reach = f"the fingers reach {far:.4g} m beyond the palm"
            yield f"standoff goes to {file.standoff[1]:g} m, and {reach}"


def _jaw_notes(hand: HandPostures) -> Iterator[str]:
    across = closing_motion.jaw_axis(hand.closing, hand.axis) if hand.closing.fingers else None
    jaw = hand.file.jaw
    if across is None or (gap := closing_motion.jaw_opening(hand.closing, hand.axis, across)) <= 0:
        return
    is_along = jaw is not None and abs(across @ unit_vector(jaw.axis)) >= np.cos(AXIS_OFF)
    if jaw is None or not is_along or abs(gap - jaw.opening) > JAW_OFF:
        yield (
            "two fingers oppose each other, for antipodal methods by their shapes with [jaw] "
            f"axis = [{join_numbers(across)}], opening = {gap:.4g}"
        )


def _closing_notes(hand: HandPostures) -> Iterator[str]:
    late = []
    for name, closed in hand.closing.closed.items():
        table, joint = hand.file.joints[name], hand.body.joint(name)
        velocity = joint.velocity if table.velocity is None else table.velocity
        time = abs(closed - table.open) / velocity if velocity > 0 else 0.0
        if time > SLOW * CLOSING_TIME:
            late.append(f"{name} needs {time:.2g} s")
    if late:
        yield (
            f"paper, released and robust with base paper close the hand for {CLOSING_TIME:.2f} s, in which "
            f"it does not close wholly: {', '.join(late)}; physical waits until it has closed"
        )


TOUCHING = 3e-3
"""Distance below which links count as overlapping [m]: Bullet adds 1 mm to each hull, and more."""
SAMPLED_POSTURES = 40
MOST_CLEAR = 2  # Largest number of postures in which links that overlap in nearly every one are apart
LinkPair = tuple[str, str]


def overlapping_pairs(hand: HandPostures) -> tuple[LinkPair, ...]:
    """Return the pairs of links that overlap when open, or in nearly every sampled posture.

    Their collisions are to be disabled, as MoveIt's setup does: an engine would push them apart before the
    hand has touched anything. A joint's parent and child are left out. Links that overlap in some postures
    only are not among them: these must collide.
    """
    joined = {frozenset((joint.parent, joint.child)) for joint in hand.body.robot.joints}
    pairs = [pair for pair in combinations(hand.body.parts, 2) if frozenset(pair) not in joined]
    opened = hand.body.parts_at(hand.posture(0.0))
    found = {pair for pair in pairs if _do_overlap(opened, pair)}
    clear = {pair: 0 for pair in pairs if pair not in found}
    for posture in sampled_postures(hand):
        if not clear:
            break
        placed = hand.body.parts_at(posture)
        clear = {pair: times + (not _do_overlap(placed, pair)) for pair, times in clear.items()}
        clear = {pair: times for pair, times in clear.items() if times <= MOST_CLEAR}
    return tuple(pair for pair in pairs if pair in found or pair in clear)


def sampled_postures(hand: HandPostures) -> Iterator[dict[str, float]]:
    """Yield seeded random postures: joints on their ways, free joints in their ranges.

    Joints that follow others are as far on their way as these.
    """
    random = np.random.default_rng(0)
    opened, closed = hand.closing.opened, hand.closing.closed
    for _ in range(SAMPLED_POSTURES):
        shares = {name: random.random() for name in opened}
        posture = {
            name: place + shares[hand.body.leader(name)] * (closed.get(name, place) - place)
            for name, place in opened.items()
        }
        genes = hand.file.free_joints.items()
        free = {name: each.low + random.random() * (each.high - each.low) for name, each in genes}
        yield {**posture, **free}


def _do_overlap(placed: dict[str, tuple[Hull, ...]], pair: LinkPair) -> bool:
    one, other = pair
    grown = [part.grown(TOUCHING) for part in placed[one]]
    return any(depth(first, second) > 0 for first, second in product(grown, placed[other]))
