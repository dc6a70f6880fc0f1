"""The motion of a hand that closes, and the first contacts of its fingers.

The links of one hand pass through each other in the simulator, so that fingers that close too far would hold
thin objects as no real hand can. Here a hand closes step by step, all fingers at the same share of their
way, first the whole hand and then each of its synergies. Fingers stop at their first contact.
"""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from itertools import combinations

import numpy as np

from qdgrasp_assets.geometry.mesh import Floats
from qdgrasp_assets.grippers.hand_model import (
    Finger,
    HandModel,
    are_deep,
    finger_root,
    fixed_limbs,
    ray_exit,
)
from qdgrasp_assets.scene import Synergy

PARALLEL = 0.9  # The cosine from which on two axes are parallel
SAME_TURN = 0.6  # Cosine above which two fingers turn the same way
WIDE_SPREAD = np.radians(60.0)
"""A joint about the approach axis that turns farther than this spreads the fingers."""
DEEP_OVERLAP = 2e-3  # Depth from which links overlap [m]; their hulls are larger than they are
CROSSED = 5e-3  # Depth from which links have gone through each other [m]

Posture = dict[str, float]
"""Positions of joints by name [rad or m]."""


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
    stopped: Mapping[str, str] = field(default_factory=dict)
    """Joints that close less far than they could, with the obstacle."""

    def posture(self, share: float) -> Posture:
        """Return the positions of all joints, followers too, between open (0) and closed (1)."""
        return self.body.with_followers(interpolate_posture(self.opened, self.closed, share))

    def tips(self, share: float) -> Floats:
        """Return the fingertips (f, 3) [m], base link's frame."""
        frames = self.body.robot.forward(self.posture(share))
        return np.array([finger.tip(frames) for finger in self.fingers]).reshape(-1, 3)

    def closing_joints(self, finger: Finger) -> tuple[str, ...]:
        """Return the joints of a finger that close, by themselves or after others, outward."""
        return tuple(name for name in finger.joints if self.body.leader(name) in self.closed)

    def turning_axis(self, finger: Finger) -> Floats:
        """Return the unit axis (3,) about which a finger closes, outermost joint; zeros without one."""
        names = self.closing_joints(finger)
        joint = self.body.joint(names[-1]) if names else None
        if joint is None or joint.kind == "prismatic":
            return np.zeros(3)
        opened, closed = self.posture(0.0), self.posture(1.0)
        frame = self.body.robot.forward(opened)[joint.child][:3, :3]
        return np.asarray(np.sign(closed[joint.name] - opened[joint.name]) * (frame @ joint.axis))

    def rows(self) -> tuple[frozenset[int], ...]:
        """Return the sets of fingers, by number, that turn the same way; a single one is a set too."""
        rows: list[frozenset[int]] = []
        turns = [self.turning_axis(finger) for finger in self.fingers]
        for number, turn in enumerate(turns):
            alike = [row for row in rows if any(turns[other] @ turn > SAME_TURN for other in row)]
            rows = [row for row in rows if row not in alike] + [frozenset({number}).union(*alike)]
        return tuple(rows)

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


def interpolate_posture(opened: Posture, closed: Posture, share: float) -> Posture:
    """Return joints between open (0) and closed (1); those that do not close stay open."""
    return {name: mix(place, closed.get(name, place), share) for name, place in opened.items()}


def mix(low: float, high: float, share: float) -> float:
    """Return the position at a share of the way from `low` to `high`."""
    return float(low + share * (high - low))


STEPS = np.linspace(0.0, 1.0, 21)[1:]
"""Shares of the way at which contacts are looked for: 1 cm of a finger of 0.15 m, which is as thick."""
HALVINGS = 6  # Times that the step in which fingers meet is halved
UNITS = {True: 1e-3, False: 1e-4}
"""Unit to which stop positions of fingers are rounded: revolute joints (True) [rad], prismatic ones [m]."""


