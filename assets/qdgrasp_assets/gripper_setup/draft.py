"""Draft of a gripper's file: what its user says, the rest guessed by geometry, with reasons."""

import json
import re
import textwrap
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from msgspec import UNSET, Struct, structs, to_builtins

from qdgrasp_assets.geometry.mesh import Floats
from qdgrasp_assets.gripper_setup import closing_motion
from qdgrasp_assets.gripper_setup.closing_motion import (
    ClosingMotion,
    joint_motor,
    pinches,
    stop_at_contact,
)
from qdgrasp_assets.gripper_setup.closing_search import ClosingSearch
from qdgrasp_assets.gripper_setup.posture_checks import HandPostures, overlapping_pairs
from qdgrasp_assets.grippers.gripper_file import FreeJointTable, GripperFile, JointTable, OriginalBase
from qdgrasp_assets.grippers.hand_model import (
    HandModel,
    contradicted_limits,
    finger_length,
    fixed_limbs,
    guess_base,
    read_hand_model,
)
from qdgrasp_assets.grippers.urdf import MOST_NAMED, Urdf
from qdgrasp_assets.grippers.urdf_checks import bare_links
from qdgrasp_assets.scene import Jaw, Synergy, Vector, vector
from qdgrasp_protocol.errors import AssetError, ImpossibleValue, UnknownName
from qdgrasp_protocol.text import counted, first_few, join_numbers

AS_TOLD = "as told"
TOLD_STILL = "does not close, as told"
RATINGS_REASON = (
    "where the rated_effort and rated_velocity of the joints come from: replace them by those of the data "
    "sheet, and name it"
)


@dataclass(frozen=True)
class DraftOverrides:
    """Values of a hand that the user states; None or absent: guessed."""

    licence: str | None = None
    base_link: str | None = None
    base_reason: str = AS_TOLD
    approach_axis: Vector | None = None
    opened: Mapping[str, float] = field(default_factory=dict)
    closed: Mapping[str, float] = field(default_factory=dict)
    finger_roots: tuple[str, ...] = ()
    """The links that begin fingers; empty: guessed."""
    not_closing: tuple[str, ...] = ()
    """Joints that do not close."""


@dataclass(frozen=True)
class GripperDraft:
    """A gripper's file, with a reason for each of its lines."""

    file: GripperFile
    reasons: Mapping[str, str]
    """Reasons by key; those of a joint by `joints.NAME`."""
    closing: ClosingMotion
    warnings: tuple[str, ...] = ()
    """Signs that the guess is wrong, each with the flag that corrects it."""
    questions: tuple[str, ...] = ()
    """Those of them without whose answer grasps would be missed."""

    @property
    def words(self) -> tuple[str, ...]:
        """The guess in four lines, each with the flags of `qdgrasp gripper new` that change it."""
        file, body, axis = self.file, self.closing.body, self.file.approach_axis
        roots = [body.joint(finger.joints[0]).child for finger in self.closing.fingers]
        moves = [
            f"{name} {table.open:.4g} to {table.closed:.4g}"
            for name, table in file.joints.items()
            if table.closed is not None
        ]
        return (
            f"base link  {file.base_link}: {self.reasons['base_link']} (--base-link)",
            f"approach   {join_numbers(axis)}: {self.reasons['approach_axis']} (--approach-axis)",
            f"fingers    {len(roots)}, from {', '.join(roots)} (--finger)",
            f"closes     {first_few(moves, MOST_NAMED)} (--open, --closed, --not-closing)",
        )


