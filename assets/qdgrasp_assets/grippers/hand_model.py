"""Geometric model of a hand: joints, placed convex parts, base link and fingers.

Each joint that follows another by URDF's <mimic> is driven to its leader's target; engines couple the two.

The base is the link with several moving limbs, and not an arm's. Fingers are the limbs that
move, with the tip of each; limbs of one linkage are one finger. Opposite to a single limb that moves, those
that are fixed to the palm are fingers too.
"""

import xml.etree.ElementTree as ET
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import combinations, takewhile
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from qdgrasp_assets.geometry.mesh import Floats, unreadable_as
from qdgrasp_assets.geometry.voxels import Hull, convex_hulls
from qdgrasp_assets.grippers.collision_shapes import collision_elements, collision_shape, part_corners
from qdgrasp_assets.grippers.hand_geometry import neighbours, rigid_pieces
from qdgrasp_assets.grippers.urdf import Urdf, UrdfJoint, scene_robot
from qdgrasp_assets.scene import SceneGripper

Position = TypeVar("Position", float, Floats)


@dataclass(frozen=True)
class MimicJoint:
    """A joint whose position is `multiplier` times its leader's, plus `offset`."""

    leader: str
    """A joint that does not follow another."""
    multiplier: float
    offset: float
    """Position at the leader's zero [rad or m]."""

    def position(self, leader: Position) -> Position:
        """Return its position where its leader is at `leader` [rad or m]."""
        return self.multiplier * leader + self.offset


def followers(robot: Urdf) -> dict[str, MimicJoint]:
    """Return the joints of a robot that follow other moving joints, by name."""
    mimics = {
        joint.get("name", ""): MimicJoint(
            mimic.get("joint", ""), float(mimic.get("multiplier", "1")), float(mimic.get("offset", "0"))
        )
        for joint in robot.element.findall("joint")
        if (mimic := joint.find("mimic")) is not None
    }
    moving = {joint.name for joint in robot.joints if joint.moves}
    found = {name: _root_leader(name, mimics) for name in mimics if name in moving}
    return {name: follower for name, follower in found.items() if follower.leader in moving - {name}}


def couplings(robot: Urdf, gripper: SceneGripper) -> dict[str, MimicJoint]:
    """Return the joints that a belt or gears couple to others that close with them, by name.

    The joints of a jaw close by the same share; others follow where the URDF says that they mimic.
    """
    driven = {joint.name: joint for joint in gripper.joints if joint.driven and joint.opened != joint.closed}
    if not gripper.jaw:
        found = followers(robot).items()
        return {name: each for name, each in found if {name, each.leader} <= driven.keys()}
    first, *others = driven.values()
    ratios = [(joint.closed - joint.opened) / (first.closed - first.opened) for joint in others]
    return {
        joint.name: MimicJoint(first.name, ratio, joint.opened - ratio * first.opened)
        for joint, ratio in zip(others, ratios, strict=True)
    }


def coupling_errors(gripper: SceneGripper, postures: NDArray[np.float32]) -> Floats:
    """Return how far coupled joints are off in postures (n, j): (joints, n) [rad or m]."""
    joints = {joint.name: column for joint, column in zip(gripper.joints, postures.T, strict=True)}
    found = couplings(scene_robot(gripper), gripper).items()
    errors = [joints[name] - each.position(joints[each.leader]) for name, each in found]
    return np.abs(np.reshape(errors, (len(errors), len(postures))))


def coupling_error(gripper: SceneGripper, postures: NDArray[np.float32]) -> float | None:
    """Return the greatest of these errors; None: no joint is coupled."""
    errors = coupling_errors(gripper, postures)
    return float(errors.max(initial=0.0)) if len(errors) else None


MOST_LEFT_OUT = 0.5
"""Share of the way of a joint that follows another above which its own limits must be wrong."""


