"""Search for the joints that close a hand, and the ends at which they are closed.

A hand closes well where little is left of the distances between its fingertips. So each way of closing is
judged by the share of the open hand's distances that is left on the way from open to closed. Outer joints
bend a finger and inner ones turn or spread it: the outermost joints of a finger close it, unless others bring
it much nearer. In a hand with a thumb, the thumb is turned to face the other fingers. `closing_motion`
decides how far fingers close before they meet.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import cached_property
from itertools import combinations, product
from typing import NamedTuple

import numpy as np

from qdgrasp_assets.geometry.mesh import Floats
from qdgrasp_assets.gripper_setup.closing_motion import (
    CROSSED,
    DEEP_OVERLAP,
    PARALLEL,
    ClosingMotion,
    Posture,
    mix,
    palm_links,
)
from qdgrasp_assets.grippers.hand_model import (
    Finger,
    HandModel,
    are_deep,
    find_fingers,
    finger_length,
    finger_root,
)

SHARE = 0.35  # A joint may close if it moves the fingertip by this share of the finger's largest motion
NEAR_ZERO = 0.5  # Zero is the open position if the open limit is at most this share of the range beyond it
WITHIN = 0.05  # A joint may stay at zero if that is this share of the range away from both limits
LOOKS = 7  # Number of positions tried for a joint that does not close
MOST_LOOKS = 400  # Largest number of postures of one finger's resting joints that are tried together
COURSE = np.linspace(0.0, 1.0, 13)  # Shares of the way from open to closed at which fingertips are compared
ROOT_WEIGHT = 0.1
"""Weight of the distances from fingertips to the middle of the roots, beside those between fingertips."""
MUCH_NEARER = 0.15
"""Share of the open distances that must be gained to turn a joint from zero, or to close by inner joints."""
CLEAR_SHARES = (0.0, 0.25, 0.5)  # Shares of the way at which a finger must be clear of the palm
TURN_WEIGHT = 0.5  # Badness of a thumb that turns at right angles to the other fingers
TURN_COST = 0.1  # Badness of a resting joint that is turned from its start by its whole range
MOST_COMBINATIONS = 64  # Largest number of combinations of closing directions that are tried
ONE_SIDED = 2.0  # A finger curls to the side on which its joints turn by more than this multiple
LEAST_CURL = np.radians(40.0)  # Least turn of the fingertip by which a finger curls
ROUNDS = 2  # Times that each finger is improved while the others stay
STAYS_REASON = "does not close"
TURNED_REASON = (
    "does not close; here the fingertips meet best as the hand closes, clear of what is beside them"
)


@dataclass(frozen=True)
class JointGroup:
    """Joints of one finger with parallel axes, which close or open together."""

    finger: Finger
    joints: tuple[str, ...]
    senses: tuple[float, ...]
    """Sign of each joint's axis relative to the first one's: +1 same way, -1 opposite."""


Choice = tuple[JointGroup, float]
"""A group that closes, and the end of its range, 0 or 1, at which it is closed."""


class FingerChoice(NamedTuple):
    """A finger's choice with the place of its other joints."""

    choice: Choice
    badness: float
    """0 is best: share of the distances that is left, or how badly a thumb opposes."""
    resting: Posture


