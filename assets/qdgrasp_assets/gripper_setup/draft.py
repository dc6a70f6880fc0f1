"""Draft of a gripper's file: what its user says, the rest guessed by geometry, with reasons."""

import json
import textwrap
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from msgspec import UNSET, Struct, structs

from qdgrasp_assets.geometry.mesh import Floats
from qdgrasp_assets.gripper_setup import grasp_inference
from qdgrasp_assets.gripper_setup.grasp_inference import ClosingMotion, find_closing, joint_motor, pinches
from qdgrasp_assets.grippers.gripper_file import (
    FreeJointTable,
    GripperFile,
    JawTable,
    JointTable,
    SynergyTable,
)
from qdgrasp_assets.grippers.hand_model import HandModel, fixed_limbs, guess_base, read_hand_model
from qdgrasp_assets.grippers.urdf import Urdf, UrdfJoint
from qdgrasp_assets.scene import Vector, vector
from qdgrasp_protocol.errors import AssetError, ImpossibleValue, UnknownName

AS_TOLD = "as told"
ROUNDING = 1e-6  # Resolution to which limits are written


@dataclass(frozen=True)
class DraftOverrides:
    """Values of a hand that the user states; None or absent: guessed."""

    licence: str | None = None
    base_link: str | None = None
    base_reason: str = AS_TOLD
    """Reason for the choice of the base link."""
    approach_axis: Vector | None = None
    palm_offset: float | None = None
    standoff: tuple[float, float] | None = None
    finger_links: tuple[str, ...] | None = None
    opened: Mapping[str, float] = field(default_factory=dict)
    closed: Mapping[str, float] = field(default_factory=dict)
    free: tuple[str, ...] | None = None


@dataclass(frozen=True)
class GripperDraft:
    """A gripper's file, with a reason for each of its lines."""

    file: GripperFile
    reasons: Mapping[str, str]
    """Reasons by key; those of a joint by `joints.NAME`."""


def draft_gripper(robot: Urdf, urdf: str, told: DraftOverrides) -> GripperDraft:
    """Draft the gripper file of the hand in `robot`, whose URDF it names as `urdf`.

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
    body = read_hand_model(robot, base)
    _check_names(body, told)
    closing = _with_overrides(find_closing(body), told)
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
    return GripperDraft(file, reasons)


def _base(robot: Urdf, told: DraftOverrides) -> tuple[str, str]:
    if told.base_link is None:
        return guess_base(robot)
    if told.base_link not in robot.links:
        raise UnknownName("link", told.base_link, robot.links)
    return told.base_link, told.base_reason


def _check_names(body: HandModel, told: DraftOverrides) -> None:
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


def _with_overrides(closing: ClosingMotion, told: DraftOverrides) -> ClosingMotion:
    """Return the closing of the hand, with the user's statements applied."""
    opened = {**closing.opened, **told.opened}
    closed = {**closing.closed, **told.closed}
    stays = {name: reason for name, reason in closing.stays.items() if name not in told.closed}
    reasons = {name: AS_TOLD for name in stays if name in told.opened}
    return ClosingMotion(closing.body, closing.fingers, opened, closed, {**stays, **reasons})


def _no_fingers(body: HandModel) -> str:
    limbs = [joint.child for joint in body.robot.joints if joint.moves]
    told = (
        f"its moving links ({', '.join(limbs)}) have no <collision>" if limbs else "none of its joints moves"
    )
    return (
        f"No finger can be found in '{body.robot.path}' beyond the link '{body.robot.root}': {told}; name "
        "another --base-link, or give the finger links collision shapes (--mend takes the visual ones)."
    )


def _axis(closing: ClosingMotion, told: DraftOverrides) -> tuple[Floats, str]:
    if told.approach_axis is not None:
        axis = np.array(told.approach_axis)
        if not np.linalg.norm(axis) > 0:
            raise ImpossibleValue("approach-axis", told.approach_axis, "a direction, such as 0,0,1")
        return axis / np.linalg.norm(axis), AS_TOLD
    if not closing.fingers:
        return np.array([0.0, 0.0, 1.0]), "no finger tells where the hand looks: set it"
    way, reason = grasp_inference.closing_way(closing)
    if np.linalg.norm(way) < grasp_inference.SHORT:
        raise AssetError(
            f"Where the hand in '{closing.body.robot.path}' looks cannot be guessed, as its fingers lie "
            "around the middle of its palm: say it with --approach-axis, such as 0,0,1."
        )
    return grasp_inference.snap_to_axis(way), reason


def _palm_offset(closing: ClosingMotion, axis: Floats, told: DraftOverrides) -> tuple[float, str]:
    if told.palm_offset is not None:
        return told.palm_offset, AS_TOLD
    offset, is_met = grasp_inference.palm_surface(closing.body, axis)
    where = "where the approach axis leaves" if is_met else "the approach axis passes the palm by: the end of"
    return round(offset, 4), f"{where} the palm's shapes"


def _standoff(
    closing: ClosingMotion, axis: Floats, offset: float, told: DraftOverrides
) -> tuple[tuple[float, float], str]:
    if told.standoff is not None:
        return told.standoff, AS_TOLD
    far = max(grasp_inference.finger_reach(closing, axis) - offset, 0.0) if closing.fingers else 0.05
    return (0.0, round(far, 4)), "from the palm to where the fingers reach while they close"


