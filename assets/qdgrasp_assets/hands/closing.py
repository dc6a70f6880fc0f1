"""How a hand closes: which of its joints bring the fingertips together, and which way.

Judged by the sum of the distances between fingertips, and from each to the middle of the fingers' roots: a
jaw closes where the former falls, a hand of long fingers where the latter does.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import cached_property
from itertools import combinations

import numpy as np

from qdgrasp_assets.hands.body import Body
from qdgrasp_assets.hands.fingers import Finger, find_fingers, root
from qdgrasp_assets.hands.mimicry import followed
from qdgrasp_assets.hands.overlap import Floats
from qdgrasp_assets.urdf import UrdfJoint

ALIKE = 0.9
"""The cosine from which on two axes are parallel."""
SHARE = 0.35
"""Joints do much if they bring their finger this share as near as those that do most."""
STEP = 0.25
"""How far joints are moved from the middle of their ranges to see what it does."""
NEAR_ZERO = 0.25
"""An open limit may be this share of the range beyond zero; then zero is open."""
WITHIN = 0.05
"""Zero is a place to stay at where it is this share of the range away from both limits."""
LOOKS = 9
"""Places at which a joint that does not close is looked at."""
WIDE = np.radians(60.0)
"""A joint about the approach axis that turns farther than this spreads the fingers."""
NEAREST = "does not close; here the fingertips are nearest to each other"
STAYS = "does not close"

Posture = dict[str, float]


@dataclass(frozen=True)
class Group:
    """Joints of one finger with parallel axes, which close or open together."""

    finger: Finger
    joints: tuple[str, ...]
    senses: tuple[float, ...]
    """+1 where a joint's axis points as the first one's does, -1 where it points the other way."""


@dataclass(frozen=True)
class Closing:
    """How the joints of a hand that follow no others open and close."""

    body: Body
    fingers: tuple[Finger, ...]
    opened: Posture
    closed: Posture
    """Where those go that close."""
    stays: Mapping[str, str]
    """Those that do not close, with the reason why they are where they are."""

    def posture(self, share: float) -> Posture:
        """All joints, followers too, between open (0) and closed (1)."""
        return followed(self.body.robot, between(self.opened, self.closed, share))

    def tips(self, share: float) -> Floats:
        """(f, 3) [m]: the fingertips, base link's frame."""
        frames = self.body.frames(self.posture(share))
        return np.array([finger.tip(frames) for finger in self.fingers]).reshape(-1, 3)

    def spreads(self, axis: Floats) -> tuple[str, ...]:
        """Joints that turn fingers far about the approach axis (3,)."""
        first = [finger.joints[0] for finger in self.fingers]
        return tuple(name for name in first if name in self.stays and _spreads(self.body, name, axis))


class Trial:
    """A hand whose joints are tried: what follows from where they are put."""

    def __init__(self, body: Body) -> None:
        self.body = body
        self.leaders = [name for name in body.moving if name not in body.followers]
        self.middle = self._at(0.5)
        self.fingers = find_fingers(
            body, [followed(body.robot, self._at(share)) for share in (0.0, 0.5, 1.0)]
        )

    @cached_property
    def groups(self) -> tuple[Group, ...]:
        """The leaders finger by finger, outward."""
        return tuple(_groups(self.body, self.fingers, self.leaders))

    def apart(self, changed: Posture) -> float:
        """How far the fingertips are from each other, and from the middle of the roots, in all [m].

        Joints that are not `changed` are half-way.
        """
        frames = self.body.frames(followed(self.body.robot, {**self.middle, **changed}))
        tips = [finger.tip(frames) for finger in self.fingers]
        pairs = [*combinations(tips, 2), *((tip, self._roots) for tip in tips)]
        return float(sum(np.linalg.norm(one - other) for one, other in pairs))

    def end(self, group: Group) -> tuple[float, float]:
        """The share of its range, 0 or 1, toward which a group closes, and how much nearer tips come [m]."""
        low, high = (self.apart(at(self.body, group, 0.5 + step)) for step in (-STEP, STEP))
        return (1.0, low - high) if high < low else (0.0, high - low)

    @cached_property
    def _roots(self) -> Floats:
        """The middle of the fingers' roots (3,) [m]."""
        middle: Floats = np.mean([root(self.body, finger) for finger in self.fingers], axis=0)
        return middle

    def _at(self, share: float) -> Posture:
        return {name: _mix(*self.body.range(name), share) for name in self.leaders}


