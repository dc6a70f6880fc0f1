"""`qdgrasp verify`: whether recorded rows are evaluated the same again."""

import json
from pathlib import Path
from typing import Annotated

import msgspec
import typer

from qdgrasp_coordinator.cli import options
from qdgrasp_coordinator.looking.verification import choose, repeat, run_folders
from qdgrasp_coordinator.watching.progress import display
from qdgrasp_coordinator.watching.supervisor import Team
from qdgrasp_protocol.errors import InputError
from qdgrasp_protocol.lifetime import lifetime

SAMPLE = 100


def verify(
    directory: Annotated[Path, typer.Argument(metavar="DIR", help="The folder of a run, or of a campaign.")],
    sample: Annotated[
        int | None, typer.Option(metavar="N", min=1, help=f"How many rows; default {SAMPLE}.")
    ] = None,
    seed: Annotated[int, typer.Option(min=0, help="Another seed draws other rows.")] = 0,
    every: Annotated[bool, typer.Option("--all", help="Evaluate every row again.")] = False,
    workers: options.Workers = None,
    batch_size: options.BatchSize = None,
    as_json: options.Json = False,
) -> None:
    """Evaluate recorded rows again, and compare every result with the recorded one, bit for bit.

    Rows are drawn from all runs in the folder, of each outcome as many as of any other, trials apart; each
    goes through its own prior, genome and trial. Where something differs, the rows and columns are named, and
    how this platform differs from the one that they were made on. Exit code 0: all the same; 1: not all.

    Example: qdgrasp verify runs/demo --sample 500
    """
    if every and sample is not None:
        raise InputError("--all leaves nothing to --sample: give one of them.")
    team = Team(options.cores() if workers is None else workers, batch_size)
    folders = run_folders(directory)
    lots = choose(folders, None if every else sample or SAMPLE, seed)
    with (
        display("verify", sum(len(lot.numbers) for lot in lots)) as shown,
        lifetime("qdgrasp verify") as stop,
    ):
        found = repeat(lots, team, shown, stop)
    if stop.is_set:
        raise typer.Exit(stop.exit_code)
    typer.echo(json.dumps(msgspec.to_builtins(found)) if as_json else found.table)
    if not found.is_same:
        raise typer.Exit(1)