def draft_gripper(robot: Urdf, urdf: str, overrides: DraftOverrides) -> GripperDraft:
    """Draft the gripper file of the hand in `robot`, whose URDF it names as `urdf`.

    Raises `UnknownName` if `overrides` name a link or joint that the hand does
    not have, `ImpossibleValue` for a joint beyond its limits or an approach axis that is no direction, and
    `AssetError` if a mesh cannot be read, or no finger can be found and none is named.
    """
    base, base_reason = overrides.base_link, overrides.base_reason
    if base is None:
        base, base_reason, _ = guess_base(robot)
    elif base not in robot.links:
        raise UnknownName("link", base, robot.links)
    body = read_hand_model(robot, base)
    closing = draft_closing(body, overrides)
    if not closing.fingers:
        limbs = [joint.child for joint in body.robot.joints if joint.moves]
        why = f"its moving links ({', '.join(limbs)}) have no <collision>"
        raise AssetError(
            f"No finger can be found in '{robot.path}' beyond the link '{base}': "
            f"{why if limbs else 'none of its joints moves'}; name another --base-link, or give the finger "
            "links collision shapes (--repair takes the visual ones)."
        )
    axis, axis_reason = draft_axis(closing, overrides)
    palm, is_met = closing_motion.palm_surface(body, axis)
    palm_end = (
        "where the approach axis leaves" if is_met else "the approach axis passes the palm by: the end of"
    )
    offset = round(palm, 4)
    far = max(closing_motion.finger_reach(closing, axis) - offset, 0.0)
    links_reason = f"what moves and has a shape: {counted(len(closing.fingers), 'finger')}"
    links_reason += ", with what is fixed opposite" if fixed_limbs(body) else ""
    ranges = {name: body.range(name) for name in closing.spreads(axis)}
    free = {name: FreeJointTable(low=low, high=high) for name, (low, high) in ranges.items()}
    jaw, jaw_reason = _jaw(closing, axis)
    synergies, synergies_reason = pinches(closing)
    joints = {name: _joint(closing, name, set(free)) for name in body.moving}
    file = GripperFile(
        urdf=urdf,
        licence=overrides.licence or "not stated",
        base_link=base,
        approach_axis=vector(axis.round(6) + 0.0),
        palm_offset=offset,
        standoff=(0.0, round(far, 4)),
        finger_links=tuple(link for finger in closing.fingers for link in finger.links),
        joints={name: table for name, (table, _) in joints.items()},
        synergies=tuple(Synergy(name=name, joints=group) for name, group in synergies.items()),
        free_joints=free,
        jaw=jaw,
        ratings_source="the URDF's limits, not compared with a data sheet",
    )
    file = structs.replace(file, disabled_collisions=overlapping_pairs(HandPostures(file, body)))
    licence_advice = "" if overrides.licence else ", so state it"
    reasons = {
        "licence": f"of the hand's files; it goes into every export{licence_advice}",
        "base_link": base_reason,
        "approach_axis": axis_reason,
        "palm_offset": f"{palm_end} the palm's shapes",
        "standoff": "from the palm to where the fingers reach while they close",
        "finger_links": links_reason,
        "ratings_source": RATINGS_REASON,
        "disabled_collisions": "pairs of links that overlap when the hand is open, or wherever it is",
        "jaw": jaw_reason,
        "synergies": synergies_reason,
        "free_joints": "joints that turn fingers about the approach axis: their place is a gene",
        **{f"joints.{name}": reason for name, (_, reason) in joints.items()},
    }
    told = frozenset(("approach_axis",) if overrides.approach_axis else ())
    questions = tuple(_idle_fingers(closing))
    warnings = (*questions, *_warnings(closing, axis, told))
    return GripperDraft(file, reasons, closing, warnings, questions)


def _check_names(body: HandModel, overrides: DraftOverrides) -> None:
    beyond = [joint.child for joint in body.robot.joints]
    for link in overrides.finger_roots:
        if link not in beyond:
            raise UnknownName("link beyond the base link", link, beyond)
    still = dict.fromkeys(overrides.not_closing, 0.0)
    for flag, told in (("open", overrides.opened), ("closed", overrides.closed), ("not-closing", still)):
        for name, position in told.items():
            if name not in body.moving:
                raise UnknownName("moving joint", name, body.moving)
            if (leader := body.leader(name)) != name:
                raise AssetError(f"The joint '{name}' follows '{leader}': give --{flag} for '{leader}'.")
            joint = body.joint(name)
            if told is not still and not joint.allows(position):
                within = f"within the limits {joint.lower:g} to {joint.upper:g} of that joint"
                raise ImpossibleValue(f"{flag} {name}", position, within)


CENTRE = "_centre"  # Suffix of the name of an added base link


def original_base(base_link: str, hand: Urdf) -> OriginalBase | None:
    """Return the base link of a hand before one was added to it; None if none was."""
    link = base_link.removesuffix(CENTRE)
    joint = hand.joint(f"{base_link}_joint")
    if link == base_link or joint is None or joint.moves or (joint.parent, joint.child) != (base_link, link):
        return None
    return OriginalBase(link=link, position=vector(joint.origin[:3, 3]))


