"""Inference of how a hand grasps: closing joints, pinches, motors, palm and jaw.

Closing is judged by the sum of the distances between fingertips, and from each to the middle of the
fingers' roots: a jaw closes where the former falls, a hand of long fingers where the latter does.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import cached_property
from itertools import combinations

import numpy as np

from qdgrasp_assets.geometry.mesh import Floats
from qdgrasp_assets.grippers.hand_model import (
    Finger,
    HandModel,
    find_fingers,
    finger_root,
    fixed_limbs,
    ray_exit,
    with_followers,
)

PARALLEL = 0.9  # The cosine from which on two axes are parallel
SHARE = 0.35  # A joint closes if its gain is at least this share of its finger's largest gain
STEP = 0.25  # Step from the middle of a joint's range in a trial, as a share of the range
NEAR_ZERO = 0.25  # Zero is the open position if the open limit is at most this share of the range beyond it
WITHIN = 0.05  # A joint may stay at zero if that is this share of the range away from both limits
LOOKS = 9  # Number of positions tried for a joint that does not close
WIDE_SPREAD = np.radians(60.0)
"""A joint about the approach axis that turns farther than this spreads the fingers."""
NEAREST_REASON = "does not close; here the fingertips are nearest to each other"
STAYS_REASON = "does not close"

Posture = dict[str, float]


@dataclass(frozen=True)
class JointGroup:
    """Joints of one finger with parallel axes, which close or open together."""

    finger: Finger
    joints: tuple[str, ...]
    senses: tuple[float, ...]
    """Sign of each joint's axis relative to the first one's: +1 same way, -1 opposite."""


@dataclass(frozen=True)
class ClosingMotion:
    """Open and closed positions of a hand's joints that follow no others."""

    body: HandModel
    fingers: tuple[Finger, ...]
    opened: Posture
    closed: Posture
    """Closed positions of the joints that close."""
    fixed_joints: Mapping[str, str]
    """Joints that do not close, with the reason for their position."""

    def posture(self, share: float) -> Posture:
        """Return the positions of all joints, followers too, between open (0) and closed (1)."""
        return with_followers(self.body.robot, interpolate_posture(self.opened, self.closed, share))

    def tips(self, share: float) -> Floats:
        """Return the fingertips (f, 3) [m], base link's frame."""
        frames = self.body.robot.forward(self.posture(share))
        return np.array([finger.tip(frames) for finger in self.fingers]).reshape(-1, 3)

    def spreads(self, axis: Floats) -> tuple[str, ...]:
        """Return the joints that turn fingers far about the approach axis (3,)."""
        first = [finger.joints[0] for finger in self.fingers]
        frames = self.body.robot.forward({})
        found = []
        for joint in (self.body.joint(name) for name in first if name in self.fixed_joints):
            direction = frames[joint.child][:3, :3] @ joint.axis
            is_parallel = joint.kind != "prismatic" and abs(direction @ axis) > PARALLEL
            if is_parallel and np.ptp(self.body.range(joint.name)) > WIDE_SPREAD:
                found.append(joint.name)
        return tuple(found)


class ClosingSearch:
    """A hand whose joints are moved to measure the distances of its fingertips."""

    def __init__(self, body: HandModel) -> None:
        self.body = body
        self.leaders = [name for name in body.moving if name not in body.followers]
        self.middle = self._posture_at(0.5)
        postures = [with_followers(body.robot, self._posture_at(share)) for share in (0.0, 0.5, 1.0)]
        self.fingers = find_fingers(body, postures)
        self.groups = tuple(_groups(body, self.fingers, self.leaders))

    def tip_distance(self, changed: Posture) -> float:
        """Return the sum of the distances [m] between fingertips, and to the middle of the roots.

        Joints that are not `changed` are half-way.
        """
        frames = self.body.robot.forward(with_followers(self.body.robot, {**self.middle, **changed}))
        tips = [finger.tip(frames) for finger in self.fingers]
        pairs = [*combinations(tips, 2), *((tip, self._roots) for tip in tips)]
        return float(sum(np.linalg.norm(one - other) for one, other in pairs))

    def closing_end(self, group: JointGroup) -> tuple[float, float]:
        """Return the end of its range, 0 or 1, at which a group is closed, and the gain [m]."""
        low, high = (self.tip_distance(group_posture(self.body, group, 0.5 + step)) for step in (-STEP, STEP))
        return (1.0, low - high) if high < low else (0.0, high - low)

    @cached_property
    def _roots(self) -> Floats:
        """The middle of the fingers' roots (3,) [m]."""
        middle: Floats = np.mean([finger_root(self.body, finger) for finger in self.fingers], axis=0)
        return middle

    def _posture_at(self, share: float) -> Posture:
        return {name: _mix(*self.body.range(name), share) for name in self.leaders}