def stop_at_contact(
    closing: ClosingMotion, synergies: Iterable[Synergy], told: Iterable[str]
) -> ClosingMotion:
    """Return the motion whose fingers stop where they meet.

    Joints in `told` close as stated. Links that are in each other in the open hand are left out.
    Two fingers that turn the same way may be `CROSSED` deep in each other at their sides, all others
    `DEEP_OVERLAP`.
    """
    contacts = _Contacts(closing, frozenset(told))
    contacts.close(closing.closed)
    for synergy in synergies:
        contacts.close(synergy.joints)
    stopped = {name: reason for name, reason in contacts.reasons.items() if contacts.shares[name] < 1.0}
    closed = {name: _toward(closing, name, contacts.shares[name]) for name in closing.closed}
    return replace(closing, closed=closed, stopped=stopped)


def _toward(closing: ClosingMotion, name: str, share: float) -> float:
    """Return a joint's position at a share of its way, rounded toward the open one."""
    opened, closed = closing.opened[name], closing.closed[name]
    if share >= 1.0:
        return closed
    unit = UNITS[closing.body.joint(name).kind != "prismatic"]
    way = np.floor(abs(closed - opened) * share / unit) * unit
    return float(round(opened + np.sign(closed - opened) * way, 6))


class _Contacts:
    """Fingers that close, with the shares of their ways."""

    def __init__(self, closing: ClosingMotion, told: frozenset[str]) -> None:
        self.closing, self.body = closing, closing.body
        self.shares = dict.fromkeys(closing.closed, 1.0)
        """How far each joint that closes may go, as a share of its way."""
        self.reasons: dict[str, str] = {}
        self.told = told
        self.pairs = tuple(_pairs(closing))

    def close(self, joints: Iterable[str]) -> None:
        """Close some joints, the others open, and stop those of fingers that meet something."""
        moving = {name for name in joints if name in self.shares}
        before = 0.0
        for share in STEPS:
            placed = self.body.parts_at(self._posture(moving, share))
            for one, other, limit in self.pairs:
                if are_deep(placed[one], placed[other], limit):
                    self._stop(moving, one, other, limit, (before, share))
                    placed = self.body.parts_at(self._posture(moving, share))
            before = share

    def _posture(self, moving: Iterable[str], share: float) -> Posture:
        """Return the posture at a share of the way, or as far as each joint may go."""
        opened, closed = self.closing.opened, self.closing.closed
        ways = {name: min(share, self.shares[name]) for name in moving}
        places = {
            name: place + ways.get(name, 0.0) * (closed.get(name, place) - place)
            for name, place in opened.items()
        }
        return self.body.with_followers(places)

    def _stop(self, moving: set[str], one: str, other: str, limit: float, step: tuple[float, float]) -> None:
        """Stop the fingers of two links within a step (low, high) of the way, before they meet."""
        low, high = step
        at = {name for name in moving if self.shares[name] > low and name not in self.told}
        stopping = {
            name
            for finger in self.closing.fingers
            if {one, other} & set(finger.links)
            for name in map(self.body.leader, finger.joints)
            if name in at
        }
        if not stopping:
            return
        for _ in range(HALVINGS):
            middle = (low + high) / 2
            placed = self.body.parts_at(self._posture(moving, middle), (one, other))
            low, high = (low, middle) if are_deep(placed[one], placed[other], limit) else (middle, high)
        for name in sorted(stopping):
            self.shares[name] = low
            self.reasons[name] = f"closes to where '{one}' meets '{other}', at {100 * low:.0f} % of its range"


def _pairs(closing: ClosingMotion) -> Iterator[tuple[str, str, float]]:
    """Yield the pairs of links that may meet, with the allowed depth [m]."""
    body, rows = closing.body, closing.rows()
    numbers = {link: number for number, finger in enumerate(closing.fingers) for link in finger.links}
    opened = body.parts_at(closing.posture(0.0))
    for one, other in combinations(body.parts, 2):
        first, second = numbers.get(one, -1), numbers.get(other, -2)
        if first == second or (first < 0 and second < 0) or body.are_neighbours(one, other):
            continue
        limit = CROSSED if any({first, second} <= row for row in rows) else DEEP_OVERLAP
        if not are_deep(opened[one], opened[other], DEEP_OVERLAP):
            yield one, other, limit