def find_closing(body: Body) -> Closing:
    """How a hand closes: the outermost joints of each finger, and those parallel to them."""
    trial = Trial(body)
    ends = {group.joints: trial.end(group) for group in trial.groups}
    closed = {
        name: place
        for group in trial.groups
        if _closes(group, trial.groups, {joints: gain for joints, (_, gain) in ends.items()})
        for name, place in at(body, group, ends[group.joints][0]).items()
    }
    opened = {name: _open(body, name, place) for name, place in closed.items()}
    staying = {name: _stay(trial, name) for name in trial.leaders if name not in closed}
    stays = {name: reason for name, (_, reason) in staying.items()}
    places = {name: place for name, (place, _) in staying.items()}
    return Closing(body, trial.fingers, {**opened, **places}, closed, stays)


def between(opened: Posture, closed: Posture, share: float) -> Posture:
    """Joints between open (0) and closed (1); those that do not close stay open."""
    return {name: _mix(place, closed.get(name, place), share) for name, place in opened.items()}


def at(body: Body, group: Group, share: float) -> Posture:
    """The joints of a group at a share of their ranges, in the sense of the first."""
    return {
        name: _mix(*body.range(name), share if sense > 0 else 1 - share)
        for name, sense in zip(group.joints, group.senses, strict=True)
    }


def _mix(low: float, high: float, share: float) -> float:
    return float(low + share * (high - low))


def _closes(group: Group, groups: Iterable[Group], gains: Mapping[tuple[str, ...], float]) -> bool:
    """Whether a group closes its finger: it is the outermost of those in it that do much."""
    same = [each for each in groups if each.finger is group.finger]
    most = max(gains[each.joints] for each in same)
    return group is [each for each in same if gains[each.joints] >= SHARE * most][-1]


def _open(body: Body, name: str, closed: float) -> float:
    """The other limit; for a joint that turns zero, where that is near it or in the middle."""
    low, high = body.range(name)
    other = low if closed == high else high
    is_rest = body.joint(name).kind != "prismatic" and low < 0 < high
    is_near = abs(other) <= NEAR_ZERO * (high - low) or np.isclose(low, -high)
    return 0.0 if is_rest and is_near else other


def _stay(trial: Trial, name: str) -> tuple[float, str]:
    """Where a joint stays that does not close, and why: at zero, or if that is a limit, at the best place."""
    low, high = trial.body.range(name)
    if min(-low, high) > WITHIN * (high - low):
        return 0.0, STAYS
    places = [_mix(low, high, share) for share in np.linspace(0, 1, LOOKS)]
    return min(places, key=lambda place: trial.apart({name: place})), NEAREST


def _groups(body: Body, fingers: tuple[Finger, ...], leaders: Iterable[str]) -> Iterable[Group]:
    frames = body.frames({})
    axes = {name: frames[body.joint(name).child][:3, :3] @ body.joint(name).axis for name in leaders}
    for finger in fingers:
        left = [name for name in finger.joints if name in axes]
        while left:
            first = left[0]
            own = [name for name in left if name == first or _alike(body, axes, first, name)]
            yield Group(finger, tuple(own), tuple(float(np.sign(axes[first] @ axes[name])) for name in own))
            left = [name for name in left if name not in own]


def _alike(body: Body, axes: Mapping[str, Floats], one: str, other: str) -> bool:
    """Whether both joints turn, about parallel axes."""
    return (
        _turns(body.joint(one)) and _turns(body.joint(other)) and bool(abs(axes[one] @ axes[other]) > ALIKE)
    )


def _turns(joint: UrdfJoint) -> bool:
    return joint.kind != "prismatic"


def _spreads(body: Body, name: str, axis: Floats) -> bool:
    joint = body.joint(name)
    direction = body.frames({})[joint.child][:3, :3] @ joint.axis
    return _turns(joint) and bool(abs(direction @ axis) > ALIKE and np.ptp(body.range(name)) > WIDE)