def contradicted_limits(robot: Urdf) -> dict[str, tuple[float, float]]:
    """Return the way [rad or m] of each follower that its own limits mostly forbid, by name."""
    joints = {joint.name: joint for joint in robot.joints}
    found = {}
    for name, each in followers(robot).items():
        leader, own = joints[each.leader], joints[name]
        low, high = sorted((each.position(leader.lower), each.position(leader.upper)))
        allowed = min(high, own.upper) - max(low, own.lower)
        if low < high and own.lower < own.upper and allowed < (1 - MOST_LEFT_OUT) * (high - low):
            found[name] = (low, high)
    return found


def _root_leader(name: str, mimics: Mapping[str, MimicJoint]) -> MimicJoint:
    """Resolve a chain of followers to the joint that leads it."""
    follower, seen = mimics[name], {name}
    while follower.leader in mimics and follower.leader not in seen:
        seen.add(follower.leader)
        further = mimics[follower.leader]
        follower = MimicJoint(
            further.leader, follower.multiplier * further.multiplier, follower.position(further.offset)
        )
    return follower


def is_deep(one: Hull, other: Hull, limit: float) -> bool:
    """Return whether the largest ball in two parts has a diameter of at least `limit` [m].

    Most pairs are decided without the linear programme of `depth`: where all corners of one are within
    `limit` of a plane of the other, or before it, no such ball fits between.
    """
    if (np.minimum(one.high, other.high) - np.maximum(one.low, other.low) < limit).any():
        return False
    for first, second in ((one, other), (other, one)):
        heights = (first.normals @ second.ends.T).min(axis=1) + first.planes[:, 3]
        if (heights > -limit).any():
            return False
    return depth(one, other) >= limit


def depth(one: Hull, other: Hull) -> float:
    """Return the diameter of the largest ball that is in two parts [m]; 0 where they are apart."""
    if (one.low > other.high).any() or (other.low > one.high).any():
        return 0.0
    from scipy.optimize import linprog  # takes a tenth of a second, and most commands look at no hand

    planes = np.concatenate([one.planes, other.planes])
    found = linprog(
        [0.0, 0.0, 0.0, -1.0],
        A_ub=np.column_stack([planes[:, :3], np.ones(len(planes))]),
        b_ub=-planes[:, 3],
        bounds=[(None, None)] * 3 + [(0.0, None)],
        method="highs",
    )
    return float(2 * found.x[3]) if found.x is not None else 0.0


def are_deep(ours: Iterable[Hull], theirs: Iterable[Hull], limit: float) -> bool:
    """Return whether any of our parts is at least `limit` deep in any of theirs [m]."""
    theirs = tuple(theirs)
    return any(is_deep(one, other, limit) for one in ours for other in theirs)


def ray_exit(parts: Iterable[Hull], direction: Floats) -> float | None:
    """Return the distance along `direction` (3,) at which a ray leaves the last part [m].

    The ray starts at the origin; None where it meets no part. It is in a part between the last plane that it
    enters through and the first that it leaves through.
    """
    exits = []
    for part in parts:
        slopes, heights = part.planes[:, :3] @ direction, part.planes[:, 3]
        with np.errstate(divide="ignore", invalid="ignore"):
            ways = -heights / slopes
        enters = max(ways[slopes < 0], default=-np.inf)
        leaves = min(ways[slopes > 0], default=np.inf)
        is_beside = bool((heights[slopes == 0] > 0).any())
        if not (is_beside or enters > leaves or leaves < 0):
            exits.append(float(leaves))
    return max(exits, default=None)


