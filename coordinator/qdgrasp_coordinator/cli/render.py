"""`qdgrasp render`: one evaluation carried out again, as a picture or a film."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from qdgrasp_coordinator.cli import options
from qdgrasp_coordinator.folders.folder import RunFolder
from qdgrasp_coordinator.folders.outputs import OutFile
from qdgrasp_protocol.errors import ImpossibleValue, InputError
from qdgrasp_protocol.lifetime import lifetime
from qdgrasp_protocol.phrases import numbers

if TYPE_CHECKING:
    from qdgrasp_coordinator.looking.replaying import Size

What = Literal["all", "closing", "shakes"]


def render(
    directory: options.RunDir,
    grasp: Annotated[int, typer.Option(metavar="N", min=0, help="The row's number in the journal, from 0.")],
    out: Annotated[
        Path,
        typer.Option(
            "--out", "-o", metavar="FILE", help="A picture (.png) or a film (.gif); its folder is made."
        ),
    ],
    trial: Annotated[int | None, typer.Option(min=0, help="Show this trial of the grasp instead.")] = None,
    what: Annotated[
        What | None, typer.Option(help="Which part of the evaluation a film has; default: all.")
    ] = None,
    size: Annotated[str, typer.Option(metavar="WxH", help="Width and height [pixels].")] = "640x560",
    view: Annotated[
        str | None,
        typer.Option(
            "--from",
            metavar="AZIMUTH,ELEVATION",
            help="Where the camera stands about the object's z [deg]; default: where most is seen.",
        ),
    ] = None,
    parts: Annotated[
        bool, typer.Option("--parts", help="Draw the object's convex parts, which are simulated.")
    ] = False,
    force: Annotated[bool, typer.Option("--force", help="Replace a file that is there.")] = False,
) -> None:
    """Carry one evaluation of a run out again and draw it, with its contacts and frames.

    Any row of the journal can be shown, also one that failed. A picture has the hand after closing, or as it
    was placed if it did not close; a film goes through all of it, 3.2 times slower than it was. What is seen
    is compared with what is recorded: where they differ that is said, and the exit code is 1.

    Example: qdgrasp render runs/demo --grasp 17 -o grasp.gif
    """
    from qdgrasp_coordinator.looking.picture import WRITERS  # what draws takes its time to load
    from qdgrasp_coordinator.looking.replaying import Wish
    from qdgrasp_coordinator.looking.showing import explain, show
    from qdgrasp_coordinator.looking.specimen import specimen

    output = OutFile(out, suffixes=tuple(WRITERS), force=force)
    output.check()
    is_film = out.suffix.lower() == ".gif"
    if what is not None and not is_film:
        raise InputError(f"--what chooses a part of a film, and {out} is a picture: name a .gif.")
    wish = Wish(_size(size, out), _view(view), (what or "all") if is_film else None, parts)
    shown = specimen(RunFolder.open(directory), grasp, trial)
    typer.echo(f"replaying row {shown.number} of {directory}", err=True)
    with lifetime("qdgrasp render") as stop:
        unlike = show(shown, wish, output, stop)
        if stop.is_set:
            raise typer.Exit(stop.exit_code)
        if unlike:
            typer.echo(explain(shown, unlike), err=True)
    typer.echo(f"{shown.outcome.name.lower()}, row {shown.number}: drawn in {out}")
    if unlike:
        raise typer.Exit(1)


def _size(text: str, out: Path) -> "Size":
    from qdgrasp_coordinator.looking.picture import LARGEST, SMALLEST
    from qdgrasp_coordinator.looking.replaying import Size

    largest = LARGEST[out.suffix.lower()]
    words = text.lower().split("x")
    if len(words) == 2 and all(word.isdecimal() for word in words):
        size = Size(*map(int, words))
        if SMALLEST.width <= size.width <= largest.width and SMALLEST.height <= size.height <= largest.height:
            return size
    raise ImpossibleValue("--size", text, f"{SMALLEST} to {largest} for a {out.suffix.lower()}")


def _view(text: str | None) -> tuple[float, float] | None:
    if text is None:
        return None
    match numbers(text):
        case [azimuth, elevation] if abs(azimuth) <= 360.0 and abs(elevation) <= 90.0:
            return azimuth, elevation
    raise ImpossibleValue(
        "--from", text, "AZIMUTH,ELEVATION in degrees, -360 to 360 and -90 to 90, as in 40,25"
    )
