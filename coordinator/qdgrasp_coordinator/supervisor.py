"""One machine: a coordinator, a recorder and workers on loopback, started and watched together.

The same processes, commands and messages as on many machines; there is no second code path.
"""

import time
from collections.abc import Callable
from contextlib import AbstractContextManager, ExitStack, nullcontext
from dataclasses import dataclass
from pathlib import Path
from queue import Empty, SimpleQueue

from qdgrasp_coordinator.figures import JobFigures, from_json
from qdgrasp_coordinator.job_folder import JobFolder
from qdgrasp_coordinator.progress import Display
from qdgrasp_protocol.bus import Sample
from qdgrasp_protocol.credentials import Credentials, Role
from qdgrasp_protocol.crew import Crew, Death
from qdgrasp_protocol.errors import EndedEarly, EndpointError, InputError, MessageError
from qdgrasp_protocol.keys import Keys
from qdgrasp_protocol.lifetime import Stop
from qdgrasp_protocol.zenoh_bus import ZenohBus

LOOK_INTERVAL = 0.2  # seconds between two looks at the processes


@dataclass(frozen=True)
class Door:
    """Where a job's processes meet, and who else may come in."""

    listen: str | None = None
    """Endpoint of the embedded router; None: the default port on loopback if it is free, else a free one."""
    security: Path | None = None
    """Folder of certificates; None: links are not encrypted."""
    insecure: bool = False
    """Listen also where strangers get to."""

    @property
    def flags(self) -> list[str]:
        """What the coordinator is started with, besides `proof`."""
        listen = ["--listen", self.listen] if self.listen else []
        return [*listen, *(["--insecure"] if self.insecure else [])]

    @property
    def proof(self) -> list[str]:
        """What every process is started with."""
        return ["--security", str(self.security)] if self.security else []


@dataclass(frozen=True)
class Team:
    """How a job is carried out on this machine; no result depends on it."""

    workers: int
    batch_size: int | None = None
    """Rows in a batch; None: measured."""
    door: Door = Door()
    disk_wait: float = 60.0
    """Seconds that a full disk is waited for."""


class Supervisor:
    """Starts a job's processes, shows its progress, and ends them with it."""

    def __init__(self, folder: JobFolder, team: Team, display: Display, stop: Stop) -> None:
        self._folder = folder
        self._team = team
        self._display = display
        self._stop = stop
        self._news: SimpleQueue[Sample | None] = SimpleQueue()

    def run(self) -> None:
        """Carry the job out to its end.

        Raises
        ------
        EndedEarly
            The coordinator died; `qdgrasp resume` goes on.
        InputError
            A process ended with a sentence that names bad input or environment.
        """
        self._stop.tell(lambda: self._news.put(None))
        with ExitStack() as stack:
            stack.enter_context(self._folder.supervise())
            crew = stack.enter_context(Crew(self._folder.logs))
            watch = Watch(crew, self._display)
            self._hire_coordinator(crew)
            self._await(lambda: self._folder.endpoint is not None, watch)
            endpoint = self._folder.endpoint
            if self._stop.is_set or watch.is_done or endpoint is None:
                return
            self._display.say(f"listening on {endpoint}, records in {self._folder.path}")
            self._hire_recorder(crew, endpoint)
            for number in range(self._team.workers):
                self._hire_worker(crew, endpoint, number)
            stack.enter_context(self._listen(endpoint, stack, watch))
            self._await(lambda: watch.is_done, watch)

    def _hire_coordinator(self, crew: Crew) -> None:
        self._folder.forget_endpoint()
        arguments = [str(self._folder.path)]
        arguments += [*self._team.door.flags, *self._team.door.proof]
        if self._team.batch_size:
            arguments += ["--batch-size", str(self._team.batch_size)]
        crew.hire("coordinator", "qdgrasp_coordinator.cli.coordinator", arguments)

    def _hire_recorder(self, crew: Crew, endpoint: str) -> None:
        arguments = [*self._place(endpoint), "--out", str(self._folder.path)]
        arguments += ["--disk-wait", str(self._team.disk_wait)]
        crew.hire("recorder", "qdgrasp_coordinator.cli.recorder", arguments)

    def _hire_worker(self, crew: Crew, endpoint: str, number: int) -> None:
        crew.hire(f"worker-{number}", "qdgrasp_worker.cli", self._place(endpoint))

    def _place(self, endpoint: str) -> list[str]:
        """Where the others find the coordinator, and what they show there."""
        return ["--connect", endpoint, "--job", self._folder.name, *self._team.door.proof]

    def _listen(self, endpoint: str, stack: ExitStack, watch: "Watch") -> AbstractContextManager[None]:
        """Hear what the coordinator publishes."""
        try:
            credentials = Credentials.find(self._team.door.security, Role.MONITOR)
            bus = stack.enter_context(ZenohBus.connect(endpoint, 10.0, self._stop, credentials))
        except EndpointError:
            watch.look(time.monotonic())  # the coordinator's end says more
            if watch.is_done:
                return nullcontext()
            raise
        return bus.subscribe(Keys(self._folder.name).stat("job"), self._news.put)

    def _await(self, condition: Callable[[], bool], watch: "Watch") -> None:
        """Look after the processes and show what they report until the condition holds or a signal comes."""
        while not (condition() or self._stop.is_set or watch.is_done):
            watch.look(time.monotonic())
            try:
                self._show(self._news.get(timeout=LOOK_INTERVAL))
            except Empty:
                continue

    def _show(self, news: Sample | None) -> None:
        if news is None:
            return
        try:
            figures = from_json(news.payload, JobFigures)
        except MessageError:
            return
        self._display.show(figures)


class Watch:
    """Decides what a death in the crew means."""

    def __init__(self, crew: Crew, display: Display) -> None:
        self._crew = crew
        self._display = display
        self.is_done = False
        """The coordinator ended with its run complete."""

    def look(self, now: float) -> None:
        """Take note of deaths, and start again what can be."""
        for death in self._crew.deaths():
            if death.name == "coordinator":
                self._coordinator_died(death)
            elif not self.is_done:
                self._member_died(death, now)
        self._crew.restart_due(now)

    def _coordinator_died(self, death: Death) -> None:
        if death.exit_code == 0:
            self.is_done = True
            return
        words = self._crew.last_words("coordinator")
        if death.exit_code == InputError.exit_code:
            raise InputError(words)
        raise EndedEarly(f"The coordinator {death.words}. {words}".strip())

    def _member_died(self, death: Death, now: float) -> None:
        """A worker or the recorder died: bad input ends the run, anything else is started again."""
        if death.exit_code == InputError.exit_code:
            raise InputError(self._crew.last_words(death.name))
        pause = self._crew.restart_later(death.name, now)
        self._display.say(f"{death.name} {death.words}; it is started again in {pause:.1f} s")
