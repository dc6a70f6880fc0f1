"""The motion of a hand that closes: fingers, and open and closed positions of joints."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from qdgrasp_assets.geometry.mesh import Floats
from qdgrasp_assets.grippers.hand_model import Finger, HandModel, with_followers

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
