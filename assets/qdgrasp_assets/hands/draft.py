"""The draft of a gripper's file: what its user told, the rest guessed by geometry, with reasons."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from qdgrasp_assets.gripper_file import FreeJointTable, GripperFile, JawTable, JointTable, SynergyTable
from qdgrasp_assets.hands import palm
from qdgrasp_assets.hands.base import guess_base
from qdgrasp_assets.hands.body import Body, read_body
from qdgrasp_assets.hands.closing import Closing, find_closing
from qdgrasp_assets.hands.fingers import fixed_limbs
from qdgrasp_assets.hands.motors import motor
from qdgrasp_assets.hands.overlap import Floats
from qdgrasp_assets.hands.thumb import pinches
from qdgrasp_assets.scene import Vector
from qdgrasp_assets.urdf import Urdf, UrdfJoint
from qdgrasp_assets.vectors import vector
from qdgrasp_protocol.errors import AssetError, ImpossibleValue, UnknownName

TOLD = "as told"
ROUNDING = 1e-6
"""Limits are written with so many decimals, or more."""


@dataclass(frozen=True)
class Told:
    """What the user says of a hand; what is None or not there is guessed."""

    licence: str | None = None
    base_link: str | None = None
    base_reason: str = TOLD
    """Why the base link is this one."""
    approach_axis: Vector | None = None
    palm_offset: float | None = None
    standoff: tuple[float, float] | None = None
    finger_links: tuple[str, ...] | None = None
    opened: Mapping[str, float] = field(default_factory=dict)
    closed: Mapping[str, float] = field(default_factory=dict)
    free: tuple[str, ...] | None = None


@dataclass(frozen=True)
class Draft:
    """A gripper's file, and why each of its lines is as it is."""

    file: GripperFile
    reasons: Mapping[str, str]
    """By key; those of a joint by `joints.NAME`."""


def draft(robot: Urdf, urdf: str, told: Told) -> Draft:
    """The file of the hand in `robot`, which it names as `urdf`.

    Raises
    ------
    UnknownName
        What is told names a link or joint that the hand does not have.
    ImpossibleValue
        A joint is told to be beyond its limits, or the approach axis is no direction.
    AssetError
        A mesh cannot be read, or no finger can be found and none is told.
    """
    base, base_reason = _base(robot, told)
    body = read_body(robot, base)
    _check_names(body, told)
    closing = _as_told(find_closing(body), told)
    if not closing.fingers and not told.finger_links:
        raise AssetError(_no_fingers(body))
    axis, axis_reason = _axis(closing, told)
    offset, offset_reason = _palm_offset(closing, axis, told)
    standoff, standoff_reason = _standoff(closing, axis, offset, told)
    links, links_reason = _finger_links(closing, told)
    free, free_reason = _free(closing, axis, told)
    jaw, jaw_reason = _jaw(closing, axis)
    synergies, synergies_reason = pinches(closing)
    joints = {name: _joint(closing, name, set(free)) for name in body.moving}
    file = GripperFile(
        urdf=urdf,
        licence=told.licence or "not stated",
        base_link=base,
        approach_axis=_rounded(axis),
        palm_offset=offset,
        standoff=standoff,
        finger_links=links,
        joints={name: table for name, (table, _) in joints.items()},
        synergies=tuple(SynergyTable(name=name, joints=group) for name, group in synergies.items()),
        free_joints=free,
        jaw=jaw,
    )
    reasons = {
        "licence": "of the hand's files; it goes into every export"
        + ("" if told.licence else ", so state it"),
        "base_link": base_reason,
        "approach_axis": axis_reason,
        "palm_offset": offset_reason,
        "standoff": standoff_reason,
        "finger_links": links_reason,
        "jaw": jaw_reason,
        "synergies": synergies_reason,
        "free_joints": free_reason,
        **{f"joints.{name}": reason for name, (_, reason) in joints.items()},
    }
    return Draft(file, reasons)


def _base(robot: Urdf, told: Told) -> tuple[str, str]:
    if told.base_link is None:
        return guess_base(robot)
    if told.base_link not in robot.links:
        raise UnknownName("link", told.base_link, robot.links)
    return told.base_link, told.base_reason


def _check_names(body: Body, told: Told) -> None:
    for link in told.finger_links or ():
        if link not in body.robot.links:
            raise UnknownName("link", link, body.robot.links)
    for joint in (*told.opened, *told.closed, *(told.free or ())):
        if joint not in body.moving:
            raise UnknownName("moving joint", joint, body.moving)
    for label, positions in (("open", told.opened), ("closed", told.closed)):
        for joint, position in positions.items():
            _check_position(body.joint(joint), label, position)


def _check_position(joint: UrdfJoint, label: str, position: float) -> None:
    limited = joint.kind != "continuous" and joint.lower < joint.upper
    if limited and not joint.lower - ROUNDING <= position <= joint.upper + ROUNDING:
        within = f"within the limits {joint.lower:g} to {joint.upper:g} of that joint"
        raise ImpossibleValue(f"{label} {joint.name}", position, within)


