"""`qdgrasp campaign`: many runs from one file, or of the meshes in a folder, on one pool of workers."""

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

import typer

from qdgrasp_assets.units import scale_of
from qdgrasp_coordinator.campaigns.campaign import Campaign, read_campaign
from qdgrasp_coordinator.campaigns.campaign_folder import begin, open_campaign
from qdgrasp_coordinator.campaigns.campaign_runs import CampaignRuns
from qdgrasp_coordinator.campaigns.meshes import Weighing, check_meshes, of_folder
from qdgrasp_coordinator.cli import options
from qdgrasp_coordinator.cli.carrying import carry_out, check_not_stopped, going_on
from qdgrasp_coordinator.folders.job_folder import JobFolder
from qdgrasp_coordinator.folders.names import CAMPAIGN
from qdgrasp_coordinator.watching.progress import display
from qdgrasp_coordinator.watching.supervisor import Door, Team
from qdgrasp_protocol import flags
from qdgrasp_protocol.errors import InputError
from qdgrasp_protocol.lifetime import lifetime
from qdgrasp_protocol.phrases import counted


def campaign(
    what: Annotated[
        Path | None,
        typer.Argument(metavar="[FILE.toml|DIR]", help="The campaign, or the folder of one that began."),
    ] = None,
    objects: Annotated[
        Path | None,
        typer.Option(metavar="DIR", help="In place of a file: a run of every mesh in this folder."),
    ] = None,
    gripper: Annotated[
        list[str] | None,
        typer.Option(help="With --objects: a built-in name or a TOML file; may be repeated."),
    ] = None,
    mass: Annotated[
        float | None, typer.Option(help="With --objects: of each [kg] that masses.csv there does not name.")
    ] = None,
    density: Annotated[
        float | None, typer.Option(min=1, help="With --objects: the same by volume [kg/m3]; water: 1000.")
    ] = None,
    scale: options.Scale = None,
    units: options.Units = None,
    method: Annotated[
        list[str] | None, typer.Option(help="With --objects: search method; may be repeated.")
    ] = None,
    seed: Annotated[
        list[int] | None, typer.Option(help="With --objects: may be repeated; default 0.")
    ] = None,
    protocol: options.ProtocolOption = None,
    evaluations: Annotated[
        int | None, typer.Option(help="With --objects: counted evaluations of each run; default 10000.")
    ] = None,
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

    With --objects there is no file: every mesh in a folder is grasped. What they weigh stands in a table in
    it, masses.csv, with the columns file and mass [kg], or is said for all of them.

    Example: qdgrasp campaign deploy/campaigns/paper-small.toml --out runs/paper-small

    Example: qdgrasp campaign --gripper panda --objects parts --units mm --density 1200 --out runs/parts
    """
    goals = {"successes": successes, "no_new_cell": no_new_cell}
    keys = {
        "gripper": gripper,
        "method": method,
        "seed": seed,
        "protocol": protocol,
        "evaluations": evaluations,
    }
    weighing, metres = Weighing(mass, density), scale_of(units, scale)
    if objects is None:
        _check_left_out({**keys, "mass": mass, "density": density, "scale": metres})
        asked = _read(what, goals)
    else:
        _check_alone(what, weighing)
        asked = of_folder(objects, weighing, metres, {**keys, **goals})
    path = _place(what, objects, out)
    if list_runs:
        show(asked)
        return
    if not JobFolder.is_job(path):
        check_meshes(asked.runs.values())
    extent = begin(path, asked, job)
    folder = JobFolder(path)
    door = Door(listen, security, insecure)
    count = options.cores() if workers is None else workers
    team = Team(count, batch_size, door, disk_wait, seconds)
    with lifetime("qdgrasp campaign") as stop, display(path.name, asked.evaluations) as shown:
        shown.say(asked.words)
        if extent.runs_done:
            shown.say(f"{extent.runs_done} of {counted(extent.runs, 'run is', 'runs are')} finished already")
        if extent.runs_done < extent.runs:
            carry_out(folder, team, shown, stop)
    check_not_stopped(folder, stop)
    finish(folder, asked)


def _read(what: Path | None, goals: Mapping[str, int | None]) -> Campaign:
    """The campaign of a file, or of the folder of one that began."""
    if what is None:
        raise InputError(
            "No campaign is named: give its file or its folder, or a folder of meshes with --objects."
        )
    return read_campaign(open_campaign(what).path / CAMPAIGN if what.is_dir() else what, goals=goals)


def _check_left_out(said: Mapping[str, Any]) -> None:
    """Check that nothing is said that a campaign's file says itself."""
    for key, value in said.items():
        if value is not None:
            raise InputError(
                f"--{key} goes with --objects DIR: a campaign's file says its own, see docs/campaigns.md."
            )


def _check_alone(what: Path | None, weighing: Weighing) -> None:
    if what is not None:
        raise InputError(f"--objects is a campaign of its own: leave out '{what}', or --objects.")
    if None not in (weighing.mass, weighing.density):
        raise InputError("--mass and --density say the same of each object: give one of them.")


def _place(what: Path | None, objects: Path | None, out: Path | None) -> Path:
    """The campaign's folder."""
    if what is None or not what.is_dir():
        return out or Path("runs") / (what or objects or Path()).absolute().stem
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
        f"{found.runs_done} of {counted(found.runs, 'run')} with "
        f"{counted(found.done.evaluations, 'evaluation')}: {found.done.found}, {found.done.screened}. "
        f"`qdgrasp analyse {folder.path}` draws the figures."
    )
