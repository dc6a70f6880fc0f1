"""One machine: coordinator, recorder and workers on loopback, started and watched together.

The same processes, commands and messages as on many machines; there is no second code path.
"""

import os
import shlex
import time
from collections.abc import Iterable
from contextlib import ExitStack, suppress
from dataclasses import dataclass, replace
from pathlib import Path
from queue import Empty, SimpleQueue

from qdgrasp_coordinator.metrics.job_status import JobStatus, from_json
from qdgrasp_coordinator.storage.job_folder import JobFolder
from qdgrasp_protocol.bus import Sample
from qdgrasp_protocol.engines import DEVICE_ENGINE, DEVICE_VARIABLE, check_engine
from qdgrasp_protocol.errors import (
    EXTRAS,
    EndedEarly,
    EndpointError,
    InputError,
    MessageError,
    check_packages,
)
from qdgrasp_protocol.keys import Keys
from qdgrasp_protocol.process import Stop
from qdgrasp_protocol.session import Credentials, Role, parse_endpoints
from qdgrasp_protocol.spec import RunSpec
from qdgrasp_protocol.supervisor import ProcessExit, ProcessSupervisor
from qdgrasp_protocol.zenoh_bus import ZenohBus
from qdgrasp_tools.local.progress import ProgressDisplay

LOOK_INTERVAL = 0.2  # seconds between two looks at the processes
SESSION_SECONDS = 2.0  # seconds that one try to open a session at the coordinator may take


@dataclass(frozen=True)
class ListenConfig:
    """Listening address of a job, and its security."""

    endpoint: str | None = None
    """Endpoint of the embedded router; None: the default port on loopback, or a free one."""
    security: Path | None = None
    """Folder of certificates; None: links are not encrypted."""
    insecure: bool = False
    """Listen also where strangers get to."""

    @property
    def flags(self) -> list[str]:
        """Flags of the coordinator, besides `security_flags`."""
        listen = ["--listen", self.endpoint] if self.endpoint else []
        return [*listen, *(["--insecure"] if self.insecure else [])]

    @property
    def security_flags(self) -> list[str]:
        """Flags of every process."""
        return ["--security", str(self.security)] if self.security else []


@dataclass(frozen=True)
class LocalJobConfig:
    """Resources and limits of a job on this machine; no result depends on them."""

    workers: int
    batch_size: int | None = None
    """Rows in a batch; None: measured."""
    listen: ListenConfig = ListenConfig()
    seconds: float | None = None
    """After so long the job ends, done or not; None: when it is done."""

    def check_engines(self, specs: Iterable[RunSpec]) -> None:
        """Raise an InputError if workers start here and lack the engine or the device of a run."""
        if self.workers:
            check_engines(specs)


def check_engines(specs: Iterable[RunSpec]) -> None:
    """Raise an InputError if workers that start here lack the engine or the device of a run."""
    for spec in specs:
        check_engine(spec.engine)
        if spec.engine == DEVICE_ENGINE and not os.environ.get(DEVICE_VARIABLE):
            raise InputError(
                f"The engine {DEVICE_ENGINE} needs a worker with a device: set {DEVICE_VARIABLE}=cuda for "
                "those started here, or start none here (workers 0) and `qdgrasp-worker --device cuda` "
                "elsewhere."
            )
        if spec.engine == DEVICE_ENGINE:
            check_packages(f"The engine {DEVICE_ENGINE}", *EXTRAS["gpu"])


GRACE = 1.2
"""Seconds that a command's processes have to stop, of the two of the command itself.

One that takes longer is killed, which loses nothing but its time.
"""
COORDINATOR = "coordinator"


def start_worker(processes: ProcessSupervisor, number: int, flags: Iterable[str]) -> None:
    """Start a worker that leaves before it would be killed."""
    grace = ["--grace", f"{processes.children_grace:g}"]
    processes.start(f"worker-{number}", "qdgrasp_worker.cli", [*flags, *grace])


