"""One machine: coordinator, recorder and workers on loopback, started and watched together.

The same processes, commands and messages as on many machines; there is no second code path. `Supervisor` has
the coordinator in a process of its own, `LocalSession` in this one.
"""

import json
import os
import secrets
import shlex
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from queue import Empty, SimpleQueue

import numpy as np
from numpy.typing import NDArray

from qdgrasp_coordinator.metrics.job_status import JobStatus, from_json
from qdgrasp_coordinator.scheduler.coordinator_service import CoordinatorService
from qdgrasp_coordinator.scheduler.recorder_client import RowSink
from qdgrasp_coordinator.scheduler.run_plan import NamedRunQueue, RunPlan, RunQueue, plan_genomes
from qdgrasp_coordinator.storage.job_folder import RUN, JobFolder
from qdgrasp_coordinator.storage.outputs import ENDPOINT
from qdgrasp_coordinator.storage.run_folder import PreparedScene
from qdgrasp_protocol.bus import Bus, Sample
from qdgrasp_protocol.errors import (
    EXTRAS,
    EndedEarly,
    EndpointError,
    InputError,
    MessageError,
    check_packages,
)
from qdgrasp_protocol.keys import Keys
from qdgrasp_protocol.messages import TRUST_VARIABLE
from qdgrasp_protocol.process import OUTSIDE_CODES, ProcessExit, ProcessSupervisor, Stop, check_workers
from qdgrasp_protocol.rows import GIVEN, Rows
from qdgrasp_protocol.session import Credentials, Role, parse_endpoints
from qdgrasp_protocol.spec import (
    DEVICE_ENGINE,
    DEVICE_VARIABLE,
    ENGINES,
    ENGINES_VARIABLE,
    RunSpec,
    check_engine,
)
from qdgrasp_protocol.zenoh_bus import ZenohBus
from qdgrasp_tools.local.progress import ProgressDisplay

LOOK_INTERVAL = 0.05  # seconds between two looks at the processes
SESSION_SECONDS = 2.0  # seconds that one try to open a session at the coordinator may take


@dataclass(frozen=True)
class LocalJobConfig:
    """Resources, address and limits of a job on this machine; no result depends on them."""

    workers: int
    listen: str | None = None
    """Endpoint of the embedded router; None: the default port on loopback, or a free one."""
    security: Path | None = None
    """Folder of certificates; None: links are not encrypted."""
    insecure: bool = False
    """Listen also where strangers get to."""
    seconds: float | None = None
    """After so long the job ends, done or not; None: when it is done."""

    engines: Sequence[str] = ENGINES
    """Those of its runs, which its workers serve."""

    def __post_init__(self) -> None:
        check_workers(self.workers)

    @property
    def security_flags(self) -> list[str]:
        """Flags of every process."""
        return ["--security", str(self.security)] if self.security else []


def check_engines(specs: Iterable[RunSpec], workers: int = 1) -> None:
    """Raise an InputError if workers start here, and lack the engine or the device of a run."""
    for spec in specs if workers else ():
        check_engine(spec.engine)
        if spec.engine == DEVICE_ENGINE and not os.environ.get(DEVICE_VARIABLE):
            raise InputError(
                f"The engine {DEVICE_ENGINE} needs a worker with a device: set {DEVICE_VARIABLE}=cuda for "
                "those started here, or start none here (workers 0) and `qdgrasp-worker --device cuda` "
                "elsewhere."
            )
        if spec.engine == DEVICE_ENGINE:
            check_packages(f"The engine {DEVICE_ENGINE}", *EXTRAS["gpu"])


SELF_TEST_SECONDS, DEVICE_SECONDS = 60, 900  # Without a device, and with one, which compiles first [s]


def local_platform() -> dict[str, str]:
    """Return what decides the bits of results on this machine, by a worker's self-test.

    Raises InputError where that fails.
    """
    command = [sys.executable, "-m", "qdgrasp_worker.cli", "--self-test"]
    seconds = DEVICE_SECONDS if os.environ.get(DEVICE_VARIABLE) else SELF_TEST_SECONDS
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=seconds, check=False)
    except subprocess.TimeoutExpired:
        raise InputError(f"The probe set took more than {seconds} s.") from None
    if done.returncode:
        raise InputError((done.stderr.strip().splitlines() or ["The worker ended without a word."])[-1])
    return dict(json.loads(done.stdout.strip().splitlines()[-1]))


GRACE = 1.2
"""Seconds that a command's processes have to stop, of the two of the command itself.

One that takes longer is killed, which loses nothing but its time.
"""
COORDINATOR = "coordinator"


