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
from qdgrasp_assets.grippers.hand_model import Finger, HandModel, are_deep, with_followers
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
        return with_followers(self.body.robot, interpolate_posture(self.opened, self.closed, share))

    def tips(self, share: float) -> Floats:
        """Return the fingertips (f, 3) [m], base link's frame."""
        frames = self.body.robot.forward(self.posture(share))
        return np.array([finger.tip(frames) for finger in self.fingers]).reshape(-1, 3)

    def turning_axis(self, finger: Finger) -> Floats:
        """Return the unit axis (3,) about which a finger closes, outermost joint; zeros without one."""
        followed = {name: each.leader for name, each in self.body.followers.items()}
        names = [name for name in finger.joints if followed.get(name, name) in self.closed]
        joint = self.body.joint(names[-1]) if names else None
        if joint is None or joint.kind == "prismatic":
            return np.zeros(3)
        opened, closed = self.posture(0.0), self.posture(1.0)
        frame = self.body.robot.forward(opened)[joint.child][:3, :3]
        axis: Floats = np.sign(closed[joint.name] - opened[joint.name]) * (frame @ joint.axis)
        return axis

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
        return with_followers(self.body.robot, places)

    def _stop(self, moving: set[str], one: str, other: str, limit: float, step: tuple[float, float]) -> None:
        """Stop the fingers of two links within a step (low, high) of the way, before they meet."""
        low, high = step
        at = {name for name in moving if self.shares[name] > low and name not in self.told}
        stopping = {name for link in (one, other) for name in self._leaders(link) if name in at}
        if not stopping:
            return
        for _ in range(HALVINGS):
            middle = (low + high) / 2
            placed = self.body.parts_at(self._posture(moving, middle), (one, other))
            low, high = (low, middle) if are_deep(placed[one], placed[other], limit) else (middle, high)
        for name in sorted(stopping):
            self.shares[name] = low
            self.reasons[name] = f"closes to where '{one}' meets '{other}', at {100 * low:.0f} % of its range"

    def _leaders(self, link: str) -> Iterator[str]:
        """Yield the joints that close the finger of a link."""
        for finger in self.closing.fingers:
            if link in finger.links:
                yield from closing_leaders(self.body, finger, self.closing.closed)


def closing_leaders(body: HandModel, finger: Finger, closed: Mapping[str, float]) -> tuple[str, ...]:
    """Return the joints of `closed` that move a finger, also those that its joints follow."""
    leaders = [body.followers[name].leader if name in body.followers else name for name in finger.joints]
    return tuple(dict.fromkeys(name for name in leaders if name in closed))


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
