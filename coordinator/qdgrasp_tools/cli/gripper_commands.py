"""`qdgrasp gripper`: write the file of a custom hand with guessed values, and check it."""

import math
import shlex
from collections.abc import Iterable
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import Annotated

import typer

from qdgrasp_assets.asset_report import examine_gripper, examine_hand, examine_urdf, read_hand
from qdgrasp_assets.catalog import find_gripper
from qdgrasp_assets.gripper_setup.draft import DraftOverrides, draft_gripper, draft_toml
from qdgrasp_assets.gripper_setup.repaired_copy import repaired_copy, repaired_meshes, repaired_urdf
from qdgrasp_assets.grippers.gripper import read_gripper
from qdgrasp_assets.grippers.hand_model import guess_base
from qdgrasp_assets.grippers.mjcf import is_mjcf
from qdgrasp_assets.grippers.urdf import Urdf
from qdgrasp_assets.grippers.urdf_checks import hand_faults
from qdgrasp_coordinator.storage.outputs import OutFile, OutFolder
from qdgrasp_protocol.cli_support import echo
from qdgrasp_protocol.errors import AssetError, ImpossibleValue
from qdgrasp_protocol.text import parse_numbers
from qdgrasp_tools.cli import asset_commands, options

Vector3 = tuple[float, float, float]


def parse_positions(field: str, texts: Iterable[str]) -> dict[str, float]:
    """Parse joint positions, `NAME=VALUE` between commas; raises ImpossibleValue for other text."""
    found = {}
    for part in (part for text in texts for part in text.split(",")):
        name, _, value = part.rpartition("=")
        if not name:
            raise ImpossibleValue(field, part, "JOINT=POSITION, in rad or m")
        numbers = parse_numbers(value)
        if len(numbers) != 1 or not math.isfinite(numbers[0]):
            raise ImpossibleValue(f"{field} {name}", value, "a number such as 0.05")
        found[name.strip()] = numbers[0]
    return found


gripper_app = typer.Typer(
    name="gripper", no_args_is_help=True, help="Custom hands: make their files, and check them."
)


@gripper_app.command()
def new(
    urdf: Annotated[Path, typer.Argument(metavar="URDF|MJCF", help="The hand, or a robot that ends in one.")],
    out: Annotated[
        Path | None,
        typer.Option(
            "--out",
            "-o",
            metavar="FILE.toml",
            help="File to write; its folder is made; default: the URDF's name, here.",
        ),
    ] = None,
    base_link: Annotated[str | None, typer.Option(help="The link that the hand hangs on.")] = None,
    approach_axis: Annotated[
        Vector3 | None, typer.Option(metavar="X Y Z", help="From the palm to the object, base link's frame.")
    ] = None,
    opened: Annotated[
        list[str] | None, typer.Option("--open", metavar="JOINT=POSITION,...", help="Where joints are open.")
    ] = None,
    closed: Annotated[
        list[str] | None,
        typer.Option("--closed", metavar="JOINT=POSITION,...", help="Where joints close to."),
    ] = None,
    finger: Annotated[
        list[str] | None,
        typer.Option("--finger", metavar="LINK", help="A link that begins a finger; once for each."),
    ] = None,
    not_closing: Annotated[
        list[str] | None,
        typer.Option("--not-closing", metavar="JOINT", help="A joint that does not close; may be repeated."),
    ] = None,
    licence: Annotated[str | None, typer.Option(help="Licence of the hand's files.")] = None,
    repair: Annotated[
        bool,
        typer.Option("--repair", help="Write a copy of the hand that the simulator takes, and use it."),
    ] = False,
    force: Annotated[bool, typer.Option("--force", help="Replace what is there.")] = False,
) -> None:
    """Write the file of a gripper, with a picture beside it:
    what flags say, the rest guessed from the URDF, each line with its reason.

    --repair writes a copy of the hand beside the file, with masses where there are none, meshes in metres,
    hollow ones in convex parts, and the base link in the middle of the fingers.

    Example: qdgrasp gripper new my_hand.urdf --licence BSD-3-Clause --repair
    """  # noqa: D205  # typer joins the lines
    given = DraftOverrides(
        licence=licence,
        base_link=base_link,
        approach_axis=approach_axis,
        opened=parse_positions("open", opened or ()),
        closed=parse_positions("closed", closed or ()),
        finger_roots=tuple(finger or ()),
        not_closing=tuple(not_closing or ()),
    )
    target = out or Path(urdf.with_suffix(".toml").name)
    file = OutFile(target, suffixes=(".toml",), force=force, inputs=(urdf,))
    file.check()
    asset_commands.picture_file(target.parent, target.name, "--out").check()
    with ExitStack() as until_written:
        robot, given = _usable_robot(_single_tree(urdf), given, file, until_written, repair=repair)
        made = draft_gripper(robot, _reference(robot.path, target), given)
        found = examine_hand(robot, made.file, str(target), made.warnings)
        asset_commands.print_findings(found)
        asset_commands.refuse_faulty("gripper", found, "was not written")
        file.write(draft_toml(made, target.name).encode())
    echo(f"written: {target}")
    hand = read_gripper(target, target.stem, target.name)
    echo(f"drawn: {asset_commands.draw_asset(hand, target.name, target.parent)}")
    echo("look at it: does the arrow go from the palm to the fingertips, and do the fingers close on it?")
    echo(f"next: qdgrasp run --gripper {shlex.quote(str(target))} --object mug")


