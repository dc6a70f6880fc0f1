"""Jobs that this process coordinates itself, with workers on this machine.

The coordinator, the bus, the recorder and the workers are those of every run.
"""

import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from qdgrasp_assets.scene import Bundle, Scene
from qdgrasp_coordinator.local.progress import ProgressDisplay
from qdgrasp_coordinator.local.restart_policy import GRACE, RestartPolicy, start_worker
from qdgrasp_coordinator.local.supervisor import LocalJobConfig
from qdgrasp_coordinator.scheduler.coordinator_service import CoordinatorService
from qdgrasp_coordinator.scheduler.pipeline import Pipeline
from qdgrasp_coordinator.scheduler.recorder_client import MemorySink, RowSink
from qdgrasp_coordinator.scheduler.run_plan import RunPlan, RunQueue, SingleRunQueue, row_shape
from qdgrasp_coordinator.search.fixed_poses import FixedPoseSearch, HandPoses
from qdgrasp_coordinator.storage.job_folder import RUN
from qdgrasp_protocol.bus import Bus
from qdgrasp_protocol.process import ProcessGroup, Stop
from qdgrasp_protocol.rows import GIVEN, Rows, trial_count
from qdgrasp_protocol.spec import RunSpec, to_toml
from qdgrasp_protocol.zenoh_bus import ZenohBus


@dataclass(frozen=True)
class LocalSession:
    """A bus session and the processes started for a job; made by `opened`."""

    job: str
    """Its name on the bus."""
    bus: Bus
    endpoint: str
    """Address that processes connect to."""
    proof: Sequence[str]
    """Credential flags of the processes; empty: links are not encrypted."""
    crew: ProcessGroup
    display: ProgressDisplay
    watch: RestartPolicy

    def hire_recorder(self, out: Path) -> None:
        """Start a recorder that writes to the folder of a job."""
        self.crew.hire(
            "recorder", "qdgrasp_coordinator.cli.recorder_process", [*self._meeting, "--out", str(out)]
        )

    def hire_workers(self, count: int) -> None:
        """Start workers."""
        for number in range(count):
            start_worker(self.crew, number, self._meeting)

    def coordinate(
        self,
        programme: RunQueue,
        make_record: Callable[[RunPlan], RowSink],
        stop: Stop,
        batch_size: int | None = None,
        look: Callable[[], None] = lambda: None,
    ) -> None:
        """Carry out a programme in this thread, until it is done or the job is ended.

        Parameters
        ----------
        make_record
            Makes the record that takes a run's rows.
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
            queue=programme,
            make_sink=make_record,
            batch_size=batch_size,
        )

        def step(now: float) -> None:
            figures = service.status(now)
            self.watch.progressed(figures)
            self.watch.look(now)
            self.display.show(figures)
            look()

        service.run(step)

    @property
    def _meeting(self) -> list[str]:
        return ["--connect", self.endpoint, "--job", self.job, *self.proof]


@contextmanager
def open_session(
    job: str, logs: Path, display: ProgressDisplay, bus: ZenohBus, endpoint: str, proof: Sequence[str] = ()
) -> Iterator[LocalSession]:
    """Open a job's session; leaving it ends the started processes and the bus session.

    Parameters
    ----------
    logs
        The folder in which each process has a log.
    bus
        A session, opened here.
    """
    with bus, ProcessGroup(logs, GRACE) as crew:
        yield LocalSession(job, bus, endpoint, proof, crew, display, RestartPolicy(crew, display))


def run_temporary_job(
    job: str,
    programme: RunQueue,
    make_record: Callable[[RunPlan], RowSink],
    team: LocalJobConfig,
    display: ProgressDisplay,
    stop: Stop,
) -> None:
    """Carry out a programme with workers of this machine until it is done or a signal comes.

    Parameters
    ----------
    job
        Its name on the bus, which no other process uses.
    make_record
        Makes the record that takes a run's rows.

    Raises
    ------
    EndedEarly
        Workers die again and again.
    RunsFailed
        Runs could not be carried out.
    """
    with (
        tempfile.TemporaryDirectory(prefix="qdgrasp-") as logs,
        open_session(job, Path(logs), display, *ZenohBus.embedded(None)) as here,
    ):
        here.hire_workers(max(1, team.workers))
        here.coordinate(programme, make_record, stop, team.batch_size)


SCORING_JOB = "evaluate"
SCORING_GENERATION = 4096  # Poses handed out before the first result is awaited


def score_poses(
    spec: RunSpec,
    scene: Scene,
    bundle: Bundle,
    poses: HandPoses,
    team: LocalJobConfig,
    display: ProgressDisplay,
    stop: Stop,
) -> Rows:
    """Evaluate poses with a scene's gripper and object; returns rows in journal order."""
    shape = row_shape(scene, GIVEN)
    search = FixedPoseSearch(poses.genomes(scene), SCORING_GENERATION)
    pipeline = Pipeline(
        search, shape, evaluations=len(poses), overlaps="count", trials=trial_count(spec.protocol)
    )
    assignment = RunPlan(RUN, to_toml(spec).encode(), bundle, GIVEN, shape, pipeline, len(poses))
    memory = MemorySink(shape)
    run_temporary_job(
        SCORING_JOB, SingleRunQueue(lambda: assignment, len(poses)), lambda _: memory, team, display, stop
    )
    return memory.rows