@dataclass(frozen=True)
class HandModel:
    """A hand's links, joints and convex parts."""

    robot: Urdf
    """URDF from the base link outward."""
    parts: Mapping[str, tuple[Hull, ...]]
    """The convex parts of each link, link frame; links without any are left out."""

    @cached_property
    def moving(self) -> tuple[str, ...]:
        """Moving joints in the order of the file."""
        return tuple(joint.name for joint in self.robot.joints if joint.moves)

    @cached_property
    def followers(self) -> dict[str, MimicJoint]:
        """The joints that follow others."""
        return followers(self.robot)

    def with_followers(self, positions: Mapping[str, Position]) -> dict[str, Position]:
        """Return the positions of leaders [rad or m], and those of their followers."""
        known = {name: each for name, each in self.followers.items() if each.leader in positions}
        return {**positions, **{name: each.position(positions[each.leader]) for name, each in known.items()}}

    def leader(self, name: str) -> str:
        """Return the joint that a joint follows; itself if it follows none."""
        return self.followers[name].leader if name in self.followers else name

    @cached_property
    def rigid_piece(self) -> dict[str, str]:
        """First link of the rigid piece of each link."""
        return rigid_pieces(self.robot.element)

    @cached_property
    def _neighbours(self) -> set[tuple[str, str]]:
        return neighbours(self.robot)

    def are_neighbours(self, one: str, other: str) -> bool:
        """Return whether two links are of one rigid piece, or of two that a joint connects."""
        return one == other or (min(one, other), max(one, other)) in self._neighbours

    def parts_at(
        self, posture: Mapping[str, float], links: Iterable[str] | None = None
    ) -> dict[str, tuple[Hull, ...]]:
        """Return the parts of some links, or of all, base link's frame; `posture` names followers."""
        frames = self.robot.forward(posture)
        return {
            link: tuple(part.moved(frames[link]) for part in self.parts[link])
            for link in (self.parts if links is None else links)
        }

    def corners(self, links: Iterable[str], posture: Mapping[str, float]) -> Floats:
        """Return all corners (n, 3) [m] of some links, base link's frame."""
        placed = self.parts_at(posture, [link for link in links if link in self.parts])
        found = [part.surface.vertices for parts in placed.values() for part in parts]
        return np.concatenate([np.zeros((0, 3)), *found])

    def joint(self, name: str) -> UrdfJoint:
        """Return the joint of this name, which must be one of the hand's."""
        return next(joint for joint in self.robot.joints if joint.name == name)

    def range(self, name: str) -> tuple[float, float]:
        """Return a joint's limits [rad or m]; without limits +-pi/2, or +-0.05 m if prismatic."""
        joint = self.joint(name)
        if joint.kind != "continuous" and joint.lower < joint.upper:
            return joint.lower, joint.upper
        return (-np.pi / 2, np.pi / 2) if joint.kind != "prismatic" else (-0.05, 0.05)


def read_hand_model(robot: Urdf, base: str) -> HandModel:
    """Read the hand that begins with link `base`; errors as in `collision_corners`."""
    hand = robot.subtree(base)
    parts: dict[str, tuple[Hull, ...]] = {}
    for link, collision in collision_elements(hand):
        if hulls := convex_hulls(collision_corners(hand, link, collision)):
            parts[link] = (*parts.get(link, ()), *hulls)
    return HandModel(hand, parts)


def collision_corners(robot: Urdf, link: str, collision: ET.Element) -> tuple[Floats, ...]:
    """Return the corners (v, 3) of a collision shape's convex parts [m], link frame.

    Raises `AssetError` if its mesh is missing, cannot be read, or is empty; or its form is none of URDF's.
    """
    names = [mesh.get("filename", "") for mesh in collision.iter("mesh")]
    files = {name: robot.mesh(name) for name in names}
    advice = "save its mesh as a binary STL or an OBJ file"
    with unreadable_as("a collision shape of the link '{}' cannot be read ({}); " + advice, link):
        found = tuple(part_corners(robot, collision, files))
        return found or tuple(each.vertices for each in collision_shape(robot, link, collision, files))


LARGEST_HAND = 0.5  # A hand's joints are not farther apart than this [m]
MOST_OF_FINGER = 3  # Most joints of a hand's only finger: a longer chain is an arm with a jaw