def find_closing(body: HandModel) -> ClosingMotion:
    """Find the joints that close a hand: each finger's outermost, and those parallel to it."""
    search = ClosingSearch(body)
    ends = {group.joints: search.closing_end(group) for group in search.groups}
    closed: Posture = {}
    for finger in search.fingers:
        groups = [group for group in search.groups if group.finger is finger]
        most = max((ends[group.joints][1] for group in groups), default=0.0)
        # the outermost group with a large gain closes the finger
        for group in [each for each in groups if ends[each.joints][1] >= SHARE * most][-1:]:
            closed |= group_posture(body, group, ends[group.joints][0])
    opened = {name: _open_position(body, name, place) for name, place in closed.items()}
    resting = {name: _resting_position(search, name) for name in search.leaders if name not in closed}
    places = {name: place for name, (place, _) in resting.items()}
    reasons = {name: reason for name, (_, reason) in resting.items()}
    return ClosingMotion(body, search.fingers, {**opened, **places}, closed, reasons)


def interpolate_posture(opened: Posture, closed: Posture, share: float) -> Posture:
    """Return joints between open (0) and closed (1); those that do not close stay open."""
    return {name: _mix(place, closed.get(name, place), share) for name, place in opened.items()}


def group_posture(body: HandModel, group: JointGroup, share: float) -> Posture:
    """Return a group's joints at a share of their ranges, in the first one's sense."""
    return {
        name: _mix(*body.range(name), share if sense > 0 else 1 - share)
        for name, sense in zip(group.joints, group.senses, strict=True)
    }


def _mix(low: float, high: float, share: float) -> float:
    return float(low + share * (high - low))


def _open_position(body: HandModel, name: str, closed: float) -> float:
    """Return the open position: the other limit, or zero for a revolute joint where it is near."""
    low, high = body.range(name)
    other = low if closed == high else high
    is_rest = body.joint(name).kind != "prismatic" and low < 0 < high
    is_near = abs(other) <= NEAR_ZERO * (high - low) or np.isclose(low, -high)
    return 0.0 if is_rest and is_near else other


def _resting_position(search: ClosingSearch, name: str) -> tuple[float, str]:
    """Return position and reason for a joint that does not close: zero, or the best one tried."""
    low, high = search.body.range(name)
    if min(-low, high) > WITHIN * (high - low):
        return 0.0, STAYS_REASON
    places = [_mix(low, high, share) for share in np.linspace(0, 1, LOOKS)]
    return min(places, key=lambda place: search.tip_distance({name: place})), NEAREST_REASON


def _groups(body: HandModel, fingers: tuple[Finger, ...], leaders: Iterable[str]) -> Iterable[JointGroup]:
    """Yield the groups of leading joints, finger by finger, outward."""
    frames = body.robot.forward({})
    axes = {name: frames[body.joint(name).child][:3, :3] @ body.joint(name).axis for name in leaders}
    turning = {name for name in axes if body.joint(name).kind != "prismatic"}
    for finger in fingers:
        left = [name for name in finger.joints if name in axes]
        while left:
            first = left[0]
            cosines = {name: axes[first] @ axes[name] for name in left}
            parallel = {name for name in left if {first, name} <= turning and abs(cosines[name]) > PARALLEL}
            own = tuple(name for name in left if name in parallel | {first})
            yield JointGroup(finger, own, tuple(float(np.sign(cosines[name])) for name in own))
            left = [name for name in left if name not in own]


FEWEST_FINGERS = 3  # Least number of fingers of a hand with a thumb
SAME_TURN = 0.8  # Cosine above which two fingers turn the same way