class JobRestarts:
    """Starts processes of a job again that died.

    A process that was killed, or that ended without a sentence, is started again after a while. A coordinator
    that ended with a sentence has decided to; the job then ends with that sentence.
    """

    def __init__(self, processes: ProcessSupervisor, display: ProgressDisplay) -> None:
        self._processes = processes
        self._display = display
        self._most = -1
        self.is_done = False
        """The coordinator ended with its job complete, or after the seconds that it was given."""

    def note_progress(self, figures: JobStatus) -> None:
        """Record the job's figures; progress resets the counts of deaths."""
        if figures.evaluations + figures.trials > self._most:
            self._most = figures.evaluations + figures.trials
            self._processes.note_progress()

    def check(self, now: float) -> None:
        """Take the deaths since the last call, and start the processes that are due.

        Raises InputError if a process ended with a sentence that names bad input or environment, and
        EndedEarly if the coordinator ended by decision or order, or a process dies again and again.
        """
        for death in self._processes.exits():
            if death.name == COORDINATOR:
                self._on_coordinator(death, now)
            elif death.exit_code == 0:
                self._display.say(f"{death.name} has left")  # a worker that was asked to
            elif not self.is_done:
                if death.exit_code == InputError.exit_code and not self._processes.is_dead(COORDINATOR):
                    raise InputError(death.words or _silence(death))
                self._restart(death, now)
        self._processes.restart_due(now)

    def _on_coordinator(self, death: ProcessExit, now: float) -> None:
        if death.exit_code == InputError.exit_code:
            raise InputError(death.words or _silence(death))
        if death.words:
            raise EndedEarly(death.words)
        self.is_done = death.exit_code == 0
        if not self.is_done:
            self._restart(death, now)

    def _restart(self, death: ProcessExit, now: float) -> None:
        pause = self._processes.restart_later(death, now)
        self._display.say(f"{death.name} {death.description}; it is started again in {pause:.1f} s")


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
        self._credentials = Credentials.find(config.listen.security, Role.MONITOR)
        self._listen = config.listen
        self._began = time.monotonic()
        self._near = ""  # Where processes of this machine find the coordinator; empty: it does not listen yet
        self._is_paused = False

    def run(self) -> None:
        """Carry the job out to its end.

        Raises EndedEarly if the job was cancelled, or processes die again and again (`qdgrasp resume` goes
        on), and InputError if a process ended with a sentence that names bad input or environment.
        """
        self._stop.tell(lambda: self._news.put(None))
        with ExitStack() as stack:
            stack.enter_context(self._folder.supervise())
            stack.callback(self._folder.forget_endpoint)
            processes = stack.enter_context(ProcessSupervisor(self._folder.logs, GRACE))
            restarts = JobRestarts(processes, self._display)
            processes.start(COORDINATOR, "qdgrasp_tools.cli.coordinator_process", self._next_coordinator)
            bus: ZenohBus | None = None
            while self._goes_on(restarts):
                if not self._near and (endpoint := self._folder.endpoint) is not None:
                    self._start_members(processes, endpoint)
                if self._near and bus is None and (bus := self._opened_session()) is not None:
                    stack.enter_context(bus)
                    stack.enter_context(bus.subscribe(Keys(self._folder.name).stat("job"), self._news.put))
                    stack.callback(processes.request_stop)  # while the session is being closed
                with suppress(Empty):
                    self._take(self._news.get(timeout=LOOK_INTERVAL), restarts)

    def _goes_on(self, restarts: JobRestarts) -> bool:
        """Take deaths, and start processes again; False once the job is over."""
        if not self._stop.is_set:
            self._folder.check_there()
            restarts.check(time.monotonic())
        return not (self._stop.is_set or restarts.is_done)

    def _opened_session(self) -> ZenohBus | None:
        """Open the session that hears the job's figures, from this coordinator and later ones.

        None where that fails: the recorder, which fails for the same reason, ends the job with it.
        """
        with suppress(EndpointError, SystemExit):
            return ZenohBus.connect(self._near, SESSION_SECONDS, self._stop, self._credentials)
        return None

    def _next_coordinator(self) -> list[str]:
        """Forget where the last coordinator listened; return the arguments of the next."""
        self._folder.forget_endpoint()
        arguments = [str(self._folder.path), *self._listen.flags, *self._listen.security_flags]
        if self._config.batch_size:
            arguments += ["--batch-size", str(self._config.batch_size)]
        if self._config.seconds is not None:
            left = self._config.seconds - (time.monotonic() - self._began)
            arguments += ["--seconds", str(max(0.0, left))]
        if self._is_paused:
            arguments.append("--paused")
        return arguments

    def _say_commands(self, endpoint: str) -> None:
        """Tell by which commands the job is watched, and joined by more workers."""
        flags = " ".join(map(shlex.quote, self._listen.security_flags))
        reached = ",".join(place.from_elsewhere for place in parse_endpoints(endpoint))
        watch = f"qdgrasp-monitor {shlex.quote(str(self._folder.path))} {flags}".rstrip()
        join = f"qdgrasp-worker --connect {reached} --job {self._folder.name} {flags}".rstrip()
        self._display.say(f"watch it by `{watch}`, add workers by `{join}`")

    def _start_members(self, processes: ProcessSupervisor, endpoint: str) -> None:
        """Start the recorder and the workers at the endpoint of the coordinator, now and later."""
        self._display.say(f"listening on {endpoint}, records in {self._folder.path}")
        self._say_commands(endpoint)
        self._listen = replace(self._listen, endpoint=endpoint)
        self._near = parse_endpoints(endpoint)[0].from_here
        recorder = [*self._connection_flags, "--out", str(self._folder.path)]
        processes.start("recorder", "qdgrasp_tools.cli.recorder_process", recorder)
        for number in range(self._config.workers):
            start_worker(processes, number, self._connection_flags)

    @property
    def _connection_flags(self) -> list[str]:
        return ["--connect", self._near, "--job", self._folder.name, *self._listen.security_flags]

    def _take(self, news: Sample | None, restarts: JobRestarts) -> None:
        """Show the figures that came, if they are some."""
        with suppress(MessageError):
            if news is not None:
                figures = from_json(news.payload, JobStatus)
                self._is_paused = figures.state == "paused"
                restarts.note_progress(figures)
                self._display.show(figures)
