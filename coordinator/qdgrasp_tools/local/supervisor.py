"""One machine: coordinator, recorder and workers on loopback, started and watched together.

The same processes, commands and messages as on many machines; there is no second code path.
"""

import os
import shlex
import signal
import threading
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
from qdgrasp_protocol.errors import EXTRAS, EndpointError, InputError, MessageError, check_packages
from qdgrasp_protocol.keys import Keys
from qdgrasp_protocol.process import Stop
from qdgrasp_protocol.session import Credentials, Role, parse_endpoints
from qdgrasp_protocol.spec import RunSpec
from qdgrasp_protocol.supervisor import ProcessSupervisor
from qdgrasp_protocol.zenoh_bus import ZenohBus, free_ports
from qdgrasp_tools.local.progress import ProgressDisplay
from qdgrasp_tools.local.restart_policy import COORDINATOR, GRACE, JobRestarts, start_worker

LOOK_INTERVAL = 0.2  # seconds between two looks at the processes
SESSION_SECONDS = 10.0  # seconds that a coordinator which listens may take to open a session


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


News = Sample | EndpointError | None
"""Input of a supervisor: a job's figures, a session that could not be opened, or None, a signal."""


class FiguresSession:
    """The session that hears a job's figures, in a thread: opening it holds up no restart."""

    def __init__(self, job: str, credentials: Credentials | None, news: "SimpleQueue[News]") -> None:
        self._figures = Keys(job).stat("job")
        self._credentials = credentials
        self._news = news
        self._end = Stop()
        self._thread: threading.Thread | None = None

    def open(self, endpoint: str) -> None:
        """Open the session at a router, in place of the one before; a failure is put into the news."""
        self.close()
        self._end = Stop()
        self._thread = threading.Thread(target=self._hear, args=[endpoint, self._end], daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Close the session, or stop opening it."""
        self._end.set(signal.SIGTERM)
        if self._thread is not None:
            self._thread.join()

    def _hear(self, endpoint: str, end: Stop) -> None:
        over: SimpleQueue[None] = SimpleQueue()
        end.tell(lambda: over.put(None))
        with suppress(SystemExit):
            try:
                bus = ZenohBus.connect(endpoint, SESSION_SECONDS, end, self._credentials)
            except EndpointError as error:
                self._news.put(error)
                return
            with bus, bus.subscribe(self._figures, self._news.put):
                over.get()


class Supervisor:
    """Starts a job's processes, shows its progress, and ends them with it."""

    def __init__(
        self, folder: JobFolder, config: LocalJobConfig, display: ProgressDisplay, stop: Stop
    ) -> None:
        self._folder = folder
        self._config = config
        self._display = display
        self._stop = stop
        self._news: SimpleQueue[News] = SimpleQueue()
        credentials = Credentials.find(config.listen.security, Role.MONITOR)
        self._session = FiguresSession(folder.name, credentials, self._news)
        self._listen = config.listen
        self._endpoint: str | None = None  # Where the members are told that the coordinator listens
        self._near = ""  # The same, for processes of this machine
        self._turn = 0  # Counts the starts of the coordinator
        self._session_turn = 0  # In which the session was opened
        self._has_failed = False  # The session could not be opened, and is to be opened again
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
            stack.callback(self._folder.forget_endpoint)
            processes = stack.enter_context(ProcessSupervisor(self._folder.logs, GRACE))
            stack.callback(self._session.close)
            stack.callback(processes.request_stop)  # while the session is being closed
            restarts = JobRestarts(processes, self._display, self._change_port)
            processes.start(COORDINATOR, "qdgrasp_tools.cli.coordinator_process", self._next_coordinator)
            while not (self._stop.is_set or restarts.is_done):
                self._folder.check_there()
                restarts.check(time.monotonic())
                self._follow_endpoint(processes)
                with suppress(Empty):
                    self._take(self._news.get(timeout=LOOK_INTERVAL), processes, restarts)

    def _next_coordinator(self) -> list[str]:
        """Forget where the last coordinator listened; return the arguments of the next."""
        self._turn += 1
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

    def _change_port(self) -> bool:
        """Choose free ports in place of those that another program took meanwhile.

        False where the coordinator has not listened yet: its ports are those that were asked for.
        """
        if self._endpoint is None:
            return False
        self._listen = replace(self._listen, endpoint=free_ports(self._endpoint))
        return True

    def _follow_endpoint(self, processes: ProcessSupervisor) -> None:
        """Start the members when the coordinator listens, and again when it does so elsewhere."""
        endpoint = self._folder.endpoint
        if endpoint is None or (endpoint == self._endpoint and not self._has_failed):
            return
        near = parse_endpoints(endpoint)[0].from_here
        if self._endpoint is None:
            self._display.say(f"listening on {endpoint}, records in {self._folder.path}")
            self._say_commands(endpoint)
            self._near = near
            self._start_members(processes)
        elif endpoint != self._endpoint:
            self._display.say(
                f"listening on {endpoint} now, as another program took the port; recorder and workers of "
                "this machine are started again, workers elsewhere have to be"
            )
            self._near = near
            processes.restart_others(COORDINATOR)
        self._endpoint, self._session_turn, self._has_failed = endpoint, self._turn, False
        self._listen = replace(self._listen, endpoint=endpoint)  # where a later coordinator is found too
        self._session.open(near)

    def _say_commands(self, endpoint: str) -> None:
        """Tell by which commands the job is watched, and joined by more workers."""
        flags = " ".join(map(shlex.quote, self._listen.security_flags))
        reached = ",".join(place.from_elsewhere for place in parse_endpoints(endpoint))
        watch = f"qdgrasp-monitor {shlex.quote(str(self._folder.path))} {flags}".rstrip()
        join = f"qdgrasp-worker --connect {reached} --job {self._folder.name} {flags}".rstrip()
        self._display.say(f"watch it by `{watch}`, add workers by `{join}`")

    def _start_members(self, processes: ProcessSupervisor) -> None:
        """Start the recorder and the workers, which connect to the endpoint of that time."""
        recorder = ["--out", str(self._folder.path)]
        module = "qdgrasp_tools.cli.recorder_process"
        processes.start("recorder", module, lambda: [*self._connection_flags, *recorder])
        for number in range(self._config.workers):
            start_worker(processes, number, lambda: self._connection_flags)

    @property
    def _connection_flags(self) -> list[str]:
        return ["--connect", self._near, "--job", self._folder.name, *self._listen.security_flags]

    def _take(self, news: News, processes: ProcessSupervisor, restarts: JobRestarts) -> None:
        """Show figures; raise the error of a session at a coordinator that is there all the time."""
        if isinstance(news, Sample):
            with suppress(MessageError):
                figures = from_json(news.payload, JobStatus)
                self._is_paused = figures.state == "paused"
                restarts.note_progress(figures)
                self._display.show(figures)
        elif isinstance(news, EndpointError):
            restarts.check(time.monotonic())  # the coordinator's end says more
            if self._turn == self._session_turn and not processes.is_dead(COORDINATOR):
                raise news
            self._has_failed = True