def pinches(closing: ClosingMotion) -> tuple[dict[str, tuple[str, ...]], str]:
    """Return the thumb, which turns unlike all others, with each finger, and all; or empty."""
    fingers = closing.fingers
    turns = np.array([_turning_axis(closing, finger) for finger in fingers]).reshape(-1, 3)
    alike = turns @ turns.T > SAME_TURN
    lonely = [number for number, row in enumerate(alike) if row.sum() == 1]
    are_others_alike = alike.sum() == (len(turns) - 1) ** 2 + 1
    if len(fingers) < FEWEST_FINGERS or len(lonely) != 1 or not are_others_alike:
        return {}, ""
    joints = [_closing_joints(closing, finger) for finger in fingers]
    thumb = lonely[0]
    others = [names for number, names in enumerate(joints) if number != thumb]
    synergies = {f"thumb_{number}": joints[thumb] + names for number, names in enumerate(others, 1)}
    synergies["all"] = tuple(name for names in joints for name in names)
    reason = f"the thumb ({fingers[thumb].links[-1]}) with each other finger, and all together"
    return synergies, reason


def _turning_axis(closing: ClosingMotion, finger: Finger) -> Floats:
    """Return the unit axis (3,) of a finger's outermost closing joint; zeros without one."""
    body, names = closing.body, [name for name in finger.joints if name in closing.closed]
    joint = body.joint(names[-1]) if names else None
    if joint is None or joint.kind == "prismatic":
        return np.zeros(3)
    sense = np.sign(closing.closed[joint.name] - closing.opened[joint.name])
    turn: Floats = sense * (body.robot.forward(closing.posture(0.0))[joint.child][:3, :3] @ joint.axis)
    return turn


def _closing_joints(closing: ClosingMotion, finger: Finger) -> tuple[str, ...]:
    followers = closing.body.followers
    return tuple(
        name
        for name in finger.joints
        if name in closing.closed or (name in followers and followers[name].leader in closing.closed)
    )


CLOSING_TIME = 100 / 240  # Duration of the closing of the hand in an evaluation [s] (docs/protocols.md)
STRONGEST_EFFORT = {True: 200.0, False: 2000.0}
"""Largest plausible effort: revolute joints (True) [Nm], prismatic joints (False) [N]."""
USUAL_EFFORT = {True: 20.0, False: 100.0}  # Effort of joints whose URDF states 0 or too much [Nm, N]


def joint_motor(
    body: HandModel, name: str, travel: float
) -> tuple[float | None, float | None, tuple[str, ...]]:
    """Return effort, velocity (None: the URDF's) [Nm or N, rad/s or m/s], and the reasons.

    `travel` is from open to closed [rad or m].
    """
    joint, effort, velocity, notes = body.joint(name), None, None, []
    turns = joint.kind != "prismatic"
    if not 0 < joint.effort <= STRONGEST_EFFORT[turns]:
        effort = USUAL_EFFORT[turns]
        notes.append(f"the URDF's effort would be {joint.effort:g} {'Nm' if turns else 'N'}")
    if joint.velocity * CLOSING_TIME < travel or joint.velocity <= 0:
        velocity = round(max(1.25 * travel / CLOSING_TIME, 0.1), 2)
        unit = "rad/s" if turns else "m/s"
        notes.append(f"{joint.velocity:g} {unit}, as in the URDF, would not close it in {CLOSING_TIME:.2f} s")
    return effort, velocity, tuple(notes)


HALF_CLOSED = (0.5, 0.75)  # Shares of the way from open to closed at which fingertips are averaged
CLOSING_SHARES = (0.0, 0.25, 0.5, 0.75, 1.0)
SNAP_COSINE = np.cos(np.radians(25.0))
"""Cosine above which a direction is taken for the nearest axis of the frame."""
SHORT = 5e-3  # Least distance from roots to tips that gives a direction [m]
PAD = 0.35  # Share of the fingers' reach, from the tips on, over which inner sides face each other


def grasp_centre(closing: ClosingMotion) -> Floats:
    """Return the middle of the fingertips of the half closed hand (3,) [m], base link's frame."""
    centre: Floats = np.mean([closing.tips(share).mean(axis=0) for share in HALF_CLOSED], axis=0)
    return centre


def approach_direction(closing: ClosingMotion) -> Floats:
    """Return the unit approach direction (3,) from `closing_way`, snapped to a near axis."""
    return snap_to_axis(closing_way(closing)[0])


