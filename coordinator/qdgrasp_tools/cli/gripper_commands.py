"""`qdgrasp gripper`: write the file of a custom hand with guessed values, and check it."""

import math
import os
import shlex
from collections.abc import Iterable
from contextlib import ExitStack
from itertools import islice
from pathlib import Path
from typing import Annotated

import typer

from qdgrasp_assets.asset_report import examine_gripper, examine_hand, examine_urdf
from qdgrasp_assets.catalog import find_gripper
from qdgrasp_assets.gripper_setup.draft import DraftOverrides, draft_gripper, draft_toml
from qdgrasp_assets.gripper_setup.repaired_copy import repaired_urdf
from qdgrasp_assets.grippers.gripper import read_gripper
from qdgrasp_coordinator.storage.hand_files import read_tree, relative_name, usable_robot
from qdgrasp_coordinator.storage.outputs import OutFile
from qdgrasp_protocol.cli_support import echo
from qdgrasp_protocol.errors import AssetError, ImpossibleValue
from qdgrasp_protocol.process import lifetime
from qdgrasp_protocol.text import parse_numbers
from qdgrasp_tools.cli import asset_commands, options
from qdgrasp_tools.local.progress import progress_messages
from qdgrasp_tools.verification.hand_test import try_hand

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
    package_path: Annotated[
        list[Path] | None,
        typer.Option(metavar="DIR", help="A folder of ROS packages, which meshes or a xacro file name."),
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

    At the end the hand closes on a ball and a box that fit it in the simulator; where it holds neither, or a
    finger never touches, the exit code is 2.

    --repair writes a copy of the hand beside the file, with masses where there are none, meshes in metres,
    hollow ones in convex parts, and the base link in the middle of the fingers.

    Example: qdgrasp gripper new my_hand.urdf --licence BSD-3-Clause --repair
    """  # noqa: D205  # typer joins the lines
    places = [*map(str, package_path or ()), os.environ.get("ROS_PACKAGE_PATH", "")]
    os.environ["ROS_PACKAGE_PATH"] = os.pathsep.join(places)
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
        until_written.enter_context(progress_messages())(f"looking at {urdf}")
        robot, given = usable_robot(read_tree(urdf, echo), given, file, until_written, echo, repair=repair)
        if robot.path == repaired_urdf(target):
            echo(f"written: {robot.path}")
        made = draft_gripper(robot, relative_name(robot.path, target), given)
        found = examine_hand(robot, made.file, str(target), made.warnings)
        asset_commands.print_findings(found)
        asset_commands.refuse_faulty("gripper", found, "was not written")
        file.write(draft_toml(made, target.name).encode())
    echo(f"written: {target}")
    hand = read_gripper(target, target.stem, target.name)
    echo(f"drawn: {asset_commands.draw_asset(hand, target.name, target.parent)}")
    echo("look at it: does the arrow go from the palm to the fingertips, and do the fingers close on it?")
    with lifetime("qdgrasp gripper new") as stop:
        tested = try_hand(hand, target, made.closing, stop)
    if tested is None:
        raise typer.Exit(stop.exit_code)
    if tested.fault:
        raise AssetError(
            f"The hand of '{target}' does not grasp: {tested.fault}. Look at its picture, and make the file "
            f"again with --force and one of these: {'; '.join(islice(tested.flags(), 3))}."
        )
    echo("tested: it holds a ball and a box that fit it, and all of its fingers touch them")
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
    with progress_messages() as tell:
        tell(f"looking at {name}")
        if options.is_robot_file(name):
            found, hand = examine_urdf(Path(name).expanduser(), name)
        else:
            found, hand = examine_gripper(name), None
    asset_commands.print_findings(found, as_json=as_json)
    if picture is not None and (hand is not None or found.facts):
        drawn = asset_commands.draw_asset(hand or find_gripper(name), name, picture)
        echo(f"drawn: {drawn}", err=as_json)
    asset_commands.refuse_faulty("gripper", found)
