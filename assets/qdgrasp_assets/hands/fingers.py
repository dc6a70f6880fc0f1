"""The fingers of a hand: the limbs that move, with the tip of each; limbs of one linkage are one finger.

Opposite to a single limb that moves, those that are fixed to the palm are fingers too.
"""

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np

from qdgrasp_assets.hands.base import limbs
from qdgrasp_assets.hands.body import Body
from qdgrasp_assets.hands.overlap import Floats, Solid, depth

FARTHEST = 0.1
"""The tip is this share of a finger's corners, the farthest from its root."""


@dataclass(frozen=True)
class Finger:
    """Links that move together, and what counts as their tip."""

    links: tuple[str, ...]
    """Those with collision shapes."""
    joints: tuple[str, ...]
    """The joints that move, outward; of a finger that is fixed, the joint by which it is."""
    tips: tuple[tuple[str, Floats], ...]
    """Links with points (n, 3) of the tip [m], link frame."""

    def tip(self, frames: dict[str, Floats]) -> Floats:
        """Where the tip is (3,) [m], in the frame of `frames`."""
        points = [points @ frames[link][:3, :3].T + frames[link][:3, 3] for link, points in self.tips]
        middle: Floats = np.concatenate(points).mean(axis=0)
        return middle


def find_fingers(body: Body, postures: Iterable[dict[str, float]]) -> tuple[Finger, ...]:
    """The fingers of a hand; limbs that are in each other in all of some postures are one.

    A limb without collision shapes is none.
    """
    placed = [body.placed(posture) for posture in postures]
    fingers: list[Finger] = []
    for name in (*limbs(body.robot, body.robot.root), *fixed_limbs(body)):
        limb = _limb(body, name)
        if limb.links:
            same = [finger for finger in fingers if _are_one(finger, limb, placed)]
            fingers = [finger for finger in fingers if finger not in same] + [_joined(body, [*same, limb])]
    return tuple(fingers)


def fixed_limbs(body: Body) -> tuple[str, ...]:
    """The joints by which fingers are fixed to the palm: what is no way to the only limb that moves."""
    moving = [name for name in limbs(body.robot, body.robot.root) if _limb(body, name).links]
    if len(moving) != 1:
        return ()
    arriving = {joint.child: joint.parent for joint in body.robot.joints}
    way = [body.joint(moving[0]).parent]
    while way[-1] in arriving:
        way.append(arriving[way[-1]])
    beside = [joint for joint in body.robot.joints if joint.parent in way and joint.child not in way]
    return tuple(joint.name for joint in beside if not joint.moves and _limb(body, joint.name).links)


def _are_one(one: Finger, other: Finger, placed: Iterable[dict[str, tuple[Solid, ...]]]) -> bool:
    """Whether two limbs are in each other wherever they go: they are pinned together."""
    return all(
        depth(
            (part for link in one.links for part in parts[link]),
            (part for link in other.links for part in parts[link]),
        )
        for parts in placed
    )


def _joined(body: Body, limbs: list[Finger]) -> Finger:
    """Limbs as one finger, the tip being that of the one that reaches farthest."""
    frames = body.frames({})
    longest = max(limbs, key=lambda limb: float(np.linalg.norm(limb.tip(frames) - root(body, limb))))
    return replace(
        longest,
        links=tuple(link for limb in limbs for link in limb.links),
        joints=tuple(joint for limb in limbs for joint in limb.joints),
    )


def root(body: Body, finger: Finger) -> Floats:
    """Where a finger's first joint is (3,) [m], base link's frame."""
    joint = body.joint(finger.joints[0])
    place: Floats = (body.frames({})[joint.parent] @ joint.origin)[:3, 3]
    return place


def _limb(body: Body, name: str) -> Finger:
    joint = body.joint(name)
    limb = body.robot.subtree(joint.child)
    links = tuple(link for link in limb.links if link in body.parts)
    joints = (name, *(each.name for each in body.robot.outward(joint.child) if each.moves))
    return Finger(links, joints, tuple(_tips(body, joint.child, links)))


def _tips(body: Body, first: str, links: tuple[str, ...]) -> Iterable[tuple[str, Floats]]:
    """The corners that are farthest from the root of a limb, joints at zero."""
    frames = body.frames({})
    origin = frames[first][:3, 3]
    corners = {link: np.concatenate([part.corners for part in body.parts[link]]) for link in links}
    away = {
        link: np.linalg.norm(points @ frames[link][:3, :3].T + frames[link][:3, 3] - origin, axis=1)
        for link, points in corners.items()
    }
    if not away:
        return
    least = (1 - FARTHEST) * max(distances.max() for distances in away.values())
    for link, distances in away.items():
        if (distances >= least).any():
            yield link, corners[link][distances >= least]
