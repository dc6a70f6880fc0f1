"""Files of grippers that are guessed for the hand of a URDF or MJCF file."""

import shlex
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path

from qdgrasp_assets.asset_report import examine_hand, read_hand
from qdgrasp_assets.geometry.collision_parts import Tell
from qdgrasp_assets.gripper_setup.draft import DraftOverrides, draft_gripper, draft_toml
from qdgrasp_assets.gripper_setup.repaired_copy import repaired_copy, repaired_meshes, repaired_urdf
from qdgrasp_assets.grippers.hand_model import guess_base
from qdgrasp_assets.grippers.mjcf import is_mjcf
from qdgrasp_assets.grippers.urdf import Urdf
from qdgrasp_assets.grippers.urdf_checks import hand_faults
from qdgrasp_coordinator.storage.outputs import OutFile, OutFolder
from qdgrasp_protocol.errors import AssetError


def write_guess(urdf: Path, target: Path, tell: Tell) -> None:
    """Write the file guessed for a hand, with a repaired copy of the hand; say the guess.

    Raises `AssetError` with the question where the guess may be wrong in a way that no result shows.
    """
    robot, file, given = read_tree(urdf, tell), OutFile(target), DraftOverrides()
    base, _, others = guess_base(robot)
    questions = [f"it begins at {' or '.join((base, *others))}: --base-link says where"] if others else []
    with ExitStack() as until_written:
        hand, given = usable_robot(robot, given, file, until_written, tell, repair=True)
        made = draft_gripper(hand, relative_name(hand.path, target), given)
        doubts = (f"doubt      {words}" for words in made.warnings if words not in made.questions)
        tell("\n".join([f"hand       {urdf}, guessed:", *made.words, *doubts]))
        if questions := [*questions, *made.questions, *examine_hand(hand, made.file, urdf.name).faults]:
            raise AssetError(
                f"How the hand of '{urdf}' grasps is not sure: {'; '.join(questions)}. Answer with flags of "
                f"`qdgrasp gripper new {shlex.quote(str(urdf))} --repair`, and run with its file."
            )
        file.write(draft_toml(made, target.name).encode())


def read_tree(urdf: Path, tell: Tell) -> Urdf:
    """Return the robot of a URDF or MJCF file; `AssetError` if it is no tree of links."""
    robot, found, translated = read_hand(urdf)
    if robot is None:
        raise AssetError(f"The URDF '{urdf}' cannot be used: {'; and '.join(found)}.")
    for sentence in translated:
        tell(f"read: {sentence}")
    return robot


def usable_robot(
    robot: Urdf,
    given: DraftOverrides,
    file: OutFile,
    until_written: ExitStack,
    tell: Tell,
    *,
    repair: bool,
) -> tuple[Urdf, DraftOverrides]:
    """The robot, or a repaired copy of its hand, with the base link that is to be used.

    A hand of an MJCF file is always copied, to a URDF. The copy goes where `until_written` fails. `tell` is
    called with each repair, and before each slow step.
    """
    base, reason, _ = (given.base_link, given.base_reason, ()) if given.base_link else guess_base(robot)
    if base not in robot.links:
        return robot, given
    found = hand_faults(robot.subtree(base))
    if found and not repair:
        raise AssetError(
            f"The URDF '{robot.path}' cannot be used as it is: {'; and '.join(found)}. "
            "--repair writes a copy of the hand in which what can be repaired is."
        )
    if not repair and not is_mjcf(robot.path):
        return robot, given
    OutFile(repaired_urdf(file.path), force=file.force, inputs=(robot.path,)).check()
    OutFolder(repaired_meshes(file.path), force=file.force, is_kind=lambda _: True).check()
    may_centre = repair and given.base_link is None
    file.path.absolute().parent.mkdir(parents=True, exist_ok=True)
    repairing = repaired_copy(
        robot,
        base,
        file.path,
        tell,
        may_centre=may_centre,
        overrides=given,
        as_it_is=not repair,
    )
    copy = until_written.enter_context(repairing)
    for change in copy.changes or (("nothing had to be",) if repair else ()):
        tell(f"repaired: {change}")
    return copy.robot, replace(
        given, base_link=copy.base, base_reason=reason if copy.base == base else copy.changes[-1]
    )


def relative_name(urdf: Path, target: Path) -> str:
    """Return the URDF's path as the file names it: relative if it lies below the file's folder."""
    whole, folder = urdf.resolve(), target.resolve().parent
    return str(whole.relative_to(folder) if whole.is_relative_to(folder) else whole)
