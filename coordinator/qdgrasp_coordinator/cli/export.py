"""`qdgrasp export`: grasps of a run in a file of another tool's format."""

from pathlib import Path
from typing import Annotated

import typer

from qdgrasp_coordinator.cli import options
from qdgrasp_coordinator.folders.folder import RunFolder
from qdgrasp_coordinator.watching.telling import telling


def export(
    directory: options.RunDir,
    name: Annotated[
        str, typer.Option("--format", help="One of isaac, acronym, graspgen, parquet, moveit, csv.")
    ],
    out: Annotated[
        Path,
        typer.Option(
            "--out",
            "-o",
            metavar="OUT",
            help="The file, for graspgen a folder; those that it lies in are made.",
        ),
    ],
    min_fitness: Annotated[
        int, typer.Option(min=0, max=2, help="Shakes survived, at least; 0 takes all successes.")
    ] = 1,
    top: Annotated[
        int | None, typer.Option(min=1, metavar="N", help="Only the N best: by eta, fitness, penetration.")
    ] = None,
    diverse: Annotated[
        int | None,
        typer.Option(min=1, metavar="N", help="Only N, spread as far as can be; of the best if --top."),
    ] = None,
    frame: Annotated[
        str, typer.Option(help="Where poses are told: the object's mesh file (mesh) or centre of mass (com).")
    ] = "mesh",
    negatives: Annotated[
        int | None,
        typer.Option(
            min=0, metavar="N", help="Failures written too, at most; default: all in graspgen, else 0."
        ),
    ] = None,
    force: Annotated[bool, typer.Option("--force", help="Replace OUT if it is there.")] = False,
) -> None:
    """Write the grasps of a run to a file that other tools read.

    Every file says which frames its poses are told in, the order of quaternions, scale, what success means,
    and under which licence the assets are. A run that goes on gives what it has recorded by now.

    Example: qdgrasp export runs/demo --format isaac -o grasps.yaml
    """
    from qdgrasp_coordinator.exchange.exporting import export as export_run  # takes its time to load

    with telling() as tell:
        written = export_run(
            RunFolder.open(directory),
            out,
            name,
            min_fitness=min_fitness,
            top=top,
            diverse=diverse,
            frame=frame,
            negatives=negatives,
            force=force,
            tell=tell,
        )
    typer.echo(written)