def guess_base(robot: Urdf) -> tuple[str, str, list[str]]:
    """Return the link where a hand begins, the reason, and others where another hand begins.

    From each several moving limbs go out whose joints are near each other.
    """
    links = (robot.root, *(joint.child for joint in robot.joints_beyond(robot.root)))
    limbs = {link: moving_limbs(robot, link) for link in links}
    found = [link for link in links if len(limbs[link]) > 1 and _spread(robot, link) < LARGEST_HAND]
    if not found:
        parents = [joint.parent for joint in robot.joints_beyond(robot.root) if joint.moves]
        if len(parents) > MOST_OF_FINGER:
            return _rigid_root(robot, parents[-1]), "one jaw moves on it, at the end of an arm", []
        near = [link for link in parents if _spread(robot, link) < LARGEST_HAND]
        link = _rigid_root(robot, near[0]) if near else robot.root
        return link, "no link has several moving limbs; beyond this one all joints are near each other", []
    first = found[0]
    others = [other for other in found if other not in robot.subtree(first).links]
    more = f"; they also do from {', '.join(others)}, which --base-link may name" if others else ""
    innermost = next(link for link in reversed(found) if limbs[link] == limbs[first])
    return _rigid_root(robot, innermost), f"{len(limbs[first])} moving limbs go out from it{more}", others


def moving_limbs(robot: Urdf, base: str) -> tuple[str, ...]:
    """Return the moving joints on link `base`, or on links that are fixed to it."""
    fixed, found = {base}, []
    for joint in robot.joints_beyond(base):
        if joint.parent in fixed:
            if joint.moves:
                found.append(joint.name)
            else:
                fixed.add(joint.child)
    return tuple(found)


def _spread(robot: Urdf, base: str) -> float:
    """Return the largest side of the box around the joints beyond a link, joints at zero [m]."""
    hand = robot.subtree(base)
    places = np.array([frame[:3, 3] for frame in hand.forward({}).values()])
    return float(np.ptp(places, axis=0).max())


def _rigid_root(robot: Urdf, link: str) -> str:
    """Return the first link with a shape that `link` is fixed to, unless an arm carries it."""
    shaped = {
        each.get("name") for each in robot.element.findall("link") if each.find("collision") is not None
    }
    fixed = takewhile(lambda joint: not joint.moves, robot.inward(link))
    chain = [link, *(joint.parent for joint in fixed)]
    is_free = chain[-1] == robot.root
    return next((each for each in reversed(chain) if each in shaped), link) if is_free else link


TIP_SHARE = 0.1  # The tip is the corners within this share of a finger's greatest distance from its root


@dataclass(frozen=True)
class Finger:
    """Links that move together, and the points that count as their tip."""

    links: tuple[str, ...]
    """Links with collision shapes."""
    joints: tuple[str, ...]
    """Moving joints, outward; of a fixed finger, the joint that fixes it."""
    tips: tuple[tuple[str, Floats], ...]
    """Links with points (n, 3) of the tip [m], link frame."""

    def tip(self, frames: Mapping[str, Floats]) -> Floats:
        """Return the tip (..., 3) [m], in the frame of `frames` (..., 4, 4)."""
        middles = [
            len(points) * (frames[link][..., :3, :3] @ points.mean(axis=0) + frames[link][..., :3, 3])
            for link, points in self.tips
        ]
        return np.asarray(sum(middles) / sum(len(points) for _, points in self.tips))


def find_fingers(
    body: HandModel, postures: Iterable[dict[str, float]], roots: tuple[str, ...] = ()
) -> tuple[Finger, ...]:
    """Find a hand's fingers: limbs with shapes; those that overlap in all `postures` are one.

    With `roots`, the limbs that begin with these links are the fingers.
    """
    placed = [body.parts_at(posture) for posture in postures]
    if roots:
        arriving = {joint.child: joint.name for joint in body.robot.joints}
        return tuple(limb for link in roots if (limb := _limb(body, arriving[link])).links)
    fingers: list[Finger] = []
    for name in (*_finger_joints(body, body.robot.root, placed), *fixed_limbs(body)):
        limb = _limb(body, name)
        if limb.links:
            same = [finger for finger in fingers if _are_linked(finger, limb, placed)]
            fingers = [finger for finger in fingers if finger not in same] + [_joined(body, [*same, limb])]
    return tuple(fingers)


