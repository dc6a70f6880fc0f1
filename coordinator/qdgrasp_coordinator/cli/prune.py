"""`qdgrasp prune`: finished runs without their failures."""

from pathlib import Path
from typing import Annotated

import typer

from qdgrasp_coordinator.folders.folder import RunFolder
from qdgrasp_coordinator.folders.job_folder import JobFolder
from qdgrasp_protocol.phrases import counted

LEAST = 50_000
"""So many bytes are told as 0.1 MB."""


def prune(
    directory: Annotated[Path, typer.Argument(metavar="DIR", help="A run's folder, or a campaign's.")],
) -> None:
    """Drop the failures of finished runs for good; successes, their trials and all figures stay.

    A pruned run cannot be gone on with and has no digest; it has curves where every genome counts as an
    evaluation (overlaps = "count"). Of a campaign's runs those that are not finished stay as they are.

    Example: qdgrasp prune runs/demo
    """
    from qdgrasp_coordinator.keeping.pruning import (
        prune as prune_run,  # the archives' libraries take their time
    )
    from qdgrasp_coordinator.keeping.pruning import prune_all

    is_campaign = JobFolder.is_job(directory) and JobFolder(directory).is_campaign
    if not is_campaign:
        freed = prune_run(RunFolder.open(directory))
        typer.echo(f"{_room(freed)}; {directory} keeps successes alone.")
        return
    done = prune_all(JobFolder(directory))
    kept = counted(done.runs, "run keeps", "runs keep")
    typer.echo(f"{_room(done.freed)}; {done.pruned} of {kept} successes alone.")


def _room(freed: int) -> str:
    """How much room there is now, by the bytes that were freed; of a small run it may be less than before."""
    return f"{freed / 1e6:.1f} MB are free" if freed >= LEAST else "Hardly any room is free"