@gripper_app.command()
def check(
    name: Annotated[
        str,
        typer.Argument(
            metavar="NAME|TOML|URDF|MJCF", help="A gripper; of a URDF or MJCF file the rest is guessed."
        ),
    ],
    picture: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Draw it open and closed, with its frames.")
    ] = None,
    as_json: options.Json = False,
) -> None:
    """Say what a gripper is and all that is wrong with it, and draw it.

    It ends with exit code 2 where the gripper cannot be used.

    Example: qdgrasp gripper check my_hand.toml --picture pictures
    """
    if picture is not None:
        asset_commands.picture_file(picture, name).check()
    if name.lower().endswith((".urdf", ".xacro", ".xml", ".sdf")):  # of a URDF alone, as it is guessed
        found, hand = examine_urdf(Path(name).expanduser(), name)
    else:
        found, hand = examine_gripper(name), None
    asset_commands.print_findings(found, as_json=as_json)
    if picture is not None and (hand is not None or found.extents is not None):
        drawn = asset_commands.draw_asset(hand or find_gripper(name), name, picture)
        echo(f"drawn: {drawn}", err=as_json)
    asset_commands.refuse_faulty("gripper", found)


def _single_tree(urdf: Path) -> Urdf:
    robot, found, translated = read_hand(urdf)
    if robot is None:
        raise AssetError(f"The URDF '{urdf}' cannot be used: {'; and '.join(found)}.")
    for sentence in translated:
        echo(f"read: {sentence}")
    return robot


def _usable_robot(
    robot: Urdf, given: DraftOverrides, file: OutFile, until_written: ExitStack, *, repair: bool
) -> tuple[Urdf, DraftOverrides]:
    """The robot, or a repaired copy of its hand, with the base link that is to be used.

    A hand of an MJCF file is always copied, to a URDF. The copy goes where `until_written` fails.
    """
    base, reason = (given.base_link, given.base_reason) if given.base_link else guess_base(robot)
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
    OutFile(repaired_urdf(file.path), force=file.force).check()
    OutFolder(repaired_meshes(file.path), force=file.force, is_kind=lambda _: True).check()
    may_centre = repair and given.base_link is None
    file.path.absolute().parent.mkdir(parents=True, exist_ok=True)
    repairing = repaired_copy(
        robot,
        base,
        file.path,
        lambda sentence: echo(f"{sentence} ...", err=True),
        may_centre=may_centre,
        overrides=given,
        as_it_is=not repair,
    )
    copy = until_written.enter_context(repairing)
    for change in copy.changes or (("nothing had to be",) if repair else ()):
        echo(f"repaired: {change}")
    echo(f"written: {repaired_urdf(file.path)}")
    return copy.robot, replace(
        given, base_link=copy.base, base_reason=reason if copy.base == base else copy.changes[-1]
    )


def _reference(urdf: Path, target: Path) -> str:
    """Return the URDF's path as the file names it: relative if it lies below the file's folder."""
    whole, folder = urdf.resolve(), target.resolve().parent
    return str(whole.relative_to(folder) if whole.is_relative_to(folder) else whole)
