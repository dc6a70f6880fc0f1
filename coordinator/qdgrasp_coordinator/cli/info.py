"""`qdgrasp info`: what a run is and has found."""

import json

import msgspec
import typer

from qdgrasp_coordinator.campaigns.summary import summary
from qdgrasp_coordinator.cli import options
from qdgrasp_coordinator.folders.folder import RunFolder


def info(directory: options.RunDir, as_json: options.Json = False) -> None:
    """Say what a run is and what it has found, also while it goes on.

    Example: qdgrasp info runs/demo --json
    """
    found = summary(RunFolder.open(directory))
    if as_json:
        typer.echo(json.dumps(msgspec.to_builtins(found)))
    else:
        typer.echo(found.table)