@dataclass
class JobProcesses:
    """The processes of a job, started again when they die.

    A process that was killed, or that ended without a sentence, is started again after a while. A coordinator
    that ended with a sentence has decided to; the job then ends with that sentence.
    """

    processes: ProcessSupervisor
    display: ProgressDisplay
    job: str
    """Its name on the bus."""
    endpoint: str
    """Address that processes connect to, or the file that it is going to be written to."""
    security_flags: Sequence[str] = ()
    is_done: bool = False
    """The coordinator ended with its job complete, or after the seconds that it was given."""
    _most: int = -1
    _reasons: dict[str, str] = field(default_factory=dict)  # Of processes' last errors since progress

    def start_recorder(self, out: Path) -> None:
        """Start a recorder that writes to the folder of a job."""
        arguments = ["recorder", *self._connection_flags, "--out", str(out)]
        self.processes.start("recorder", "qdgrasp_tools.cli.job_processes", lambda: arguments)

    def start_workers(self, count: int, first: int = 0) -> None:
        """Start workers up to so many from `first` on; they leave before they would be killed."""
        flags = [*self._connection_flags, "--grace", f"{self.processes.children_grace:g}"]
        for number in range(first, count):
            self.processes.start(f"worker-{number}", "qdgrasp_worker.cli", lambda: flags)

    @property
    def _connection_flags(self) -> list[str]:
        return ["--connect", self.endpoint, "--job", self.job, *self.security_flags]

    def note_progress(self, figures: JobStatus) -> None:
        """Record the job's figures; progress resets the counts of deaths."""
        if figures.evaluations + figures.trials > self._most:
            self._most = figures.evaluations + figures.trials
            self.processes.note_progress()
            self._reasons.clear()

    def check(self, now: float) -> None:
        """Take the deaths since the last call, and start the processes that are due.

        Raises InputError if a process ended with a sentence that names bad input or environment, and
        EndedEarly if the coordinator ended by decision or order, or a process dies again and again; an
        InputError too if one failed twice for the same reason, without progress.
        """
        for death in self.processes.exits():
            if death.name == COORDINATOR:
                self._on_coordinator(death, now)
            elif death.exit_code == 0:
                self.display.say(f"{death.name} has left")  # a worker that was asked to
            elif not self.is_done:
                if death.exit_code == InputError.exit_code and not self.processes.is_dead(COORDINATOR):
                    raise InputError(death.words or _silence(death))
                self._restart(death, now)
        self.processes.restart_due(now)

    def _on_coordinator(self, death: ProcessExit, now: float) -> None:
        if death.exit_code == InputError.exit_code:
            raise InputError(death.words or _silence(death))
        if death.words:
            raise EndedEarly(death.words)
        self.is_done = death.exit_code == 0
        if not self.is_done:
            self._restart(death, now)

    def _restart(self, death: ProcessExit, now: float) -> None:
        reason = death.words
        if death.exit_code not in OUTSIDE_CODES and death.exit_code > 0:
            reason = reason or death.last_line
            if reason and reason == self._reasons.get(death.name):
                raise InputError(f"The {death.name} {death.description} twice for the same reason: {reason}")
            self._reasons[death.name] = reason
        pause = self.processes.restart_later(death, now)
        why = f" ({reason.rstrip('.')})" if reason else ""
        self.display.say(f"{death.name} {death.description}{why}; it is started again in {pause:.1f} s")


def _silence(death: ProcessExit) -> str:
    return f"The {death.name} {death.description}, and its log does not say why: it is gone, or empty."


