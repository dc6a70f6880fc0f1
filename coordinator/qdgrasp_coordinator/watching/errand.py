"""An errand: a job whose result is wanted at once, and not kept, by the command that carries it out."""

import tempfile
from collections.abc import Callable
from pathlib import Path

from qdgrasp_coordinator.campaigns.programme import Programme
from qdgrasp_coordinator.runs.assignment import Assignment
from qdgrasp_coordinator.serving.record import Record
from qdgrasp_coordinator.watching import stage
from qdgrasp_coordinator.watching.progress import Display
from qdgrasp_coordinator.watching.supervisor import Team
from qdgrasp_protocol.lifetime import Stop
from qdgrasp_protocol.zenoh_bus import ZenohBus


def run_errand(
    job: str,
    programme: Programme,
    make_record: Callable[[Assignment], Record],
    team: Team,
    display: Display,
    stop: Stop,
) -> None:
    """Carry all runs of a programme out with workers of this machine, until they are done or a signal comes.

    Parameters
    ----------
    job
        What it is called on the bus, where nobody else is.
    make_record
        Where the rows of a run go.

    Raises
    ------
    EndedEarly
        Workers die again and again.
    RunsFailed
        Runs could not be carried out.
    """
    with (
        tempfile.TemporaryDirectory(prefix="qdgrasp-") as logs,
        stage.opened(job, Path(logs), display, *ZenohBus.embedded(None)) as here,
    ):
        here.hire_workers(max(1, team.workers))
        here.coordinate(programme, make_record, stop, team.batch_size)