FEWEST_FINGERS = 3  # Least number of fingers of a hand with a thumb
FEWEST_OF_PALM = 4  # Least number of fingers, a thumb with them, of a hand that grasps with its palm


def pinches(closing: ClosingMotion) -> tuple[dict[str, tuple[str, ...]], str]:
    """Return the thumb, which turns unlike all others, with each finger, and all; or empty."""
    fingers, thumb = closing.fingers, thumb_number(closing)
    if thumb is None:
        return {}, ""
    joints = [closing.closing_joints(finger) for finger in fingers]
    others = [names for number, names in enumerate(joints) if number != thumb]
    synergies = {f"thumb_{number}": joints[thumb] + names for number, names in enumerate(others, 1)}
    synergies["all"] = tuple(name for names in joints for name in names)
    reason = f"the thumb ({fingers[thumb].links[-1]}) with each other finger, and all together"
    return synergies, reason


def thumb_number(closing: ClosingMotion) -> int | None:
    """Return the number of the finger that turns unlike all others, which turn alike; or None."""
    rows = closing.rows()
    lonely = [row for row in rows if len(row) == 1]
    if len(closing.fingers) < FEWEST_FINGERS or len(rows) != 2 or len(lonely) != 1:
        return None
    return next(iter(lonely[0]))


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
    # that of a single finger is half-way to where it is closed on the palm
    shares = HALF_CLOSED if len(closing.fingers) > 1 else (*HALF_CLOSED, 1.0, 1.0)
    return np.asarray(np.mean([closing.tips(share).mean(axis=0) for share in shares], axis=0))


def approach_direction(closing: ClosingMotion) -> Floats:
    """Return the unit approach direction (3,) from `closing_way`, snapped to a near axis."""
    return snap_to_axis(closing_way(closing)[0])


def closing_way(closing: ClosingMotion) -> tuple[Floats, str]:
    """Return the vector (3,) [m] along which objects come between the fingers, and its origin.

    For a hand with a thumb, it points to the side to which its other fingers bend; for others, from the
    fingers' roots to the tips of the half closed hand. Where this is too short, because joints lie in the
    middle of the fingers, or one finger is fixed: from the middle of the palm to that of the fingers.
    """
    normal = palm_normal(closing)
    if normal is not None:
        return normal, "the side of the palm to which the fingers beside the thumb bend"
    roots = np.mean([finger_root(closing.body, finger) for finger in closing.fingers], axis=0)
    if len(closing.fingers) == 1:
        return closing.tips(1.0)[0] - roots, "along the only finger, closed on the palm"
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


def palm_normal(closing: ClosingMotion) -> Floats | None:
    """Return the unit normal (3,) of the palm, as the fingers bend; None without a thumb.

    None also of a gripper whose two fingers oppose a third, as they stand on the rim of the palm. The normal
    is at right angles to the axes about which the fingers beside the thumb close, and to the open fingers.
    """
    thumb = thumb_number(closing)
    if thumb is None or len(closing.fingers) < FEWEST_OF_PALM:
        return None
    tips, frames = closing.tips(0.0), closing.body.robot.forward(closing.posture(0.0))
    others = [number for number in range(len(closing.fingers)) if number != thumb]
    turn = np.mean([closing.turning_axis(closing.fingers[number]) for number in others], axis=0)
    joints = [closing.body.joint(closing.fingers[number].joints[0]) for number in others]
    roots = [(frames[joint.parent] @ joint.origin)[:3, 3] for joint in joints]
    outward = np.mean([tips[number] - root for number, root in zip(others, roots, strict=True)], axis=0)
    normal = np.cross(turn, outward)
    return np.asarray(normal / np.linalg.norm(normal)) if np.linalg.norm(normal) > 0 else None


def _box_middle(corners: Floats) -> Floats:
    """Return the middle (3,) of the box around corners (n, 3)."""
    return np.asarray((corners.min(axis=0) + corners.max(axis=0)) / 2)


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
