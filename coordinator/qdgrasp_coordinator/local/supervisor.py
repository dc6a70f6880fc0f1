"""One machine: a coordinator, a recorder and workers on loopback, started and watched together.

The same processes, commands and messages as on many machines; there is no second code path.
"""

import time
from collections.abc import Callable
from contextlib import AbstractContextManager, ExitStack, nullcontext
from dataclasses import dataclass, replace
from pathlib import Path
from queue import Empty, SimpleQueue

from qdgrasp_coordinator.local.progress import ProgressDisplay
from qdgrasp_coordinator.local.restart_policy import COORDINATOR, GRACE, RestartPolicy, start_worker
from qdgrasp_coordinator.metrics.job_status import JobStatus, from_json
from qdgrasp_coordinator.storage.job_folder import JobFolder
from qdgrasp_protocol.bus import Sample
from qdgrasp_protocol.errors import EndpointError, MessageError
from qdgrasp_protocol.keys import Keys
from qdgrasp_protocol.process import ProcessGroup, Stop
from qdgrasp_protocol.session import Credentials, Role, parse_endpoints
from qdgrasp_protocol.zenoh_bus import ZenohBus

LOOK_INTERVAL = 0.2  # seconds between two looks at the processes


@dataclass(frozen=True)
class ListenConfig:
    """Listening address of a job, and its security."""

    listen: str | None = None
    """Endpoint of the embedded router; None: the default port on loopback, or a free one."""
    security: Path | None = None
    """Folder of certificates; None: links are not encrypted."""
    insecure: bool = False
    """Listen also where strangers get to."""

    @property
    def flags(self) -> list[str]:
        """Flags of the coordinator, besides `proof`."""
        listen = ["--listen", self.listen] if self.listen else []
        return [*listen, *(["--insecure"] if self.insecure else [])]

    @property
    def proof(self) -> list[str]:
        """Flags of every process."""
        return ["--security", str(self.security)] if self.security else []


@dataclass(frozen=True)
class LocalJobConfig:
    """Resources and limits of a job on this machine; no result depends on them."""

    workers: int
    batch_size: int | None = None
    """Rows in a batch; None: measured."""
    door: ListenConfig = ListenConfig()
    disk_wait: float = 60.0
    """Seconds that a full disk is waited for."""
    seconds: float | None = None
    """After so long the job ends, done or not; None: when it is done."""


class Supervisor:
    """Starts a job's processes, shows its progress, and ends them with it."""

    def __init__(self, folder: JobFolder, team: LocalJobConfig, display: ProgressDisplay, stop: Stop) -> None:
        self._folder = folder
        self._team = team
        self._display = display
        self._stop = stop
        self._news: SimpleQueue[Sample | None] = SimpleQueue()
        self._door = team.door
        self._began = time.monotonic()
        self._is_paused = False

    def run(self) -> None:
        """Carry the job out to its end.

        Raises EndedEarly: the job was cancelled, or processes die again and again; `qdgrasp resume` goes on.
        InputError: a process ended with a sentence that names bad input or environment.
        """
        self._stop.tell(lambda: self._news.put(None))
        with ExitStack() as stack:
            stack.enter_context(self._folder.supervise())
            crew = stack.enter_context(ProcessGroup(self._folder.logs, GRACE))
            watch = RestartPolicy(crew, self._display, lambda: self._hire_coordinator(crew))
            self._hire_coordinator(crew)
            self._await(lambda: self._folder.endpoint is not None, watch)
            endpoint = self._folder.endpoint
            if self._stop.is_set or watch.is_done or endpoint is None:
                return
            self._display.say(f"listening on {endpoint}, records in {self._folder.path}")
            self._door = replace(self._door, listen=endpoint)  # one that is started again is found there
            near = parse_endpoints(endpoint)[0].from_here
            self._hire_recorder(crew, near)
            for number in range(self._team.workers):
                self._hire_worker(crew, near, number)
            stack.enter_context(self._listen(near, stack, watch))
            stack.callback(crew.bid_leave)  # while the session is being closed
            self._await(lambda: watch.is_done, watch)

    def _hire_coordinator(self, crew: ProcessGroup) -> None:
        self._folder.forget_endpoint()
        arguments = [str(self._folder.path), *self._door.flags, *self._door.proof]
        if self._team.batch_size:
            arguments += ["--batch-size", str(self._team.batch_size)]
        if self._team.seconds is not None:
            left = self._team.seconds - (time.monotonic() - self._began)
            arguments += ["--seconds", str(max(0.0, left))]
        if self._is_paused:
            arguments.append("--paused")
        crew.hire(COORDINATOR, "qdgrasp_coordinator.cli.coordinator_process", arguments)

    def _hire_recorder(self, crew: ProcessGroup, endpoint: str) -> None:
        arguments = [*self._place(endpoint), "--out", str(self._folder.path)]
        arguments += ["--disk-wait", str(self._team.disk_wait)]
        crew.hire("recorder", "qdgrasp_coordinator.cli.recorder_process", arguments)

    def _hire_worker(self, crew: ProcessGroup, endpoint: str, number: int) -> None:
        start_worker(crew, number, self._place(endpoint))

    def _place(self, endpoint: str) -> list[str]:
        """Return the flags with which others connect to the coordinator."""
        return ["--connect", endpoint, "--job", self._folder.name, *self._team.door.proof]

    def _listen(self, endpoint: str, stack: ExitStack, watch: RestartPolicy) -> AbstractContextManager[None]:
        """Subscribe to the coordinator's figures."""
        try:
            credentials = Credentials.find(self._team.door.security, Role.MONITOR)
            bus = stack.enter_context(ZenohBus.connect(endpoint, 10.0, self._stop, credentials))
        except EndpointError:
            watch.look(time.monotonic())  # the coordinator's end says more
            if watch.is_done:
                return nullcontext()
            raise
        return bus.subscribe(Keys(self._folder.name).stat("job"), self._news.put)

    def _await(self, condition: Callable[[], bool], watch: RestartPolicy) -> None:
        """Watch processes and show figures until the condition holds or a signal comes."""
        while not (condition() or self._stop.is_set or watch.is_done):
            watch.look(time.monotonic())
            try:
                self._show(self._news.get(timeout=LOOK_INTERVAL), watch)
            except Empty:
                continue

    def _show(self, news: Sample | None, watch: RestartPolicy) -> None:
        if news is None:
            return
        try:
            figures = from_json(news.payload, JobStatus)
        except MessageError:
            return
        self._is_paused = figures.state == "paused"
        watch.progressed(figures)
        self._display.show(figures)