def _as_told(closing: Closing, told: Told) -> Closing:
    """The way the hand closes, with what the user says of it."""
    opened = {**closing.opened, **told.opened}
    closed = {**closing.closed, **told.closed}
    stays = {name: reason for name, reason in closing.stays.items() if name not in told.closed}
    reasons = {name: TOLD for name in stays if name in told.opened}
    return Closing(closing.body, closing.fingers, opened, closed, {**stays, **reasons})


def _no_fingers(body: Body) -> str:
    limbs = [joint.child for joint in body.robot.joints if joint.moves]
    told = (
        f"its moving links ({', '.join(limbs)}) have no <collision>" if limbs else "none of its joints moves"
    )
    return (
        f"No finger can be found in '{body.robot.path}' beyond the link '{body.robot.root}': {told}; name "
        "another --base-link, or give the finger links collision shapes (--mend takes the visual ones)."
    )


def _axis(closing: Closing, told: Told) -> tuple[Floats, str]:
    if told.approach_axis is not None:
        axis = np.array(told.approach_axis)
        if not np.linalg.norm(axis) > 0:
            raise ImpossibleValue("approach-axis", told.approach_axis, "a direction, such as 0,0,1")
        return axis / np.linalg.norm(axis), TOLD
    if not closing.fingers:
        return np.array([0.0, 0.0, 1.0]), "no finger tells where the hand looks: set it"
    way, reason = palm.way(closing)
    if np.linalg.norm(way) < palm.SHORT:
        raise AssetError(
            f"Where the hand in '{closing.body.robot.path}' looks cannot be guessed, as its fingers lie "
            "around the middle of its palm: say it with --approach-axis, such as 0,0,1."
        )
    return palm.snapped(way), reason


def _palm_offset(closing: Closing, axis: Floats, told: Told) -> tuple[float, str]:
    if told.palm_offset is not None:
        return told.palm_offset, TOLD
    offset, is_met = palm.palm_surface(closing.body, axis)
    where = "where the approach axis leaves" if is_met else "the approach axis passes the palm by: the end of"
    return round(offset, 4), f"{where} the palm's shapes"


def _standoff(closing: Closing, axis: Floats, offset: float, told: Told) -> tuple[tuple[float, float], str]:
    if told.standoff is not None:
        return told.standoff, TOLD
    far = max(palm.reach(closing, axis) - offset, 0.0) if closing.fingers else 0.05
    return (0.0, round(far, 4)), "from the palm to where the fingers reach while they close"


def _finger_links(closing: Closing, told: Told) -> tuple[tuple[str, ...], str]:
    if told.finger_links is not None:
        return told.finger_links, TOLD
    links = tuple(link for finger in closing.fingers for link in finger.links)
    return (
        links,
        f"what moves and has a shape: {len(closing.fingers)} finger{'s' * (len(closing.fingers) > 1)}"
        + (", with what is fixed opposite" if fixed_limbs(closing.body) else ""),
    )


def _free(closing: Closing, axis: Floats, told: Told) -> tuple[dict[str, FreeJointTable], str]:
    names = closing.spreads(axis) if told.free is None else told.free
    ranges = {name: closing.body.range(name) for name in names}
    reason = "joints that turn fingers about the approach axis: their place is a gene"
    tables = {name: FreeJointTable(low=low, high=high) for name, (low, high) in ranges.items()}
    return tables, TOLD if told.free else reason


def _jaw(closing: Closing, axis: Floats) -> tuple[JawTable | None, str]:
    across = palm.opposed(closing, axis)
    room = 0.0 if across is None else palm.opening(closing, axis, across)
    if across is None or room <= 0:
        return None, ""
    table = JawTable(axis=_rounded(across), opening=round(room, 4))
    return table, "two fingers that move toward each other, and the room between them when open"


def _joint(closing: Closing, name: str, free: set[str]) -> tuple[JointTable, str]:
    """A joint's table, and why it is as it is."""
    body = closing.body
    opened, closed = (_within(body, name, closing.posture(share)[name]) for share in (0.0, 1.0))
    if name in free:
        return JointTable(open=opened, driven=False), "a gene says where it is; the simulator holds it there"
    follower = body.followers.get(name)
    effort, velocity, notes = motor(body, name, abs(closed - opened))
    if follower is not None:
        notes = (
            f"mimics {follower.leader} ({follower.multiplier:g} times it, plus {follower.offset:g}) "
            "by a motor of its own, as the simulator couples no joints",
            *notes,
        )
    elif name in closing.stays:
        notes = (closing.stays[name], *notes)
    moves = closed != opened
    table = JointTable(open=opened, closed=closed if moves else None, effort=effort, velocity=velocity)
    return table, "; ".join(notes)


def _within(body: Body, name: str, position: float) -> float:
    low, high = body.range(name)
    return round(float(np.clip(position, low, high)), 6)


def _rounded(axis: Floats) -> Vector:
    return vector(axis.round(6) + 0.0)
