"""`qdgrasp campaign`: many runs from one file, on one pool of workers."""

from pathlib import Path
from typing import Annotated

import typer

from qdgrasp_coordinator.campaigns.campaign import Campaign, read_campaign
from qdgrasp_coordinator.campaigns.campaign_folder import begin, open_campaign
from qdgrasp_coordinator.campaigns.campaign_runs import CampaignRuns
from qdgrasp_coordinator.cli import options
from qdgrasp_coordinator.cli.carrying import carry_out, check_not_stopped, going_on
from qdgrasp_coordinator.folders.job_folder import CAMPAIGN, JobFolder
from qdgrasp_coordinator.watching.progress import display
from qdgrasp_coordinator.watching.supervisor import Door, Team
from qdgrasp_protocol import flags
from qdgrasp_protocol.errors import InputError
from qdgrasp_protocol.lifetime import lifetime


def campaign(
    what: Annotated[
        Path, typer.Argument(metavar="FILE.toml|DIR", help="The campaign, or the folder of one that began.")
    ],
    out: Annotated[Path | None, typer.Option(help="The campaign's folder; default runs/<file>.")] = None,
    successes: options.Successes = None,
    no_new_cell: options.NoNewCell = None,
    seconds: options.Seconds = None,
    workers: options.Workers = None,
    batch_size: options.BatchSize = None,
    listen: options.Listen = None,
    security: flags.Security = None,
    insecure: flags.Insecure = False,
    job: Annotated[str | None, typer.Option(help="Name on the bus; default: the folder's name.")] = None,
    disk_wait: options.DiskWait = 60.0,
    list_runs: Annotated[bool, typer.Option("--list", help="Print the runs, and do nothing.")] = False,
) -> None:
    """Carry out all runs of a campaign; one that was stopped goes on, and finished runs are not repeated.

    The file crosses grippers, objects, methods, seeds and any other keys of a spec; see docs/campaigns.md.
    --successes and --no-new-cell replace what its [defaults] say; a [[cross]] with its own keeps that.

    Example: qdgrasp campaign deploy/campaigns/paper-small.toml --out runs/paper-small
    """
    path = _place(what, out)
    goals = {"successes": successes, "no_new_cell": no_new_cell}
    asked = read_campaign(open_campaign(what).path / CAMPAIGN if what.is_dir() else what, goals=goals)
    if list_runs:
        show(asked)
        return
    extent = begin(path, asked, job)
    folder = JobFolder(path)
    door = Door(listen, security, insecure)
    count = options.cores() if workers is None else workers
    team = Team(count, batch_size, door, disk_wait, seconds)
    with lifetime("qdgrasp campaign") as stop, display(path.name, asked.evaluations) as shown:
        shown.say(asked.words)
        if extent.runs_done:
            shown.say(f"{extent.runs_done} of {extent.runs} runs are finished already")
        if extent.runs_done < extent.runs:
            carry_out(folder, team, shown, stop)
    check_not_stopped(folder, stop)
    finish(folder, asked)


def _place(what: Path, out: Path | None) -> Path:
    """The campaign's folder."""
    if not what.is_dir():
        return out or Path("runs") / what.stem
    if out is not None:
        raise InputError(f"{what} is a campaign's folder, and goes on where it is; leave --out out.")
    return what


def show(asked: Campaign) -> None:
    """Print the runs of a campaign."""
    for name, spec in asked.runs.items():
        typer.echo(f"{name}  {spec.evaluations}")
    typer.echo(asked.words)


def finish(folder: JobFolder, asked: Campaign) -> None:
    """Print what was found."""
    found = CampaignRuns(folder, asked.runs).extent
    if found.runs_done < found.runs:
        typer.echo(f"Not all runs are finished; {going_on(folder)}")
    typer.echo(
        f"{found.runs_done} of {found.runs} runs with {found.done.evaluations} evaluations: "
        f"{found.done.successes} successes in {found.done.cells} cells, {found.done.screened}. "
        f"`qdgrasp analyse {folder.path}` draws the figures."
    )
