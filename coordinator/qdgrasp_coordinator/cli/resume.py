"""`qdgrasp resume`: go on with a run, or extend a finished one."""

from typing import Annotated

import typer

from qdgrasp_coordinator.campaigns.budget import extend
from qdgrasp_coordinator.campaigns.summary import summary
from qdgrasp_coordinator.cli import options
from qdgrasp_coordinator.cli.carrying import carry_out
from qdgrasp_coordinator.cli.run import finish, show_ranking
from qdgrasp_coordinator.folders.folder import RunFolder
from qdgrasp_coordinator.watching.progress import display
from qdgrasp_coordinator.watching.supervisor import Door, Team
from qdgrasp_protocol import flags
from qdgrasp_protocol.errors import FolderError
from qdgrasp_protocol.lifetime import lifetime
from qdgrasp_protocol.phrases import counted


def resume(
    directory: options.RunDir,
    evaluations: Annotated[
        int | None, typer.Option(help="The new total of counted evaluations; default: the spec's.")
    ] = None,
    successes: options.Successes = None,
    no_new_cell: options.NoNewCell = None,
    seconds: options.Seconds = None,
    workers: options.Workers = None,
    batch_size: options.BatchSize = None,
    listen: options.Listen = None,
    security: flags.Security = None,
    insecure: flags.Insecure = False,
    disk_wait: options.DiskWait = 60.0,
) -> None:
    """Go on with a run where its journal ends; --evaluations extends a finished one.

    So do --successes and --no-new-cell where a run ended with these.

    Example: qdgrasp resume runs/panda-mug-aimed-s0 --evaluations 20000
    """
    folder = RunFolder.open(directory)
    check_own_job(folder)
    folder.job.check_not_in_use()
    with folder.journal() as journal:
        journal.check_whole()
    asked = {"evaluations": evaluations, "successes": successes, "no_new_cell": no_new_cell}
    if goals := {key: value for key, value in asked.items() if value is not None}:
        extend(folder, **goals)
    found = summary(folder)
    if found.complete:
        typer.echo(f"{directory} is finished: {found.words}")
        show_ranking(folder)
        return
    door = Door(listen, security, insecure)
    count = options.cores() if workers is None else workers
    team = Team(count, batch_size, door, disk_wait, seconds)
    with lifetime("qdgrasp resume") as stop, display(directory.name, folder.spec.evaluations) as shown:
        shown.say(f"going on after {counted(found.evaluations, 'evaluation')}")
        carry_out(folder.job, team, shown, stop)
    finish(folder, stop)


def check_own_job(folder: RunFolder) -> None:
    """Check that a run is a job of its own.

    Raises
    ------
    FolderError
        It is one of a campaign's.
    """
    if folder.job.is_campaign:
        raise FolderError(
            f"{folder.path} is a run of a campaign: `qdgrasp campaign {folder.job.path}` goes on with it."
        )
