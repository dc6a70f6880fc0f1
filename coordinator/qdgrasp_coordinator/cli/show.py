"""`qdgrasp show`: everything known about one grasp of a run."""

import json
from typing import Annotated

import msgspec
import typer

from qdgrasp_coordinator.analysis.profile import profile
from qdgrasp_coordinator.cli import options
from qdgrasp_coordinator.folders.folder import RunFolder


def show(
    directory: options.RunDir,
    grasp: Annotated[int, typer.Option(metavar="N", min=0, help="The row's number in the journal, from 0.")],
    as_json: options.Json = False,
) -> None:
    """Print everything known about one grasp of a run, or about any other row of its journal.

    Rows are counted as the monitor's view in 3D counts them. Poses are in the object's centre-of-mass frame,
    quaternions in the order x, y, z, w.

    Example: qdgrasp show runs/demo --grasp 17
    """
    found = profile(RunFolder.open(directory), grasp)
    if as_json:
        typer.echo(json.dumps(msgspec.to_builtins(found)))
    else:
        typer.echo(found.table)
