"""A stage: a job that this very process coordinates, and the processes that it has started for it.

The coordinator, the bus, the recorder and the workers are those of every run.
"""

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from qdgrasp_coordinator.campaigns.programme import Programme
from qdgrasp_coordinator.runs.assignment import Assignment
from qdgrasp_coordinator.serving.record import Record
from qdgrasp_coordinator.serving.service import CoordinatorService
from qdgrasp_coordinator.watching.progress import Display
from qdgrasp_coordinator.watching.watch import Watch
from qdgrasp_coordinator.watching.workers import GRACE, hire_worker
from qdgrasp_protocol.bus import Bus
from qdgrasp_protocol.crew import Crew
from qdgrasp_protocol.lifetime import Stop
from qdgrasp_protocol.zenoh_bus import ZenohBus


@dataclass(frozen=True)
class Stage:
    """A session on the bus, and processes that are looked after; made by `opened`."""

    job: str
    """What it is called on the bus."""
    bus: Bus
    endpoint: str
    """Where processes find it."""
    proof: Sequence[str]
    """The flags with which they show who they are; none: links are not encrypted."""
    crew: Crew
    display: Display
    watch: Watch

    def hire_recorder(self, out: Path) -> None:
        """Start a recorder that writes to the folder of a job."""
        self.crew.hire("recorder", "qdgrasp_coordinator.cli.recorder", [*self._meeting, "--out", str(out)])

    def hire_workers(self, count: int) -> None:
        """Start workers."""
        for number in range(count):
            hire_worker(self.crew, number, self._meeting)

    def coordinate(
        self,
        programme: Programme,
        make_record: Callable[[Assignment], Record],
        stop: Stop,
        batch_size: int | None = None,
        look: Callable[[], None] = lambda: None,
    ) -> None:
        """Carry all runs of a programme out, in this thread, until they are done or somebody wants an end.

        Parameters
        ----------
        make_record
            Where the rows of a run go.
        batch_size
            Rows in a batch; None: measured.
        look
            Called at every step.

        Raises
        ------
        EndedEarly
            The job was cancelled, or processes die again and again.
        RunsFailed
            Runs could not be carried out.
        """
        service = CoordinatorService(
            self.bus,
            stop,
            job=self.job,
            programme=programme,
            make_record=make_record,
            batch_size=batch_size,
        )

        def step(now: float) -> None:
            figures = service.figures(now)
            self.watch.progressed(figures)
            self.watch.look(now)
            self.display.show(figures)
            look()

        service.run(step)

    @property
    def _meeting(self) -> list[str]:
        return ["--connect", self.endpoint, "--job", self.job, *self.proof]


@contextmanager
def opened(
    job: str, logs: Path, display: Display, bus: ZenohBus, endpoint: str, proof: Sequence[str] = ()
) -> Iterator[Stage]:
    """Set a stage up; leaving it ends the processes that were started, and the session.

    Parameters
    ----------
    logs
        The folder in which each process has a log.
    bus
        A session that is begun with the stage.
    """
    with bus, Crew(logs, GRACE) as crew:
        yield Stage(job, bus, endpoint, proof, crew, display, Watch(crew, display))
