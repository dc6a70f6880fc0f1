"""`qdgrasp resume`: go on with a run, or extend a finished one."""

from typing import Annotated

import typer

from qdgrasp_coordinator.cli import options
from qdgrasp_coordinator.cli.run import carry_out, finish
from qdgrasp_coordinator.folder import RunFolder
from qdgrasp_coordinator.progress import display
from qdgrasp_coordinator.summary import summary
from qdgrasp_coordinator.supervisor import Team
from qdgrasp_coordinator.tally import counted, tally
from qdgrasp_protocol.errors import ImpossibleValue
from qdgrasp_protocol.lifetime import lifetime
from qdgrasp_protocol.spec import run_spec, to_values


def resume(
    directory: options.RunDir,
    evaluations: Annotated[
        int | None, typer.Option(help="The new total of counted evaluations; default: the spec's.")
    ] = None,
    workers: options.Workers = None,
    batch_size: options.BatchSize = None,
    listen: options.Listen = None,
    disk_wait: options.DiskWait = 60.0,
) -> None:
    """Go on with a run where its journal ends; --evaluations extends a finished one.

    Example: qdgrasp resume runs/panda-mug-contact_me_scs-s0 --evaluations 20000
    """
    folder = RunFolder.open(directory)
    folder.job.check_not_in_use()
    if evaluations is not None:
        extend(folder, evaluations)
    found = summary(folder)
    if found.complete:
        typer.echo(f"{directory} is finished: {found.words}")
        return
    team = Team(options.cores() if workers is None else workers, batch_size, listen, disk_wait)
    with lifetime("qdgrasp resume") as stop, display(directory.name, folder.spec.evaluations) as shown:
        shown.say(f"going on after {found.evaluations} evaluations")
        carry_out(folder, team, shown, stop)
    finish(folder, stop.exit_code)


def extend(folder: RunFolder, evaluations: int) -> None:
    """Give a run a new budget.

    Raises
    ------
    ImpossibleValue
        It is no budget, or the journal goes on behind it.
    """
    spec = run_spec(to_values(folder.spec) | {"evaluations": evaluations}, "--evaluations")
    with folder.journal() as journal:
        recorded = tally(spec, journal.blocks())
        last = journal.rows(max(0, journal.count - 1), 1)
    reached = recorded.evaluations + int(len(last) > 0 and not counted(last, spec.overlaps)[0])
    if evaluations < reached:
        raise ImpossibleValue("--evaluations", evaluations, f"at least {reached}, which are recorded")
    folder.rewrite_spec(spec)
