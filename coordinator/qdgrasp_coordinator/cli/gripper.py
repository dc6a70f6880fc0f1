"""`qdgrasp gripper`: a hand of one's own: guess how it grasps, and say what is wrong with it."""

import shlex
import sys
from collections.abc import Iterable
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import Annotated

import typer

from qdgrasp_assets.catalog import find_gripper
from qdgrasp_assets.check import examine_gripper
from qdgrasp_assets.gripper import Gripper
from qdgrasp_assets.hands.base import guess_base
from qdgrasp_assets.hands.copies import mended_copy, mended_meshes, mended_urdf
from qdgrasp_assets.hands.draft import Told, draft
from qdgrasp_assets.hands.examination import Examination, examine_hand, examine_urdf, hand_faults, read_robot
from qdgrasp_assets.hands.source import read_source
from qdgrasp_assets.hands.writing import toml
from qdgrasp_assets.urdf import Urdf
from qdgrasp_coordinator.cli import findings, options, pictures, wizard
from qdgrasp_coordinator.folders import disk
from qdgrasp_coordinator.folders.outputs import OutFile, OutFolder, SharedFolder
from qdgrasp_protocol.errors import AssetError

app = typer.Typer(no_args_is_help=True, help="Hands of one's own: make their files, and check them.")


@app.command()
def new(
    urdf: Annotated[Path, typer.Argument(metavar="URDF", help="The hand, or a robot that ends in one.")],
    out: Annotated[
        Path | None,
        typer.Option(
            "--out",
            "-o",
            metavar="FILE.toml",
            help="What to write; its folder is made; default: the URDF's name, here.",
        ),
    ] = None,
    base_link: Annotated[str | None, typer.Option(help="The link that the hand hangs on.")] = None,
    approach_axis: Annotated[
        str | None, typer.Option(metavar="X,Y,Z", help="From the palm to the object, base link's frame.")
    ] = None,
    palm_offset: Annotated[
        float | None, typer.Option(min=0, help="From the base link to the palm along that axis [m].")
    ] = None,
    standoff: Annotated[
        str | None, typer.Option(metavar="LEAST,MOST", help="From the palm to the surface point [m].")
    ] = None,
    fingers: Annotated[
        str | None, typer.Option(metavar="LINK,...", help="The links whose touch makes a success.")
    ] = None,
    opened: Annotated[
        list[str] | None, typer.Option("--open", metavar="JOINT=POSITION,...", help="Where joints are open.")
    ] = None,
    closed: Annotated[
        list[str] | None,
        typer.Option("--closed", metavar="JOINT=POSITION,...", help="Where joints close to."),
    ] = None,
    free: Annotated[
        str | None, typer.Option(metavar="JOINT,...", help="Joints whose place is a gene; '' for none.")
    ] = None,
    licence: Annotated[str | None, typer.Option(help="Licence of the hand's files.")] = None,
    mend: Annotated[
        bool, typer.Option("--mend", help="Write a copy of the hand that the simulator can take, and use it.")
    ] = False,
    yes: Annotated[bool, typer.Option("--yes", "-y", help="Ask nothing: take the guesses.")] = False,
    force: Annotated[bool, typer.Option("--force", help="Replace what is there.")] = False,
) -> None:
    """Write the file of a gripper: what flags say, the rest guessed from the URDF, each line with its reason.

    On a terminal it asks, with the guesses as defaults. --mend writes a copy of the hand beside the file,
    with masses where there are none, meshes in metres, hollow ones in convex parts, and the base link in the
    middle of the fingers.

    Example: qdgrasp gripper new my_hand.urdf --licence BSD-3-Clause --mend
    """
    told = Told(
        licence=licence,
        base_link=base_link,
        approach_axis=None if approach_axis is None else wizard.vector("approach-axis", approach_axis),
        palm_offset=palm_offset,
        standoff=None if standoff is None else wizard.pair("standoff", standoff),
        finger_links=None if fingers is None else wizard.words("fingers", fingers),
        opened=wizard.positions("open", opened or ()),
        closed=wizard.positions("closed", closed or ()),
        free=None if free is None else wizard.words("free", free),
    )
    target = out or Path(urdf.with_suffix(".toml").name)
    file = OutFile(target, suffixes=(".toml",), force=force, inputs=(urdf,))
    file.check()
    robot, asks = _whole(urdf), is_asked() and not yes
    with ExitStack() as until_written:
        robot, told = _usable(robot, told, file, until_written, mend=mend, asks=asks)
        reference = _reference(robot.path, target)
        told = wizard.ask(robot, reference, told) if asks else told
        made = draft(robot, reference, told)
        found = examine_hand(robot, made.file, str(target))
        findings.tell(found)
        findings.refuse("gripper", found, "was not written")
        file.write(toml(made, target.name).encode())
    typer.echo(f"written: {target}")
    typer.echo(f"look at it: qdgrasp gripper check {shlex.quote(str(target))} --picture pictures")
    typer.echo(f"next: qdgrasp run --gripper {shlex.quote(str(target))} --object mug")