def draft_closing(body: HandModel, overrides: DraftOverrides) -> ClosingMotion:
    """Return how a hand closes, up to the first contact of each finger.

    Raises `UnknownName` if `overrides` name a link or joint that the hand does not have, and
    `ImpossibleValue` for a joint beyond its limits.
    """
    _check_names(body, overrides)
    found = ClosingSearch(body, overrides.finger_roots, overrides.not_closing).find()
    fixed = {name: reason for name, reason in found.fixed_joints.items() if name not in overrides.closed}
    fixed |= {name: AS_TOLD for name in fixed if name in overrides.opened}
    fixed |= {name: TOLD_STILL for name in overrides.not_closing if name in fixed}
    opened = {**found.opened, **overrides.opened}
    closed = {**found.closed, **overrides.closed}
    motion = ClosingMotion(body, found.fingers, opened, closed, fixed)
    synergies = [Synergy(name=name, joints=joints) for name, joints in pinches(motion)[0].items()]
    return stop_at_contact(motion, synergies, overrides.closed)


def draft_axis(closing: ClosingMotion, overrides: DraftOverrides) -> tuple[Floats, str]:
    """Return the approach axis, a unit vector (3,) in the base link's frame, and its reason.

    Raises `ImpossibleValue` if that of `overrides` is no direction, and `AssetError` if none can be guessed.
    """
    if overrides.approach_axis is not None:
        axis = np.array(overrides.approach_axis)
        if not np.linalg.norm(axis) > 0:
            raise ImpossibleValue("approach-axis", overrides.approach_axis, "a direction, such as 0,0,1")
        return axis / np.linalg.norm(axis), AS_TOLD
    if not closing.fingers:
        return np.array([0.0, 0.0, 1.0]), "no finger tells where the hand looks: set it"
    way, reason = closing_motion.closing_way(closing)
    if np.linalg.norm(way) < closing_motion.SHORT:
        raise AssetError(
            f"Where the hand in '{closing.body.robot.path}' looks cannot be guessed, as its fingers lie "
            "around the middle of its palm: say it with --approach-axis, such as 0 0 1."
        )
    return closing_motion.snap_to_axis(way), reason


def _jaw(closing: ClosingMotion, axis: Floats) -> tuple[Jaw | None, str]:
    across = closing_motion.jaw_axis(closing, axis)
    opening = 0.0 if across is None else closing_motion.jaw_opening(closing, axis, across)
    if across is None or opening <= 0:
        return None, ""
    table = Jaw(axis=vector(across.round(6) + 0.0), opening=round(opening, 4))
    return table, "two fingers that move toward each other, and the room between them when open"


def _joint(closing: ClosingMotion, name: str, free: set[str]) -> tuple[JointTable, str]:
    body = closing.body
    opened, closed = (
        round(float(np.clip(closing.posture(share)[name], *body.range(name))), 6) for share in (0.0, 1.0)
    )
    if name in free:
        return JointTable(open=opened, driven=False), "a gene says where it is; the simulator holds it there"
    follower = body.followers.get(name)
    effort, velocity, notes = joint_motor(body, name, abs(closed - opened))
    if follower is not None:
        way = f"{follower.multiplier:g} times it, plus {follower.offset:g}"
        notes = (f"mimics {follower.leader} ({way}), to which it is coupled", *notes)
    elif name in closing.stopped:
        notes = (closing.stopped[name], *notes)
    elif name in closing.fixed_joints:
        notes = (closing.fixed_joints[name], *notes)
    target = None if closed == opened else closed
    joint = body.joint(name)
    table = JointTable(
        open=opened,
        closed=target,
        effort=effort,
        velocity=velocity,
        rated_effort=effort or joint.effort,
        rated_velocity=joint.velocity if joint.velocity > 0 else velocity,
    )
    return table, "; ".join(notes)


SHORT_FINGER = 0.35  # A finger is short beside the longest if it has at most this share of its length


