"""One machine: coordinator, recorder and workers on loopback, started and watched together.

The same processes, commands and messages as on many machines; there is no second code path.
"""

import os
import time
from collections.abc import Callable, Iterable
from contextlib import AbstractContextManager, ExitStack, nullcontext, suppress
from dataclasses import dataclass, replace
from importlib.util import find_spec
from pathlib import Path
from queue import Empty, SimpleQueue

from qdgrasp_coordinator.local.progress import ProgressDisplay
from qdgrasp_coordinator.local.restart_policy import COORDINATOR, GRACE, RestartPolicy, start_worker
from qdgrasp_coordinator.metrics.job_status import JobStatus, from_json
from qdgrasp_coordinator.storage.job_folder import JobFolder
from qdgrasp_protocol.bus import Sample
from qdgrasp_protocol.engines import DEVICE_ENGINE, DEVICE_VARIABLE, check_engine
from qdgrasp_protocol.errors import EndpointError, InputError, MessageError
from qdgrasp_protocol.keys import Keys
from qdgrasp_protocol.process import ProcessGroup, Stop
from qdgrasp_protocol.session import Credentials, Role, parse_endpoints
from qdgrasp_protocol.spec import RunSpec
from qdgrasp_protocol.zenoh_bus import ZenohBus

LOOK_INTERVAL = 0.2  # seconds between two looks at the processes


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
    disk_wait: float = 60.0
    """Seconds that a full disk is waited for."""
    seconds: float | None = None
    """After so long the job ends, done or not; None: when it is done."""

    def check_engines(self, specs: Iterable[RunSpec]) -> None:
        """Raise as the function, where workers are to start here."""
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
        if spec.engine == DEVICE_ENGINE and find_spec("mujoco_warp") is None:
            raise InputError(
                f"The engine {DEVICE_ENGINE} needs packages that are not installed here: "
                "pip install 'qdgrasp[gpu]'."
            )


class Supervisor:
    """Starts a job's processes, shows its progress, and ends them with it."""

    def __init__(
        self, folder: JobFolder, config: LocalJobConfig, display: ProgressDisplay, stop: Stop
    ) -> None:
        self._folder = folder
        self._config = config
        self._display = display
        self._stop = stop
        self._news: SimpleQueue[Sample | None] = SimpleQueue()
        self._listen = config.listen
        self._began = time.monotonic()
        self._is_paused = False

    def run(self) -> None:
        """Carry the job out to its end.

        Raises EndedEarly if the job was cancelled, or processes die again and again (`qdgrasp resume` goes
        on), and InputError if a process ended with a sentence that names bad input or environment.
        """
        self._stop.tell(lambda: self._news.put(None))
        with ExitStack() as stack:
            stack.enter_context(self._folder.supervise())
            processes = stack.enter_context(ProcessGroup(self._folder.logs, GRACE))
            restarts = RestartPolicy(processes, self._display, lambda: self._start_coordinator(processes))
            self._start_coordinator(processes)
            self._await(lambda: self._folder.endpoint is not None, restarts)
            endpoint = self._folder.endpoint
            if self._stop.is_set or restarts.is_done or endpoint is None:
                return
            self._display.say(f"listening on {endpoint}, records in {self._folder.path}")
            self._listen = replace(self._listen, endpoint=endpoint)  # where a later coordinator is found too
            near = parse_endpoints(endpoint)[0].from_here
            flags = ["--connect", near, "--job", self._folder.name, *self._listen.security_flags]
            recorder = ["--out", str(self._folder.path), "--disk-wait", str(self._config.disk_wait)]
            processes.start("recorder", "qdgrasp_coordinator.cli.recorder_process", [*flags, *recorder])
            for number in range(self._config.workers):
                start_worker(processes, number, flags)
            stack.enter_context(self._subscribe(near, stack, restarts))
            stack.callback(processes.request_stop)  # while the session is being closed
            self._await(lambda: restarts.is_done, restarts)

    def _start_coordinator(self, processes: ProcessGroup) -> None:
        self._folder.forget_endpoint()
        arguments = [str(self._folder.path), *self._listen.flags, *self._listen.security_flags]
        if self._config.batch_size:
            arguments += ["--batch-size", str(self._config.batch_size)]
        if self._config.seconds is not None:
            left = self._config.seconds - (time.monotonic() - self._began)
            arguments += ["--seconds", str(max(0.0, left))]
        if self._is_paused:
            arguments.append("--paused")
        processes.start(COORDINATOR, "qdgrasp_coordinator.cli.coordinator_process", arguments)

    def _subscribe(
        self, endpoint: str, stack: ExitStack, restarts: RestartPolicy
    ) -> AbstractContextManager[None]:
        try:
            credentials = Credentials.find(self._config.listen.security, Role.MONITOR)
            bus = stack.enter_context(ZenohBus.connect(endpoint, 10.0, self._stop, credentials))
        except EndpointError:
            restarts.check(time.monotonic())  # the coordinator's end says more
            if restarts.is_done:
                return nullcontext()
            raise
        return bus.subscribe(Keys(self._folder.name).stat("job"), self._news.put)

    def _await(self, condition: Callable[[], bool], restarts: RestartPolicy) -> None:
        """Watch processes and show figures until the condition holds or a signal comes."""
        while not (condition() or self._stop.is_set or restarts.is_done):
            restarts.check(time.monotonic())
            with suppress(Empty, MessageError):
                if news := self._news.get(timeout=LOOK_INTERVAL):
                    figures = from_json(news.payload, JobStatus)
                    self._is_paused = figures.state == "paused"
                    restarts.note_progress(figures)
                    self._display.show(figures)