def closing_way(closing: ClosingMotion) -> tuple[Floats, str]:
    """Return the vector (3,) [m] along which objects come between the fingers, and its origin.

    From the fingers' roots to the tips of the half closed hand. Where this is too short, because joints
    lie in the middle of the fingers, or one finger is fixed: from the middle of the palm to that of the
    fingers.
    """
    roots = np.mean([finger_root(closing.body, finger) for finger in closing.fingers], axis=0)
    outward = grasp_centre(closing) - roots
    # the links on which the fingers hang; where these have no shapes, the whole palm
    parents = {closing.body.joint(finger.joints[0]).parent for finger in closing.fingers}
    links = palm_links(closing.body)
    palm = closing.body.corners([link for link in links if link in parents] or links, {})
    if not len(palm) or (np.linalg.norm(outward) >= SHORT and not fixed_limbs(closing.body)):
        return outward, "from the fingers' roots to the fingertips of the half closed hand"
    opened = closing.posture(0.0)
    fingers = [_box_middle(closing.body.corners(finger.links, opened)) for finger in closing.fingers]
    return np.mean(fingers, axis=0) - _box_middle(palm), "from the middle of the palm to that of the fingers"


def _box_middle(corners: Floats) -> Floats:
    """Return the middle (3,) of the box around corners (n, 3)."""
    middle: Floats = (corners.min(axis=0) + corners.max(axis=0)) / 2
    return middle


def snap_to_axis(direction: Floats) -> Floats:
    """Return the unit vector of a direction (3,), or the axis next to it."""
    length = np.linalg.norm(direction)
    unit = direction / length if length else np.array([0.0, 0.0, 1.0])
    largest = int(np.abs(unit).argmax())
    axis = np.zeros(3)
    axis[largest] = np.sign(unit[largest])
    return axis if abs(unit[largest]) >= SNAP_COSINE else unit.round(3)


def palm_links(body: HandModel) -> tuple[str, ...]:
    """Return the base link and links fixed to it, those with shapes that are not fingers."""
    fixed = [body.robot.subtree(body.joint(name).child).links for name in fixed_limbs(body)]
    return tuple(
        link
        for link in body.parts
        if body.rigid_piece[link] == body.robot.root and not any(link in links for links in fixed)
    )


def palm_surface(body: HandModel, axis: Floats) -> tuple[float, bool]:
    """Return the palm's distance along the approach axis [m], and whether the axis meets it.

    Where the axis does not meet the palm, the palm's farthest point counts.
    """
    links = palm_links(body)
    found = ray_exit([part for parts in body.parts_at({}, links).values() for part in parts], axis)
    if found is not None:
        return max(found, 0.0), True
    return float((body.corners(links, {}) @ axis).max(initial=0.0)), False


def finger_reach(closing: ClosingMotion, axis: Floats) -> float:
    """Return the fingers' largest extent along the approach axis while they close [m]."""
    links = [link for finger in closing.fingers for link in finger.links]
    corners = [closing.body.corners(links, closing.posture(share)) for share in CLOSING_SHARES]
    return float((np.concatenate(corners) @ axis).max(initial=0.0))


def axis_offset(closing: ClosingMotion, axis: Floats) -> float:
    """Return the distance of the grasp centre from the approach line through the base link [m]."""
    centre = grasp_centre(closing)
    return float(np.linalg.norm(centre - (centre @ axis) * axis))


def jaw_axis(closing: ClosingMotion, axis: Floats) -> Floats | None:
    """Return the unit vector (3,) between two fingers that close, normal to the axis; else None."""
    if len(closing.fingers) != 2:
        return None
    opened, closed = closing.tips(0.0), closing.tips(0.5)
    moved = (closed - opened) - ((closed - opened) @ axis)[:, None] * axis
    if not moved[0] @ moved[1] < 0:
        return None
    between = moved[1] - moved[0]
    direction = snap_to_axis(between)
    direction = direction if abs(direction @ axis) < 1e-6 else between / np.linalg.norm(between)
    return np.abs(direction) if np.count_nonzero(direction) == 1 else direction


def jaw_opening(closing: ClosingMotion, axis: Floats, across: Floats) -> float:
    """Return the distance between the inner sides of two open fingers along `across` [m]."""
    reach = finger_reach(closing, axis)
    low = reach - PAD * (reach - palm_surface(closing.body, axis)[0])
    sides = []
    for finger in closing.fingers:
        corners = closing.body.corners(finger.links, closing.posture(0.0))
        heights = corners @ axis
        sides.append(corners[heights >= min(low, heights.max())] @ across)
    one, other = sorted(sides, key=np.mean)
    return float(max(other.min() - one.max(), 0.0))
