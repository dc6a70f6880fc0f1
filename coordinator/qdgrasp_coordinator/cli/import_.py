"""`qdgrasp import`: grasps of another tool's file as poses to evaluate."""

import shlex
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from qdgrasp_assets.units import scale_of
from qdgrasp_coordinator.cli import options
from qdgrasp_coordinator.folders.outputs import OutFile
from qdgrasp_coordinator.watching.telling import telling
from qdgrasp_protocol.phrases import counted
from qdgrasp_protocol.spec import RunSpec

if TYPE_CHECKING:
    from qdgrasp_coordinator.exchange.importing import Imported


def import_(
    file: Annotated[
        Path,
        typer.Argument(metavar="FILE", help="ACRONYM, GraspGen JSON, Isaac Grasp YAML, or Parquet of ours."),
    ],
    gripper: Annotated[str, typer.Option(help="Gripper: a built-in name or a TOML file.")],
    object_: Annotated[str, typer.Option("--object", help="Object: a built-in name or a mesh file.")],
    out: Annotated[
        Path,
        typer.Option(
            "--out", "-o", metavar="OUT", help="The poses: an npz file for `evaluate`; its folder is made."
        ),
    ],
    scale: options.Scale = None,
    units: options.Units = None,
    frame: Annotated[
        str | None,
        typer.Option(help="Where poses are told, mesh or com; default: as the file says, else mesh."),
    ] = None,
    force: Annotated[bool, typer.Option("--force", help="Replace OUT if it is there.")] = False,
) -> None:
    """Turn a file of grasps, of ours or of others, into poses that `qdgrasp evaluate` scores again.

    The poses are those of the hand's root link in the object's centre-of-mass frame, as they are simulated.

    Example: qdgrasp import grasps.yaml --gripper panda --object mug -o poses.npz
    """
    from qdgrasp_coordinator.exchange.frames import frame_of  # takes its time to load
    from qdgrasp_coordinator.exchange.importing import read_grasps
    from qdgrasp_coordinator.exchange.things import hand_of, thing_of

    output = OutFile(out, force=force, inputs=(file, Path(gripper), Path(object_)))
    output.check()
    metres = scale_of(units, scale)
    told_in = None if frame is None else frame_of(frame)
    with telling() as tell:
        tell(f"reading {file}")
        found = read_grasps(file, hand_of(gripper), thing_of(object_, metres), told_in)
    flags = {"gripper": gripper, "object": object_, "scale": metres} | _conditions(found, object_)
    flags |= {"poses": out, "out": out.with_name(f"{out.stem}-scores.npz")}
    found.write(output)
    for note in found.notes:
        typer.echo(note, err=True)
    words = [word for name, value in flags.items() if value is not None for word in (f"--{name}", str(value))]
    typer.echo(f"{counted(len(found), 'pose')} written to {out}; this scores them:")
    typer.echo(f"  qdgrasp evaluate {shlex.join(words)}")


def _conditions(found: "Imported", object_: str) -> dict[str, object]:
    """What the file says that its grasps were found under, as flags."""
    about = found.about
    spec = about.runs[0].asked if about and about.runs else RunSpec(gripper="", object="")
    mass = about.object_mass if about else found.mass or "KG"
    return {
        "mass": mass if Path(object_).suffix else spec.mass,
        "friction": spec.friction if about else found.friction,
        "protocol": None if spec.protocol == "paper" else spec.protocol,
    }