def _finger_links(closing: ClosingMotion, told: DraftOverrides) -> tuple[tuple[str, ...], str]:
    if told.finger_links is not None:
        return told.finger_links, AS_TOLD
    links = tuple(link for finger in closing.fingers for link in finger.links)
    return (
        links,
        f"what moves and has a shape: {len(closing.fingers)} finger{'s' * (len(closing.fingers) > 1)}"
        + (", with what is fixed opposite" if fixed_limbs(closing.body) else ""),
    )


def _free(
    closing: ClosingMotion, axis: Floats, told: DraftOverrides
) -> tuple[dict[str, FreeJointTable], str]:
    names = closing.spreads(axis) if told.free is None else told.free
    ranges = {name: closing.body.range(name) for name in names}
    reason = "joints that turn fingers about the approach axis: their place is a gene"
    tables = {name: FreeJointTable(low=low, high=high) for name, (low, high) in ranges.items()}
    return tables, AS_TOLD if told.free else reason


def _jaw(closing: ClosingMotion, axis: Floats) -> tuple[JawTable | None, str]:
    across = grasp_inference.jaw_axis(closing, axis)
    room = 0.0 if across is None else grasp_inference.jaw_opening(closing, axis, across)
    if across is None or room <= 0:
        return None, ""
    table = JawTable(axis=_rounded(across), opening=round(room, 4))
    return table, "two fingers that move toward each other, and the room between them when open"


def _joint(closing: ClosingMotion, name: str, free: set[str]) -> tuple[JointTable, str]:
    """Return a joint's table, and the reason for its values."""
    body = closing.body
    opened, closed = (_within(body, name, closing.posture(share)[name]) for share in (0.0, 1.0))
    if name in free:
        return JointTable(open=opened, driven=False), "a gene says where it is; the simulator holds it there"
    follower = body.followers.get(name)
    effort, velocity, notes = joint_motor(body, name, abs(closed - opened))
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


def _within(body: HandModel, name: str, position: float) -> float:
    low, high = body.range(name)
    return round(float(np.clip(position, low, high)), 6)


def _rounded(axis: Floats) -> Vector:
    return vector(axis.round(6) + 0.0)


LINE_WIDTH = 108
TOML_HEAD = """\
What `qdgrasp gripper new` guessed of '{urdf}': look at each line, and change what is not so.
What the keys mean: docs/grippers.md.
After a change: qdgrasp gripper check {name} --picture pictures"""
PLAIN_KEYS = ("licence", "base_link", "approach_axis", "palm_offset", "standoff", "finger_links")
KEY_UNITS = {
    "palm_offset": "[m]",
    "standoff": "[m]",
}


def draft_toml(draft: GripperDraft, name: str) -> str:
    """Return the text of a gripper's TOML file that will be called `name`."""
    file, reasons = draft.file, draft.reasons
    lines = [*_comment(TOML_HEAD.format(urdf=file.urdf, name=name)), f"urdf = {_value(file.urdf)}"]
    for key in PLAIN_KEYS:
        lines += ["", *_comment(_reason(key, reasons)), f"{key} = {_value(getattr(file, key))}"]
    if file.jaw is not None:
        lines += ["", *_comment(reasons["jaw"]), "[jaw]", *_table(file.jaw)]
    for joint, table in file.joints.items():
        lines += [
            "",
            *_comment(reasons.get(f"joints.{joint}", "")),
            f"[joints.{_key(joint)}]",
            *_table(table),
        ]
    for number, synergy in enumerate(file.synergies):
        lines += ["", *(() if number else _comment(reasons["synergies"])), "[[synergies]]", *_table(synergy)]
    for number, (joint, free) in enumerate(file.free_joints.items()):
        lines += ["", *(() if number else _comment(reasons["free_joints"]))]
        lines += [f"[free_joints.{_key(joint)}]", *_table(free)]
    return "\n".join(lines) + "\n"


def _reason(key: str, reasons: Mapping[str, str]) -> str:
    return " ".join(word for word in (reasons[key], KEY_UNITS.get(key)) if word)


def _comment(text: str) -> Iterator[str]:
    for line in text.splitlines():
        yield from (f"# {part}" for part in textwrap.wrap(line, LINE_WIDTH))


def _table(table: Struct) -> Iterator[str]:
    """Yield the lines of a table, without values that are the default."""
    for column in structs.fields(table):
        value = getattr(table, column.name)
        if column.default is UNSET or value != column.default:
            yield f"{column.name} = {_value(value)}"


def _value(value: Any) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, str):
        return json.dumps(value, ensure_ascii=False)
    if isinstance(value, Iterable):
        return _list([_value(each) for each in value])
    return repr(round(float(value), 6) + 0.0)


def _list(values: list[str]) -> str:
    short = f"[{', '.join(values)}]"
    return short if len(short) < LINE_WIDTH else "".join(["[\n", *(f"  {value},\n" for value in values), "]"])


def _key(name: str) -> str:
    """Return a key in TOML's notation."""
    is_bare = all(letter.isascii() and (letter.isalnum() or letter in "-_") for letter in name)
    return name if is_bare and name else json.dumps(name, ensure_ascii=False)
