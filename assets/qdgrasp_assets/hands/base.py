"""Where a hand begins in a robot: the link from which several moving limbs go out, and is no arm's."""

from collections.abc import Iterator

import numpy as np

from qdgrasp_assets.urdf import Urdf

LARGEST = 0.5
"""A hand's joints are not farther apart than this [m]."""


def guess_base(robot: Urdf) -> tuple[str, str]:
    """The link that a hand hangs on, and why: the first of several moving limbs beyond which all is near."""
    found = [
        link for link in _outward(robot) if len(limbs(robot, link)) > 1 and _spread(robot, link) < LARGEST
    ]
    if not found:
        link = _one_limb(robot)
        return link, "no link has several moving limbs; beyond this one all joints are near each other"
    first = found[0]
    others = [other for other in found if other not in robot.subtree(first).links]
    more = f"; they also do from {', '.join(others)}, which --base-link may name" if others else ""
    link = _rigid_root(robot, _last(robot, found))
    return link, f"{len(limbs(robot, first))} moving limbs go out from it{more}"


def limbs(robot: Urdf, base: str) -> tuple[str, ...]:
    """The joints that move and hang on link `base`, or on what is fixed to it."""
    mounts, found = {base}, []
    for joint in robot.outward(base):
        if joint.parent in mounts:
            if joint.moves:
                found.append(joint.name)
            else:
                mounts.add(joint.child)
    return tuple(found)


def _outward(robot: Urdf) -> Iterator[str]:
    """Links that are not fixed to another one, from the root on."""
    yield robot.root
    yield from (joint.child for joint in robot.outward(robot.root))


def _last(robot: Urdf, found: list[str]) -> str:
    """The last of the links that carry the limbs of the first, in the rigid piece that this is in."""
    carried = limbs(robot, found[0])
    return next(link for link in reversed(found) if limbs(robot, link) == carried)


def _spread(robot: Urdf, base: str) -> float:
    """The largest side of the box around the joints beyond a link, those at zero [m]."""
    hand = robot.subtree(base)
    places = np.array([frame[:3, 3] for frame in hand.forward({}).values()])
    return float(np.ptp(places, axis=0).max())


def _one_limb(robot: Urdf) -> str:
    """The first link on which a joint that moves hangs, and beyond which all is near."""
    parents = [joint.parent for joint in robot.outward(robot.root) if joint.moves]
    near = [link for link in parents if _spread(robot, link) < LARGEST]
    return _rigid_root(robot, near[0]) if near else robot.root


def _rigid_root(robot: Urdf, link: str) -> str:
    """The first link with a collision shape that a link is fixed to, where no arm is before it."""
    arriving = {joint.child: joint for joint in robot.joints}
    shaped = {
        each.get("name") for each in robot.element.findall("link") if each.find("collision") is not None
    }
    chain = [link]
    while chain[-1] in arriving and not arriving[chain[-1]].moves:
        chain.append(arriving[chain[-1]].parent)
    is_free = chain[-1] == robot.root
    return next((each for each in reversed(chain) if each in shaped), link) if is_free else link
