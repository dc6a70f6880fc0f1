"""The grip of a hand: all of its joints, the targets of its drives, its width and force."""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from qdgrasp_assets.catalog import gripper_path
from qdgrasp_assets.geometry.rotation import Floats
from qdgrasp_assets.grippers.gripper_file import read_gripper_file
from qdgrasp_assets.grippers.hand_geometry import hand_geometry
from qdgrasp_assets.grippers.urdf import scene_robot
from qdgrasp_assets.scene import SceneGripper
from qdgrasp_protocol.drives import JAW_PRELOAD, DriveGains
from qdgrasp_protocol.errors import InputError
from qdgrasp_protocol.rows import DISTURBANCES
from qdgrasp_protocol.spec import RunSpec
from qdgrasp_tools.export.grasp_table import GraspColumn, GraspContacts

JOINT_MEANINGS = {
    "pregrasp.": "joint before closing, at the commanded pose [rad or m]",
    "joint.": "joint after closing, at the settled pose [rad or m]",
    "squeeze.": "target with which its drive presses [rad or m]",
}
"""Meanings of columns by their prefixes, which the joint's name follows."""
Positions = NDArray[np.float32]  # (n, j)
WIDTH_MEANING = "distance between the tips of the jaw after closing [m]; none: there is no jaw"
FORCE_MEANING = "half the normal forces of its contacts, of a jaw that of each finger [N]; none: not known"


class Postures(NamedTuple):
    """Every joint of a hand at n grasps [rad or m], fixed ones behind those that move."""

    names: tuple[str, ...]
    pregrasp: Positions
    """(n, j): before closing, at the commanded pose."""
    joints: Positions
    """(n, j): after closing, at the settled pose."""
    squeeze: Positions
    """(n, j): targets of drives that press as the protocol's do (`squeeze_targets`)."""

    def columns(self) -> Iterator[GraspColumn]:
        """Yield each joint's values as columns."""
        for name, *values in zip(self.names, *(each.T for each in self[1:]), strict=True):
            for (begin, meaning), each in zip(JOINT_MEANINGS.items(), values, strict=True):
                yield GraspColumn(begin + name, each, meaning)


def whole_postures(
    hand: SceneGripper, spec: RunSpec, starts: Positions, joints: Positions, synergies: NDArray[np.integer]
) -> Postures:
    """Return every joint of a run's hand; arguments as of `squeeze_targets`."""
    fixed = fixed_joints(spec.gripper)
    still = np.tile(np.array([*fixed.values()], np.float32), (len(joints), 1))
    targets = squeeze_targets(hand, spec.nominal_protocol, starts, joints, synergies)
    names = (*(joint.name for joint in hand.joints), *fixed)
    return Postures(names, *(np.hstack([values, still]) for values in (starts, joints, targets)))


def fixed_joints(gripper: str) -> dict[str, float]:
    """Return joints that a hand has and its URDF does not move, with positions [rad or m].

    `gripper` is its name or file; if that is not there any more, none are known.
    """
    try:
        return read_gripper_file(gripper_path(gripper)).fixed_joints
    except InputError:
        return {}


def squeeze_targets(
    hand: SceneGripper, protocol: str, starts: Positions, joints: Positions, synergies: NDArray[np.integer]
) -> Positions:
    """Return the joint targets (n, j) with which drives press at the grasp [rad or m].

    In `physical` a target leads its joint, in the sense in which it closes, by force over stiffness of its
    drive: by the lag at which the drive gives its limit, of a jaw by the preload's share of that. Elsewhere
    it is the closed position. Joints that do not close have themselves for a target. `starts` and `joints`
    (n, j) are positions before and after closing, `synergies` (n,) labels, `NO_SYNERGY` for all.
    """
    robot = scene_robot(hand)
    members = [[joint.name in synergy.joints for joint in hand.joints] for synergy in hand.synergies]
    closing = np.array([*members, [True] * len(hand.joints)])[synergies]  # -1, none, is the last
    closing &= np.array([joint.driven for joint in hand.joints])
    closed = np.array([joint.closed for joint in hand.joints])
    senses = np.where(closing, np.sign(closed - starts), 0.0)
    targets = np.broadcast_to(closed, joints.shape)
    if protocol in DISTURBANCES:
        kinds = [found.kind for joint in hand.joints if (found := robot.joint(joint.name))]
        lags = np.array([DriveGains.of(kind).lag for kind in kinds])
        reached = np.minimum(senses * joints, senses * closed)
        targets = senses * (reached + lags * (JAW_PRELOAD if hand.jaw else 1.0))
    return np.where(senses != 0, targets, joints).astype(np.float32)


def jaw_widths(hand: SceneGripper, joints: Positions) -> Floats:
    """Return the distance (n,) between the tips of a jaw [m]; NaN where there is no jaw.

    `joints` (n, j) are positions [rad or m]. It is the opening less the ways of the tips toward each
    other, along the jaw's axis.
    """
    if hand.jaw is None:
        return np.full(len(joints), np.nan)
    geometry, axis = hand_geometry(hand), np.array(hand.jaw.axis)
    widths = np.full(len(joints), hand.jaw.opening)
    opened = geometry.frames(np.array([[joint.opened for joint in hand.joints]]))
    frames = geometry.frames(np.asarray(joints, dtype=np.float64))
    for side in (0.5, -0.5):
        tip, ways = hand.reach * np.array(hand.approach_axis) + side * hand.jaw.opening * axis, []
        for link in hand.finger_links:
            turn, place = opened[link][0, :3, :3], opened[link][0, :3, 3]
            moved = frames[link][:, :3, :3] @ (turn.T @ (tip - place)) + frames[link][:, :3, 3]
            ways.append(np.sign(side) * (tip - moved) @ axis)
        widths -= np.max(ways, axis=0)  # links of the other finger take its tip outward
    return np.asarray(np.maximum(widths, 0.0))


def grip_forces(contacts: GraspContacts) -> Floats:
    """Return the force (n,) with which a hand grips [N], half of its contacts' normal forces.

    Of a jaw it is the force of each finger. NaN where no contact was recorded.
    """
    return np.where(contacts.links.any(axis=1), contacts.forces.sum(axis=1) / 2, np.nan)