class Supervisor:
    """Starts a job's processes, shows its progress, and ends them with it."""

    def __init__(
        self, folder: JobFolder, config: LocalJobConfig, display: ProgressDisplay, stop: Stop
    ) -> None:
        self._folder = folder
        self._config = config
        self._display = display
        self._stop = stop
        self._news: SimpleQueue[Sample | None] = SimpleQueue()  # Figures of the job; None: a signal
        self._credentials = Credentials.find(config.security, Role.MONITOR)
        self._listen = config.listen  # Later, where the first coordinator listened
        self._began = time.monotonic()
        self._is_paused = False

    def run(self) -> None:
        """Carry the job out to its end.

        Raises EndedEarly if the job was cancelled, or processes die again and again (`qdgrasp resume` goes
        on), and InputError if a process ended with a sentence that names bad input or environment.
        """
        self._stop.tell(lambda: self._news.put(None))
        if self._config.workers:  # those of this machine check the rows of others
            os.environ.setdefault(TRUST_VARIABLE, secrets.token_hex(16))
        with ExitStack() as stack:
            os.environ[ENGINES_VARIABLE] = ",".join(self._config.engines)
            stack.callback(os.environ.pop, ENGINES_VARIABLE)
            stack.enter_context(self._folder.supervise())
            stack.callback(self._folder.forget_endpoint)
            self._folder.forget_endpoint()
            processes = stack.enter_context(ProcessSupervisor(self._folder.logs, GRACE))
            flags = self._config.security_flags
            endpoint_file = str(self._folder.path.absolute() / ENDPOINT)
            job = JobProcesses(processes, self._display, self._folder.name, endpoint_file, flags)
            processes.start(COORDINATOR, "qdgrasp_tools.cli.job_processes", self._next_coordinator)
            # They load while it does: as many as it leaves cores for, so that the first row comes soon.
            early = min(self._config.workers, max(1, len(os.sched_getaffinity(0)) - 1))
            job.start_workers(early)
            job.start_recorder(self._folder.path)
            bus: ZenohBus | None = None
            while self._goes_on(job):
                if bus is None and (bus := self._opened_session(job)) is not None:
                    stack.enter_context(bus)
                    stack.enter_context(bus.subscribe(Keys(job.job).stat("job"), self._news.put))
                    stack.callback(processes.request_stop)  # while the session is being closed
                    job.start_workers(self._config.workers, first=early)
                with suppress(Empty):
                    self._take(self._news.get(timeout=LOOK_INTERVAL), job)

    def _goes_on(self, job: JobProcesses) -> bool:
        """Take deaths, and start processes again; False once the job is over."""
        if not self._stop.is_set:
            self._folder.check_there()
            job.check(time.monotonic())
        return not (self._stop.is_set or job.is_done)

    def _opened_session(self, job: JobProcesses) -> ZenohBus | None:
        """Open the session that hears the job's figures, from this coordinator and later ones.

        None where no coordinator listens yet, or that fails: the recorder, which fails for the same reason,
        ends the job with it.
        """
        if (endpoint := self._folder.endpoint) is None:
            return None
        with suppress(EndpointError, SystemExit):
            bus = ZenohBus.connect(job.endpoint, SESSION_SECONDS, self._stop, self._credentials)
            self._announce(job, endpoint)
            return bus
        return None

    def _next_coordinator(self) -> list[str]:
        """Return the arguments of the next coordinator, which listens where the last did."""
        self._listen = self._folder.endpoint or self._listen
        self._folder.forget_endpoint()
        arguments = ["coordinator", str(self._folder.path), *self._config.security_flags]
        arguments += ["--listen", self._listen] if self._listen else []
        arguments += ["--insecure"] if self._config.insecure else []
        arguments += ["--paused"] if self._is_paused else []
        if self._config.seconds is not None:
            left = self._config.seconds - (time.monotonic() - self._began)
            arguments += ["--seconds", str(max(0.0, left))]
        return arguments

    def _announce(self, job: JobProcesses, endpoint: str) -> None:
        """Tell how the job is watched, and joined by more workers."""
        flags = " ".join(map(shlex.quote, self._config.security_flags))
        reached = ",".join(place.reached_from(here=False) for place in parse_endpoints(endpoint))
        watch = f"qdgrasp-monitor {shlex.quote(str(self._folder.path))} {flags}".rstrip()
        join = f"qdgrasp-worker --connect {reached} --job {job.job} {flags}".rstrip()
        self._display.say(f"listening on {endpoint}, records in {self._folder.path}")
        self._display.say(f"watch it by `{watch}`, add workers by `{join}`")

    def _take(self, news: Sample | None, job: JobProcesses) -> None:
        """Show the figures that came, if they are some."""
        with suppress(MessageError):
            if news is not None:
                figures = from_json(news.payload, JobStatus)
                self._is_paused = figures.state == "paused"
                job.note_progress(figures)
                self._display.show(figures)


class LocalSession(JobProcesses):
    """A job that this process coordinates itself, and its processes; made by `open_session`."""

    bus: Bus

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
            self.bus, stop, job=self.job, queue=queue, make_sink=make_record, batch_size=batch_size
        )

        def step(now: float) -> None:
            figures = service.scheduler.status(now)
            self.note_progress(figures)
            self.check(now)
            self.display.show(figures)
            on_step()

        service.run(step)


@contextmanager
def open_session(
    job: str,
    logs: Path,
    display: ProgressDisplay,
    bus: ZenohBus,
    endpoint: str,
    security_flags: Sequence[str] = (),
) -> Iterator[LocalSession]:
    """Open a job's session; leaving it ends the started processes and the bus session.

    Each process has a log in the folder `logs`; `bus` is opened here.
    """
    with bus, ProcessSupervisor(logs, GRACE) as processes:
        session = LocalSession(processes, display, job, endpoint, security_flags)
        session.bus = bus
        yield session


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
        here.coordinate(queue, make_record, stop)


def score_genomes(
    spec: RunSpec,
    prepared: PreparedScene,
    genomes: NDArray[np.float32],
    config: LocalJobConfig,
    display: ProgressDisplay,
    stop: Stop,
) -> Rows:
    """Evaluate genomes (n, d) of the prior `given` in a scene; returns rows in journal order."""
    plan = plan_genomes(spec, prepared, GIVEN, genomes)
    memory, queue = RowSink(plan.shape), NamedRunQueue(lambda _: plan, {RUN: len(genomes)})
    run_temporary_job("evaluate", queue, lambda _: memory, config, display, stop)
    return memory.rows