class ClosingSearch:
    """A hand whose joints are moved to see how near its fingertips come to each other."""

    def __init__(self, body: HandModel, roots: tuple[str, ...], still: tuple[str, ...]) -> None:
        """`roots` are the links that begin fingers, empty: found; joints in `still` do not close."""
        self.body = body
        self.leaders = [name for name in body.moving if name not in body.followers]
        postures = [
            body.with_followers({name: mix(*body.range(name), share) for name in self.leaders})
            for share in (0.0, 0.5, 1.0)
        ]
        self.fingers = find_fingers(body, postures, roots)
        movable = [name for name in self.leaders if name not in still]
        self.groups = tuple(_groups(body, self.fingers, movable))
        in_fingers = {name for finger in self.fingers for name in finger.joints} - set(still)
        self.resting = {
            name: self._start(name) if name in in_fingers else self._zero(name) for name in self.leaders
        }
        self.reasons = dict.fromkeys(self.leaders, STAYS_REASON)
        self.choices: dict[int, Choice] = {}
        self.rows: tuple[frozenset[int], ...] = ()
        """Fingers that turn the same way, by number."""

    def find(self) -> ClosingMotion:
        """Return the motion that leaves least of the fingertips' distances."""
        for number, finger in enumerate(self.fingers):
            if groups := self._bending_groups(finger):
                self.choices[number] = (groups[-1], self._possible_ends(groups[-1])[0])
        self._choose_ends()
        self.rows = self.motion(self.choices, self.resting).rows()
        for _ in range(ROUNDS):
            for number in self.choices:
                self._improve(number)
        return self.motion(self.choices, self.resting)

    def motion(self, choices: Mapping[int, Choice], resting: Mapping[str, float]) -> ClosingMotion:
        """Return the motion of these choices, from the limits of one end to those of the other."""
        closed: Posture = {}
        for group, end in choices.values():
            closed |= group_posture(self.body, group, end)
        opened = {
            name: 0.0
            if self._zero(name) == 0.0 and self._curls(group)
            else open_position(self.body, name, closed[name])
            for group, _ in choices.values()
            for name in group.joints
        }
        rest = {name: place for name, place in resting.items() if name not in closed}
        reasons = {name: reason for name, reason in self.reasons.items() if name not in closed}
        return ClosingMotion(self.body, self.fingers, {**rest, **opened}, closed, reasons)

    def left(self, choices: Mapping[int, Choice], resting: Mapping[str, float | Floats]) -> Floats:
        """Return the share of the open distances that is left on the way: (k,).

        It is the mean of the least share and of the average in the first half of the way, in which a hand
        that closes the wrong way round, behind itself, opens first.

        `resting` has positions [rad or m], or k of them, of joints that do not close.
        """
        frames = self._course(choices, resting)
        distances = self._distances([finger.tip(frames) for finger in self.fingers])
        shares = distances / np.maximum(distances[..., :1], 1e-6)
        return np.asarray((shares.min(axis=-1) + shares[..., : len(COURSE) // 2].mean(axis=-1)) / 2)

    def _course(
        self, choices: Mapping[int, Choice], resting: Mapping[str, float | Floats]
    ) -> dict[str, Floats]:
        """Return all links' frames (k, s, 4, 4) on the way from open to closed, base link's frame."""
        motion = self.motion(choices, self.resting)
        places = {
            **motion.opened,
            **{name: each for name, each in resting.items() if name not in motion.closed},
        }
        starts = {name: np.atleast_1d(place)[:, None] for name, place in places.items()}
        course = {
            name: start + COURSE * (motion.closed[name] - start) if name in motion.closed else start
            for name, start in starts.items()
        }
        return self.body.robot.forward(self.body.with_followers(course))

    def _distances(self, tips: list[Floats]) -> Floats:
        """Return the weighted sum of distances (k, s) [m] between fingertips, and to the roots.

        A single finger closes on the palm: its tip's distance to the shapes of the palm is taken.
        """
        if len(tips) == 1 and (palm := palm_links(self.body)):
            hulls = [part for parts in self.body.parts_at({}, palm).values() for part in parts]
            heights = [tips[0] @ hull.planes[:, :3].T + hull.planes[:, 3] for hull in hulls]
            return np.asarray(np.min([each.max(axis=-1) for each in heights], axis=0).clip(0.0))
        between = [np.linalg.norm(one - other, axis=-1) for one, other in combinations(tips, 2)]
        inward = [ROOT_WEIGHT * np.linalg.norm(tip - self._roots, axis=-1) for tip in tips]
        arrays = np.broadcast_arrays(*between, *inward, np.zeros((1, len(COURSE))))
        return np.asarray(np.sum(arrays, axis=0))

    def opposition(
        self, number: int, choices: Mapping[int, Choice], resting: Mapping[str, float | Floats]
    ) -> Floats:
        """Return how badly a thumb opposes the other fingers: (k,), 0 where it meets them.

        It is the mean over the others of the least distance of the two tips, each anywhere on its way, as a
        share of the thumb's length, plus a term for a thumb that does not turn against them.
        """
        frames = self._course(choices, resting)
        tips = [finger.tip(frames) for finger in self.fingers]
        least = [
            np.linalg.norm(tips[number][:, :, None] - tip[:, None], axis=-1).min(axis=(1, 2))
            for other, tip in enumerate(tips)
            if other != number
        ]
        turn = self._turn(number, choices, frames)
        others = [self._turn(each, choices, frames) for each in choices if each != number]
        cosines = [(turn * other).sum(axis=-1) for other in others] or [-np.ones(1)]
        against = 1 + np.mean(cosines, axis=0)
        length = max(finger_length(self.body, self.fingers[number]), 1e-3)
        return np.asarray(np.mean(least, axis=0) / length + TURN_WEIGHT * against)

    def _turn(self, number: int, choices: Mapping[int, Choice], frames: Mapping[str, Floats]) -> Floats:
        """Return the axis (k, 3) about which a finger's outermost joint closes, open hand."""
        group, end = choices[number]
        joint = self.body.joint(group.joints[-1])
        sense = group.senses[-1] * (1 if end else -1)
        return np.asarray(sense * (frames[joint.child][:, 0, :3, :3] @ joint.axis))

    @cached_property
    def _roots(self) -> Floats:
        """The middle of the fingers' roots (3,) [m]."""
        return np.asarray(np.mean([finger_root(self.body, finger) for finger in self.fingers], axis=0))

    def _start(self, name: str) -> float:
        """Return zero, or the middle of the range where zero is not well within it."""
        low, high = self.body.range(name)
        return 0.0 if self._may_rest_at_zero(name) else mix(low, high, 0.5)

    def _zero(self, name: str) -> float:
        """Return zero, or the limit next to it."""
        return float(np.clip(0.0, *self.body.range(name)))

    def _may_rest_at_zero(self, name: str) -> bool:
        low, high = self.body.range(name)
        return min(-low, high) > WITHIN * (high - low)

    def _bending_groups(self, finger: Finger) -> list[JointGroup]:
        """Return a finger's groups, outward, that move its tip far."""
        groups = [group for group in self.groups if group.finger is finger]
        number = self.fingers.index(finger)
        moved = []
        for group in groups:
            ends = [self.motion({number: (group, end)}, self.resting) for end in (0.0, 1.0)]
            moved.append(max(float(np.linalg.norm(each.tips(1.0)[number] - each.tips(0.0)[number]))
                             for each in ends))  # fmt: skip
        return [group for group, way in zip(groups, moved, strict=True) if way > SHARE * max(moved)]

    def _choose_ends(self) -> None:
        """Choose the closing directions of all fingers together, where ranges do not decide."""
        ends = {number: self._possible_ends(group) for number, (group, _) in self.choices.items()}
        if np.prod([len(each) for each in ends.values()]) > MOST_COMBINATIONS:
            return
        combined = [
            {number: (self.choices[number][0], end) for number, end in zip(ends, chosen, strict=True)}
            for chosen in product(*ends.values())
        ]
        self.choices = min(combined, key=lambda choices: float(self.left(choices, {})[0]), default={})

    def _possible_ends(self, group: JointGroup) -> tuple[float, ...]:
        """Return the ends at which a group may be closed.

        A finger of several joints is straight at zero and curls to the side on which its ranges are longer,
        if they are much longer there.
        """
        curls = self._curls(group)
        most = max(curls, key=curls.__getitem__, default=1.0)
        return (most,) if curls and curls[most] > ONE_SIDED * curls[1.0 - most] else (1.0, 0.0)

    def _curls(self, group: JointGroup) -> dict[float, float]:
        """Return the turn of the fingertip from zero to both ends [rad]; empty if it does not curl.

        A single joint does not curl a finger, nor do the joints of a linkage, of which one turns back.
        """
        way = [joint.name for joint in self.body.robot.inward(group.finger.tips[0][0])]
        chain = [name for name in reversed(way) if name in group.finger.joints]
        axes = _joint_axes(self.body, {*chain, *group.joints})
        along = {name: float(axes[name] @ axes[group.joints[0]]) for name in chain}
        turning = {name: float(np.sign(cosine)) for name, cosine in along.items() if abs(cosine) > PARALLEL}
        curls = {}
        for end in (1.0, 0.0):
            posture = self.body.with_followers(group_posture(self.body, group, end))
            curls[end] = abs(sum(sign * posture.get(name, 0.0) for name, sign in turning.items()))
        return curls if len(turning) > 1 and max(curls.values()) > LEAST_CURL else {}

    def _improve(self, number: int) -> None:
        """Choose a finger's closing joints, their direction, and the place of its other joints."""
        now = self.choices[number][0]
        others = [] if self._is_in_row(number) else self._bending_groups(self.fingers[number])
        groups = [now, *(group for group in others if group is not now)]
        found = [
            self._rested({**self.choices, number: (group, end)}, number)
            for group in groups
            for end in self._possible_ends(group)
        ]
        same = min((each for each in found if each.choice[0] is now), key=lambda each: each.badness)
        best = min(found, key=lambda each: each.badness)
        chosen = best if best.badness < same.badness - MUCH_NEARER else same
        self.choices[number] = chosen.choice
        self.resting |= chosen.resting
        self.reasons |= {
            name: TURNED_REASON if place else STAYS_REASON for name, place in chosen.resting.items()
        }

    def _is_in_row(self, number: int) -> bool:
        """Return whether a finger turns like others, beside some that do not."""
        return len(self.rows) > 1 and frozenset({number}) not in self.rows

    def _is_thumb(self, number: int) -> bool:
        """Return whether a finger turns unlike all others, among which some turn alike."""
        return frozenset({number}) in self.rows and max(map(len, self.rows)) > 1

    def _rested(self, choices: dict[int, Choice], number: int) -> "FingerChoice":
        """Return a finger's choice with the best place of those of its joints that do not close.

        The best place of a thumb brings it nearest to the other fingertips; that of another finger leaves
        least of the distances.
        """
        finger, (group, _) = self.fingers[number], choices[number]
        rest = [name for name in finger.joints if name in self.resting and name not in group.joints]
        plain = {name: self._start(name) for name in rest}
        if self._is_in_row(number):
            resting = self._spread(choices, number, plain)
            return FingerChoice(choices[number], float(self.left(choices, resting)[0]), resting)
        looks = max(3, min(LOOKS, int(MOST_LOOKS ** (1 / max(len(rest), 1)))))
        grid = [np.linspace(*self.body.range(name), looks) for name in rest]
        tried = np.array([[plain[name] for name in rest], *product(*grid)])
        places = {**plain, **dict(zip(rest, tried.T, strict=True))}
        if self._is_thumb(number):
            badness = self.opposition(number, choices, places)
        else:
            badness = np.atleast_1d(self.left(choices, places))
        spans = np.array([np.ptp(self.body.range(name)) for name in rest])
        turned = (np.abs(tried - tried[0]) / spans).sum(axis=1)
        scores = badness + TURN_COST * turned
        order = np.argsort(scores, kind="stable").tolist()
        may_stay = not self._is_thumb(number) and all(map(self._may_rest_at_zero, rest))
        if may_stay and scores[order[0]] > scores[0] - MUCH_NEARER:
            order = [0, *order]
        for best in (*order, order[0]):
            resting = {**plain, **dict(zip(rest, tried[best].tolist(), strict=True))}
            if not rest or self._is_clear(number, choices, resting):
                break
        return FingerChoice(choices[number], float(scores[best]), resting)

    def _is_clear(self, number: int, choices: dict[int, Choice], resting: Posture) -> bool:
        """Return whether an open finger is in neither palm nor other fingers.

        Neighbours of its links are left out. It may not be in the palm on the first half of its way either.
        """
        motion = self.motion(choices, {**self.resting, **resting})
        links = self.fingers[number].links
        for share in CLEAR_SHARES:
            placed = self.body.parts_at(motion.posture(share))
            palm = (each for each in placed if self.body.rigid_piece[each] == self.body.robot.root)
            others = [each for each in (palm if share else placed) if each not in links]
            pairs = [pair for pair in product(links, others) if not self.body.are_neighbours(*pair)]
            if any(are_deep(placed[link], placed[other], DEEP_OVERLAP) for link, other in pairs):
                return False
        followed = {name for name, each in self.body.followers.items() if each.leader in resting}
        children = [self.body.joint(joint).child for joint in followed]
        moved = {link for child in children for link in self.body.robot.subtree(child).links}
        beyond = {other for other, each in enumerate(self.fingers) if moved & set(each.links)} - {number}
        return all(self._is_beside_others(each, motion) for each in beyond)

    def _spread(self, choices: dict[int, Choice], number: int, plain: Posture) -> Posture:
        """Return joints of a finger at zero, or half-way if it is in its neighbours there."""
        zeros = {name: self._zero(name) for name in plain}
        motion = self.motion(choices, {**self.resting, **zeros})
        return zeros if self._is_beside_others(number, motion) else plain

    def _is_beside_others(self, number: int, motion: ClosingMotion) -> bool:
        """Return whether a finger closes beside those of its row, and not through them."""
        row = next(row for row in self.rows if number in row)
        beside = [link for other in row if other != number for link in self.fingers[other].links]
        for share in (*CLEAR_SHARES, 1.0):
            placed = self.body.parts_at(motion.posture(share))
            ours = [part for link in self.fingers[number].links for part in placed[link]]
            if are_deep(ours, [part for link in beside for part in placed[link]], CROSSED):
                return False
        return True


def group_posture(body: HandModel, group: JointGroup, share: float) -> Posture:
    """Return a group's joints at a share of their ranges, in the first one's sense."""
    return {
        name: mix(*body.range(name), share if sense > 0 else 1 - share)
        for name, sense in zip(group.joints, group.senses, strict=True)
    }


def open_position(body: HandModel, name: str, closed: float) -> float:
    """Return the open position: the other limit, or for a hinge but a crank a zero near it."""
    low, high = body.range(name)
    other = low if closed > (low + high) / 2 else high
    is_crank = any(each.leader == name and each.multiplier < 0 for each in body.followers.values())
    is_rest = body.joint(name).kind != "prismatic" and low < 0 < high and not is_crank
    is_near = abs(other) <= NEAR_ZERO * (high - low) or np.isclose(low, -high)
    return 0.0 if is_rest and is_near else other


def _groups(body: HandModel, fingers: tuple[Finger, ...], leaders: Iterable[str]) -> Iterable[JointGroup]:
    """Yield the groups of leading joints, finger by finger, by their outermost joints.

    A leader that carries no finger, as a motor, is a group of the first finger that follows it.
    """
    axes = _joint_axes(body, leaders)
    turning = {name for name in axes if body.joint(name).kind != "prismatic"}
    carrying = {name for finger in fingers for name in finger.joints}
    for finger in fingers:
        followed = dict.fromkeys(map(body.leader, finger.joints))
        motors = [name for name in followed if name in axes and name not in carrying]
        carrying.update(motors)
        yield from (JointGroup(finger, (name,), (1.0,)) for name in motors)
        left = [name for name in finger.joints if name in axes]
        found = []
        while left:
            first = left[0]
            cosines = {name: axes[first] @ axes[name] for name in left}
            parallel = {name for name in left if {first, name} <= turning and abs(cosines[name]) > PARALLEL}
            own = tuple(name for name in left if name in parallel | {first})
            found.append(JointGroup(finger, own, tuple(float(np.sign(cosines[name])) for name in own)))
            left = [name for name in left if name not in own]
        yield from sorted(found, key=lambda group: finger.joints.index(group.joints[-1]))


def _joint_axes(body: HandModel, names: Iterable[str]) -> dict[str, Floats]:
    """Return the unit axes (3,) of joints at zero, base link's frame."""
    frames = body.robot.forward({})
    return {name: frames[body.joint(name).child][:3, :3] @ body.joint(name).axis for name in names}
