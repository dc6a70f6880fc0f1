"""The processes of one job on loopback, each by its name: started, struck, started again, and ended."""

import signal
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from types import TracebackType
from typing import Self

from tests.chaos.plan import HEAD
from tests.chaos.process import Process
from tests.chaos.slow_simulator import PACE
from tests.endpoints import own_endpoint
from tests.patience import PATIENCE
from tests.system.commands import rows_recorded

from qdgrasp_coordinator.folders.folder import RunFolder
from qdgrasp_coordinator.runs.preparation import make_bundle
from qdgrasp_protocol.spec import RunSpec

JOB = "chaos"


class Household:
    """A router, a coordinator, a recorder and workers of one run; a context manager that ends them all.

    Parameters
    ----------
    home
        A folder of their own; the run's is `home/run`, what they say is in `home/logs`.
    pace
        Seconds that an evaluation takes at least.
    options
        Of the workers.
    environment
        Of all.
    """

    def __init__(
        self,
        home: Path,
        spec: RunSpec,
        *,
        workers: int,
        pace: float = 0.0,
        options: Sequence[object] = (),
        **environment: str,
    ) -> None:
        self.home = home
        self.run = home / "run"
        self.endpoint = own_endpoint()
        self._environment = {PACE: str(pace), "QDGRASP_CACHE": str(home / "cache"), **environment}
        _, bundle = make_bundle(spec)
        RunFolder.create(self.run, spec, bundle, job=JOB)
        there = ["--connect", self.endpoint]
        self._members: dict[str, Process] = {}
        self.add("router", "qdgrasp_coordinator.cli.router", "--listen", self.endpoint)
        self.add("coordinator", "qdgrasp_coordinator.cli.coordinator", self.run, *there)
        self.add("recorder", "qdgrasp_coordinator.cli.recorder", "--job", JOB, "--out", self.run, *there)
        for number in range(workers):
            self.add(f"worker-{number}", "tests.chaos.worker", "--job", JOB, *there, *options)

    def add(self, name: str, module: str, *arguments: object) -> Process:
        """Take another process in; it is not started yet."""
        log = self.home / "logs" / f"{name}.log"
        member = self._members[name] = Process(name, module, arguments, log, **self._environment)
        return member

    def another(self, name: str) -> Process:
        """Take another process in with the command of one that is here; it is called `name-2`."""
        twin = self._members[f"{name}-2"] = self._members[name].twin(self.home / "logs" / f"{name}-2.log")
        return twin

    def __getitem__(self, name: str) -> Process:
        return self._members[name]

    def __iter__(self) -> Iterator[Process]:
        return iter(self._members.values())

    @property
    def workers(self) -> list[Process]:
        """Everybody but the head."""
        return [member for member in self if member.name not in HEAD]

    @property
    def rows(self) -> int:
        """How many rows are recorded."""
        return rows_recorded(self.run)

    def start(self) -> None:
        """Start whoever is not there."""
        for member in self:
            member.start()

    def end(self) -> list[str]:
        """Ask everybody to stop, and kill who does not; gives the names of those."""
        for member in self:
            member.send(signal.SIGCONT)
            member.send(signal.SIGTERM)
        deadline = time.monotonic() + PATIENCE
        while any(member.is_there for member in self) and time.monotonic() < deadline:
            time.sleep(0.02)  # between two looks
        late = [member.name for member in self if member.is_there]
        for member in self:
            member.send(signal.SIGKILL)
        return late

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, _kind: type[BaseException] | None, _error: BaseException | None, _trace: TracebackType | None
    ) -> None:
        self.end()