@app.command()
def check(
    name: Annotated[
        str, typer.Argument(metavar="NAME|TOML|URDF", help="A gripper; of a URDF alone the rest is guessed.")
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
    drawing = pictures.picture_folder(picture, "--picture", [name])
    found, hand = _examined(name)
    findings.tell(found, as_json=as_json)
    if drawing is not None and found.extents is not None:
        typer.echo(f"drawn: {_drawn(hand or find_gripper(name), name, drawing)}", err=as_json)
    findings.refuse("gripper", found)


def is_asked() -> bool:
    """Whether a person sits at the other end of standard input."""
    return sys.stdin.isatty()


def _examined(name: str) -> tuple[Examination, Gripper | None]:
    """What is found of a gripper by its name or file; and the gripper that a URDF alone would make."""
    if name.lower().endswith((".urdf", ".xacro", ".xml", ".sdf")):
        return examine_urdf(Path(name).expanduser(), name)
    return examine_gripper(name), None


def _check_copy(file: OutFile) -> None:
    """Refuse to write over a mended copy that is there, unless the gripper's file is replaced too."""
    OutFile(mended_urdf(file.path), force=file.force).check()
    OutFolder(mended_meshes(file.path), force=file.force, is_kind=lambda _: True).check()


def _whole(urdf: Path) -> Urdf:
    """The robot of a URDF that is one tree."""
    robot, found = read_robot(urdf, read_source(urdf))
    if robot is None:
        raise AssetError(f"The URDF '{urdf}' cannot be used: {'; and '.join(found)}.")
    return robot


def _usable(
    robot: Urdf, told: Told, file: OutFile, until_written: ExitStack, *, mend: bool, asks: bool
) -> tuple[Urdf, Told]:
    """The robot, or a mended copy of its hand, with the base link that is to be used.

    The copy goes where `until_written` ends with an error.
    """
    base, reason = (told.base_link, told.base_reason) if told.base_link else guess_base(robot)
    if base not in robot.links:
        return robot, told
    found = hand_faults(robot, base)
    if found and not mend:
        mend = asks and _wants_copy(found)
    if found and not mend:
        raise AssetError(
            f"The URDF '{robot.path}' cannot be used as it is: {'; and '.join(found)}. "
            "--mend writes a copy of the hand in which what can be mended is."
        )
    if not mend:
        return robot, told
    _check_copy(file)
    may_centre = told.base_link is None
    until_written.enter_context(disk.way(file.path.absolute().parent))
    copy = until_written.enter_context(mended_copy(robot, base, file.path, _tell, may_centre=may_centre))
    for change in copy.changes or ("nothing had to be",):
        typer.echo(f"mended: {change}")
    typer.echo(f"written: {mended_urdf(file.path)}")
    return copy.robot, replace(
        told, base_link=copy.base, base_reason=reason if copy.base == base else copy.changes[-1]
    )


def _wants_copy(found: Iterable[str]) -> bool:
    for fault in found:
        typer.echo(f"WRONG {fault}", err=True)
    return typer.confirm("Write a mended copy of the hand, and use that?", default=True)


def _tell(sentence: str) -> None:
    typer.echo(f"{sentence} ...", err=True)


def _reference(urdf: Path, target: Path) -> str:
    """How the file names its URDF: from its own folder where that is below it, else by the whole path."""
    whole, folder = urdf.resolve(), target.resolve().parent
    return str(whole.relative_to(folder) if whole.is_relative_to(folder) else whole)


def _drawn(hand: Gripper, name: str, folder: SharedFolder) -> Path:
    """The picture of a gripper."""
    # matplotlib takes half a second to import, and most commands draw nothing
    from qdgrasp_coordinator.analysis.portrait import draw_gripper

    drawn = pictures.picture(folder, name)
    with drawn.writing() as made:
        draw_gripper(hand.on_carrier("paper"), made)
    return drawn.path
