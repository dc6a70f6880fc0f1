"""Jobs that this process coordinates itself, with workers on this machine.

The coordinator, the bus, the recorder and the workers are those of every run.
"""

import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from qdgrasp_coordinator.scheduler.coordinator_service import CoordinatorService
from qdgrasp_coordinator.scheduler.recorder_client import MemorySink, RowSink
from qdgrasp_coordinator.scheduler.run_plan import RunPlan, RunQueue, SingleRunQueue, plan_genomes
from qdgrasp_coordinator.search.fixed_poses import HandPoses
from qdgrasp_coordinator.storage.run_folder import PreparedScene
from qdgrasp_protocol.bus import Bus
from qdgrasp_protocol.process import Stop
from qdgrasp_protocol.rows import GIVEN, Rows
from qdgrasp_protocol.spec import RunSpec
from qdgrasp_protocol.supervisor import ProcessSupervisor
from qdgrasp_protocol.zenoh_bus import ZenohBus
from qdgrasp_tools.local.progress import ProgressDisplay
from qdgrasp_tools.local.supervisor import GRACE, JobRestarts, LocalJobConfig, start_worker


@dataclass(frozen=True)
class LocalSession:
    """A bus session and the processes started for a job; made by `open_session`."""

    job: str
    """Its name on the bus."""
    bus: Bus
    endpoint: str
    """Address that processes connect to."""
    credential_flags: Sequence[str]
    """Flags of all processes; empty: links are not encrypted."""
    processes: ProcessSupervisor
    display: ProgressDisplay
    restarts: JobRestarts

    def start_recorder(self, out: Path) -> None:
        """Start a recorder that writes to the folder of a job."""
        flags = [*self._connection_flags, "--out", str(out)]
        self.processes.start("recorder", "qdgrasp_tools.cli.recorder_process", flags)

    def start_workers(self, count: int) -> None:
        """Start so many workers."""
        for number in range(count):
            start_worker(self.processes, number, self._connection_flags)

    def coordinate(
        self,
        queue: RunQueue,
        make_record: Callable[[RunPlan], RowSink],
        stop: Stop,
        batch_size: int | None = None,
        on_step: Callable[[], None] = lambda: None,
    ) -> None:
        """Carry out a queue of runs in this thread, until it is done or the job is ended.

        `make_record` makes the sink of a run's rows; `batch_size` is in rows, None: measured; `on_step` is
        called at every step. Raises EndedEarly if the job was cancelled, or processes die again and again,
        and RunsFailed if runs could not be carried out.
        """
        service = CoordinatorService(
            self.bus,
            stop,
            job=self.job,
            queue=queue,
            make_sink=make_record,
            batch_size=batch_size,
        )

        def step(now: float) -> None:
            figures = service.status(now)
            self.restarts.note_progress(figures)
            self.restarts.check(now)
            self.display.show(figures)
            on_step()

        service.run(step)

    @property
    def _connection_flags(self) -> list[str]:
        return ["--connect", self.endpoint, "--job", self.job, *self.credential_flags]


@contextmanager
def open_session(
    job: str,
    logs: Path,
    display: ProgressDisplay,
    bus: ZenohBus,
    endpoint: str,
    credential_flags: Sequence[str] = (),
) -> Iterator[LocalSession]:
    """Open a job's session; leaving it ends the started processes and the bus session.

    Each process has a log in the folder `logs`; `bus` is opened here.
    """
    with bus, ProcessSupervisor(logs, GRACE) as processes:
        restarts = JobRestarts(processes, display)
        yield LocalSession(job, bus, endpoint, credential_flags, processes, display, restarts)


def run_temporary_job(
    job: str,
    queue: RunQueue,
    make_record: Callable[[RunPlan], RowSink],
    config: LocalJobConfig,
    display: ProgressDisplay,
    stop: Stop,
) -> None:
    """Carry out a queue of runs with workers of this machine, until a signal comes.

    `job` is its name on the bus, which no other process uses. Raises as `LocalSession.coordinate`.
    """
    with (
        tempfile.TemporaryDirectory(prefix="qdgrasp-") as logs,
        open_session(job, Path(logs), display, *ZenohBus.embedded(None)) as here,
    ):
        here.start_workers(max(1, config.workers))
        here.coordinate(queue, make_record, stop, config.batch_size)


SCORING_JOB = "evaluate"


def score_poses(
    spec: RunSpec,
    prepared: PreparedScene,
    poses: HandPoses,
    config: LocalJobConfig,
    display: ProgressDisplay,
    stop: Stop,
) -> Rows:
    """Evaluate poses with a scene's gripper and object; returns rows in journal order."""
    plan = plan_genomes(spec, prepared, GIVEN, poses.genomes(prepared.scene))
    memory, queue = MemorySink(plan.shape), SingleRunQueue(lambda: plan, len(poses))
    run_temporary_job(SCORING_JOB, queue, lambda _: memory, config, display, stop)
    return memory.rows