def _warnings(closing: ClosingMotion, axis: Floats, told: Collection[str]) -> Iterator[str]:
    """Yield signs that a guess is wrong, each with the flag that corrects it.

    `axis` (3,) is the approach axis, `told` has the keys that are not guessed.
    """
    lengths = [finger_length(closing.body, finger) for finger in closing.fingers]
    for finger, length in zip(closing.fingers, lengths, strict=True):
        root = closing.body.joint(finger.joints[0]).child
        if length <= SHORT_FINGER * max(lengths):
            yield (
                f"the finger that begins with '{root}' is {1000 * length:.0f} mm long, and the longest "
                f"{1000 * max(lengths):.0f} mm: if it is no finger, name the links that begin the others, "
                "each with --finger LINK"
            )
    if bare := ", ".join(bare_links(closing.body.robot.element)):
        yield f"links with visual shapes alone, through which objects pass: {bare}; --repair takes those"
    if against := ", ".join(contradicted_limits(closing.body.robot)):
        yield f"limits that mostly forbid what <mimic> asks: {against}; --repair takes those of the <mimic>"
    if "approach_axis" not in told and np.abs(axis).max() < 1 - 1e-9:
        yield (
            f"the approach axis, ({join_numbers(axis.round(3))}), is none of the base link's axes: if the "
            "palm looks along one of them, say so with --approach-axis, such as 0 0 1"
        )


def _idle_fingers(closing: ClosingMotion) -> Iterator[str]:
    fixed = fixed_limbs(closing.body)
    for finger in closing.fingers:
        if not closing.closing_joints(finger) and finger.joints[0] not in fixed:
            yield (
                f"nothing closes the finger that begins with '{closing.body.joint(finger.joints[0]).child}': "
                "say where its joints close to with --closed JOINT=POSITION; if it is no finger, name those "
                "that are, each with --finger LINK"
            )


LINE_WIDTH = 108
TOML_HEAD = """\
Guessed by `qdgrasp gripper new` from '{urdf}': look at each line, and correct the wrong ones.
Meaning of the keys: docs/grippers.md.
After a change: qdgrasp gripper check {name} --picture pictures"""
PLAIN_KEYS = (
    "licence", "base_link", "approach_axis", "palm_offset", "standoff", "finger_links", "ratings_source",
    "disabled_collisions",
)  # fmt: skip
KEY_UNITS = {"palm_offset": " [m]", "standoff": " [m]"}


def draft_toml(draft: GripperDraft, name: str) -> str:
    """Return the text of a gripper's TOML file that will be called `name`."""
    file, reasons = draft.file, draft.reasons
    lines = [*_comment(TOML_HEAD.format(urdf=file.urdf, name=name)), f"urdf = {_value(file.urdf)}"]
    for key in PLAIN_KEYS:
        comment = _comment(reasons[key] + KEY_UNITS.get(key, ""))
        lines += ["", *comment, f"{key} = {_value(getattr(file, key))}"]
    if file.jaw is not None:
        lines += ["", *_comment(reasons["jaw"]), "[jaw]", *_table(file.jaw)]
    for joint, table in file.joints.items():
        comment = _comment(reasons.get(f"joints.{joint}", ""))
        lines += ["", *comment, f"[joints.{_key(joint)}]", *_table(table)]
    for number, synergy in enumerate(file.synergies):
        lines += ["", *(() if number else _comment(reasons["synergies"])), "[[synergies]]", *_table(synergy)]
    for number, (joint, free) in enumerate(file.free_joints.items()):
        lines += ["", *(() if number else _comment(reasons["free_joints"]))]
        lines += [f"[free_joints.{_key(joint)}]", *_table(free)]
    return "\n".join(lines) + "\n"


def _comment(text: str) -> Iterator[str]:
    for line in text.splitlines():
        yield from (f"# {part}" for part in textwrap.wrap(line, LINE_WIDTH))


def _table(table: Struct) -> Iterator[str]:
    for column in structs.fields(table):
        value = getattr(table, column.name)
        if column.default is UNSET or value != column.default:
            yield f"{column.name} = {_value(value)}"


def _value(value: Any) -> str:
    """Return a value as TOML, which is JSON; a long list with a line for each entry."""
    text = json.dumps(to_builtins(value), ensure_ascii=False)
    if len(text) < LINE_WIDTH or not isinstance(value, tuple):
        return text
    return "".join(["[\n", *(f"  {_value(each)},\n" for each in value), "]"])


def _key(name: str) -> str:
    return name if re.fullmatch(r"[A-Za-z0-9_-]+", name) else json.dumps(name, ensure_ascii=False)
