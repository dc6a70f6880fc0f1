"""An errand: a job whose result is wanted at once, by the command that carries it out; nothing is recorded.

The coordinator, the bus and the workers are those of a run on this machine.
"""

import tempfile
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path

from qdgrasp_coordinator.campaigns.programme import Programme
from qdgrasp_coordinator.runs.assignment import Assignment
from qdgrasp_coordinator.serving.record import Record
from qdgrasp_coordinator.serving.service import CoordinatorService
from qdgrasp_coordinator.watching.progress import Display
from qdgrasp_coordinator.watching.supervisor import Team
from qdgrasp_coordinator.watching.watch import Watch
from qdgrasp_coordinator.watching.workers import GRACE, hire_worker
from qdgrasp_protocol.crew import Crew
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
    """Carry all runs of a programme out, until they are done or a signal comes.

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
    with ExitStack() as stack:
        logs = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="qdgrasp-")))
        bus, endpoint = ZenohBus.embedded(None)
        stack.enter_context(bus)
        crew = stack.enter_context(Crew(logs, GRACE))
        for number in range(max(1, team.workers)):
            hire_worker(crew, number, ["--connect", endpoint, "--job", job])
        watch = Watch(crew, display)
        service = CoordinatorService(
            bus, stop, job=job, programme=programme, make_record=make_record, batch_size=team.batch_size
        )

        def look(now: float) -> None:
            figures = service.figures(now)
            watch.progressed(figures)
            watch.look(now)
            display.show(figures)

        service.run(look)