PINNED = 1e-6  # Depth from which limbs overlap that are pinned together [m]
Placed = list[dict[str, tuple[Hull, ...]]]
"""The parts of all links, base link's frame, in some postures."""


def _finger_joints(body: HandModel, base: str, placed: Placed) -> Iterator[str]:
    """Yield the joints on which limbs hang: on a palm, and on each part of it that moves.

    A moving link from which several limbs go out that are apart is a part of the palm.
    """
    for name in moving_limbs(body.robot, base):
        child = body.joint(name).child
        limbs = [limb for each in moving_limbs(body.robot, child) if (limb := _limb(body, each)).links]
        pairs = combinations(limbs, 2)
        if len(limbs) > 1 and not any(_are_linked(one, other, placed) for one, other in pairs):
            yield from _finger_joints(body, child, placed)
        else:
            yield name


def _are_linked(one: "Finger", other: "Finger", placed: Placed) -> bool:
    """Return whether two limbs overlap in all postures, as those that are pinned together do."""
    return all(
        are_deep(
            (part for link in one.links for part in parts[link]),
            (part for link in other.links for part in parts[link]),
            PINNED,
        )
        for parts in placed
    )


def fixed_limbs(body: HandModel) -> tuple[str, ...]:
    """Return the joints of fingers that are fixed to the palm, opposite to the only moving limb."""
    moving = [name for name in moving_limbs(body.robot, body.robot.root) if _limb(body, name).links]
    if len(moving) != 1:
        return ()
    first = body.joint(moving[0]).parent
    way = {first, *(joint.parent for joint in body.robot.inward(first))}
    beside = [joint for joint in body.robot.joints if joint.parent in way and joint.child not in way]
    return tuple(joint.name for joint in beside if not joint.moves and _limb(body, joint.name).links)


def _joined(body: HandModel, limbs: list[Finger]) -> Finger:
    """Join limbs to one finger, with the tip of the one that reaches farthest."""
    return replace(
        max(limbs, key=lambda limb: finger_length(body, limb)),
        links=tuple(link for limb in limbs for link in limb.links),
        joints=tuple(joint for limb in limbs for joint in limb.joints),
    )


def finger_root(body: HandModel, finger: Finger) -> Floats:
    """Return the position of a finger's first joint (3,) [m], base link's frame."""
    joint = body.joint(finger.joints[0])
    return (body.robot.forward({})[joint.parent] @ joint.origin)[:3, 3]


def finger_length(body: HandModel, finger: Finger) -> float:
    """Return the distance of a fingertip from its finger's root, joints at zero [m]."""
    return float(np.linalg.norm(finger.tip(body.robot.forward({})) - finger_root(body, finger)))


def _limb(body: HandModel, name: str) -> Finger:
    joint = body.joint(name)
    limb = body.robot.subtree(joint.child)
    links = tuple(link for link in limb.links if link in body.parts)
    joints = (name, *(each.name for each in body.robot.joints_beyond(joint.child) if each.moves))
    return Finger(links, joints, tuple(_tips(body, joint.child, links)))


def _tips(body: HandModel, first: str, links: tuple[str, ...]) -> Iterable[tuple[str, Floats]]:
    """Yield the corners farthest from a limb's root, link by link, joints at zero."""
    frames = body.robot.forward({})
    origin = frames[first][:3, 3]
    corners = {link: np.concatenate([part.surface.vertices for part in body.parts[link]]) for link in links}
    away = {
        link: np.linalg.norm(points @ frames[link][:3, :3].T + frames[link][:3, 3] - origin, axis=1)
        for link, points in corners.items()
    }
    least = (1 - TIP_SHARE) * max((distances.max() for distances in away.values()), default=0.0)
    for link, distances in away.items():
        if (distances >= least).any():
            yield link, corners[link][distances >= least]
