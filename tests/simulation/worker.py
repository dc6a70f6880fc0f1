"""A simulated worker: the real service, with a simulator that is a formula."""

import struct
from collections import Counter, deque
from collections.abc import Callable
from dataclasses import dataclass, field
from queue import SimpleQueue
from random import Random
from signal import SIGABRT, SIGKILL, SIGTERM
from unittest.mock import patch

import msgspec
import numpy as np
from tests.coordinator.scheduler.search_plans import Task
from tests.fakes.messages import put
from tests.simulation.network import Network, World
from tests.simulation.process import Listen, Process, Steps

from qdgrasp_protocol import messages
from qdgrasp_protocol.build_messages import Build
from qdgrasp_protocol.bus import Sample
from qdgrasp_protocol.errors import MessageError, NoReply, QdgraspError
from qdgrasp_protocol.keys import Keys
from qdgrasp_protocol.messages import Failure, Join, Joined, Result, worker_id
from qdgrasp_protocol.process import Stop
from qdgrasp_protocol.process_limits import STALL_SIGNAL, ProcessStats
from qdgrasp_protocol.rows import RESULT, Outcome, Rows, pack
from qdgrasp_worker.runtime import service as serving
from qdgrasp_worker.runtime.background_tasks import JOIN_SECONDS, BuildEnded, JoinAnswered, SceneAnswered
from qdgrasp_worker.runtime.job_registry import JobSession
from qdgrasp_worker.runtime.service import StopRequested, WorkerService
from qdgrasp_worker.runtime.simulator_messages import (
    AnySimulatorMessage,
    EvaluateRows,
    PartialResult,
    SceneLoaded,
    SceneMissing,
    SimulatorMessage,
    SimulatorReady,
)
from qdgrasp_worker.runtime.simulator_supervisor import (
    SimulatorEnded,
    SimulatorEvent,
    SimulatorSaid,
    SimulatorSupervisor,
)

PLATFORM = {"evaluation": "a formula"}
LOADING = 0.05
"""Seconds until a scene stands."""
START = 0.3
"""Seconds until the probes are evaluated."""


@dataclass
class RandomFailures:
    """Rows on which simulators fail now and then, each at most twice: no poison."""

    chance: Random
    rate: float
    failed: Counter[bytes] = field(default_factory=Counter)
    down_until: float = 0.0
    """Until then every simulator fails on every row, as where a licence server is down."""

    def fails_row(self, row: np.void, now: float) -> bool:
        """True if a simulator fails on a row now."""
        key = row["genome"].tobytes() + row["trial"].tobytes()
        if now < self.down_until:
            return True
        if self.failed[key] < 2 and self.chance.random() < self.rate:
            self.failed[key] += 1
            return True
        return False

    def fails_build(self, key: str) -> bool:
        """True if a build of a shape fails now."""
        if self.failed[key.encode()] < 2 and self.chance.random() < self.rate:
            self.failed[key.encode()] += 1
            return True
        return False


@dataclass(frozen=True)
class Speed:
    """Speed of a simulator."""

    row_seconds: float
    rows_at_once: int


class FormulaSimulator:
    """A simulator process as a worker sees it; `hear` takes its news."""

    def __init__(
        self,
        host: "Process",
        task: Task,
        speed: Speed,
        failures: RandomFailures,
        hear: Callable[[SimulatorEvent], None],
        bad: str = "",
    ) -> None:
        self._bad = bad
        self._host = host
        self._task = task
        self._speed = speed
        self._failures = failures
        self._hear = hear
        self._queue: deque[EvaluateRows] = deque()
        self._scenes: set[str] = set()
        self._is_over = False
        self._is_busy = False
        self._steps = 0
        self._later(START, lambda: self._say(SimulatorReady(platform=PLATFORM)))

    @property
    def stats(self) -> ProcessStats:
        """CPU time and memory that it has taken."""
        return ProcessStats(float(self._steps), 0)

    def send(self, message: SimulatorMessage) -> None:
        """Take a batch."""
        assert isinstance(message, EvaluateRows)
        self._queue.append(message)
        self._begin()

    def end_stalled(self) -> None:
        """End because of a stall."""
        self._die(-STALL_SIGNAL)

    def close(self) -> None:
        """End."""
        self._is_over = True

    def _later(self, seconds: float, call: Callable[[], None]) -> None:
        self._host.world.later(seconds, lambda: None if self._is_over or self._host.is_over else call())

    def _say(self, frame: AnySimulatorMessage) -> None:
        self._hear(SimulatorSaid(self, frame))  # type: ignore[arg-type]

    def _die(self, code: int) -> None:
        self._is_over = True
        self._hear(SimulatorEnded(self, code))  # type: ignore[arg-type]

    # Batches, slice by slice.

    def _begin(self) -> None:
        if self._is_busy or not self._queue:
            return
        batch = self._queue.popleft()
        if batch.bundle is None and batch.scene not in self._scenes:
            self._say(SceneMissing())
            self._begin()
            return
        self._is_busy = True
        if batch.bundle is None:
            self._go_on(batch, 0)
        else:
            self._later(LOADING, lambda: self._load(batch))

    def _load(self, batch: EvaluateRows) -> None:
        self._scenes.add(batch.scene)
        self._say(SceneLoaded())
        self._go_on(batch, 0)

    def _go_on(self, batch: EvaluateRows, start: int) -> None:
        """Evaluate the next slice, or the next batch."""
        if start == batch.n:
            self._is_busy = False
            self._begin()
            return
        n = min(1 if batch.is_careful else self._speed.rows_at_once, batch.n - start)
        seconds = n * self._speed.row_seconds * self._host.world.chance.uniform(0.5, 2)
        if self._bad == "silent":
            seconds = n * SILENT_SECONDS
            for second in range(1, int(seconds)):
                self._later(second, self._progress)
        self._later(seconds * (SLOWNESS if self._bad == "slow" else 1), lambda: self._finish(batch, start, n))

    def _progress(self) -> None:
        self._steps += 1

    def _finish(self, batch: EvaluateRows, start: int, n: int) -> None:
        self._steps += n
        rows = self._task.shape.empty(batch.n)
        rows["genome"] = np.frombuffer(batch.columns["genome"], "<f4").reshape(batch.n, batch.genes)
        rows["trial"] = np.frombuffer(batch.columns["trial"], "<u2")
        found = self._task.evaluate(rows[start : start + n])
        failed = [place for place, row in enumerate(found) if self._fails(row)]
        ends = [place for place in failed if found["genome"][place, 1] > 0]
        if ends:
            self._die(-SIGABRT if found["genome"][ends[0], 2] > 0 else 1)
            return
        self._say(self._part(found, failed))
        self._go_on(batch, start + n)

    def _fails(self, row: np.void) -> bool:
        is_poison = bool(row["outcome"] == Outcome.ERROR)
        return is_poison or self._bad == "sick" or self._failures.fails_row(row, self._host.world.now)

    def _part(self, found: Rows, failed: list[int]) -> PartialResult:
        found[failed] = np.zeros((), found.dtype)
        return PartialResult(
            n=len(found),
            joints=self._task.shape.joints,
            columns=pack(found, RESULT),
            failures=[Failure(row=place, reason="it raised") for place in failed],
            cpu_seconds=len(found) * self._speed.row_seconds,
        )

    def be_killed(self) -> None:
        """Be killed from outside, for memory."""
        if not self._is_over:
            self._die(-SIGKILL)


JOB = "job"
KEYS = Keys(JOB)
BUILDING_CODE = "c" * 64
"""Digest of the code of workers that build shapes."""
BUILDING = 6.0
"""Seconds that a shape takes on average."""
GRACE = 1.5
FETCH_SECONDS = 5.0
SILENT_SECONDS = 58.0
"""Time that a silent worker takes for a row [s]: less than its own limit."""
SLOWNESS = 40
CREDIT = 2
"""Batches that a worker asks for; a job that shares it with others gets fewer."""


@dataclass
class SimulatedRequests:
    """Questions, each on its own way; what comes back goes to the inbox."""

    host: "Worker"

    def join(self, job: str, join: Join) -> None:
        def back(answer: bytes | Exception) -> None:
            self.host.hear(JoinAnswered(job, join.number, _joined(answer)))

        self._ask(Keys(job).join, messages.encode(join), JOIN_SECONDS, back)

    def fetch(self, job: str, scene: str) -> None:
        def back(answer: bytes | Exception) -> None:
            assert isinstance(answer, bytes | QdgraspError)
            self.host.hear(SceneAnswered(job, scene, answer))

        self._ask(Keys(job).asset(scene), b"", FETCH_SECONDS, back)

    def _ask(
        self, key: str, payload: bytes, timeout: float, back: Callable[[bytes | Exception], None]
    ) -> None:
        answers: list[bytes | Exception] = []

        def first(answer: bytes | Exception) -> None:
            if not answers:
                answers.append(answer)
                back(answer)

        self.host.network.ask(self.host.session, key, payload, first)
        self.host.world.later(self.host.clock.span(timeout), lambda: first(NoReply("in time")))


class SimulatedBuilder:
    """Builds shapes, each after a time; some fail, at most twice."""

    def __init__(self, host: "Worker", failures: RandomFailures) -> None:
        self.build: Build | None = None
        self._host = host
        self._failures = failures

    def start(self, job: str, build: Build) -> None:
        assert self.build is None
        self.build = build
        fails = self._failures.fails_build(build.task.key)
        ended = BuildEnded(job, build, b"" if fails else b"a shape", "it failed" if fails else "")
        self._host.world.later(
            self._host.world.exponential(BUILDING),
            lambda: None if self._host.is_over else self._host.hear(ended),
        )

    def on_ended(self, ended: BuildEnded) -> bool:
        is_current = self.build is ended.build
        if is_current:
            self.build = None
        return is_current

    def stop(self) -> None:
        self.build = None


def _joined(answer: bytes | Exception) -> Joined | QdgraspError:
    if isinstance(answer, bytes):
        try:
            return messages.decode(answer, Joined)
        except MessageError as error:
            return error
    assert isinstance(answer, QdgraspError)
    return answer


class Worker(Process):
    """A worker process."""

    def __init__(
        self,
        world: World,
        network: Network,
        wid: str,
        task: Task,
        failures: RandomFailures,
        speed: Speed,
        *,
        builds: bool = False,
        bad: str = "",
    ) -> None:
        self.wid = wid
        self._bad = bad
        self._builds = BUILDING_CODE if builds else ""
        self._task = task
        self._failures = failures
        self._speed = speed
        self._stop = Stop()
        super().__init__(world, network, f"worker {int(wid, 16)}")
        self.supervisor = SimulatorSupervisor(self._start_simulator, row_seconds=60.0, memory=1 << 30)
        self.service = self._new_service()

    @property
    def session_of_job(self) -> JobSession | None:
        """Its session of the job; None before it knows the job."""
        return self.service._jobs.get(JOB)

    def leave(self) -> None:
        """Be asked to leave, by SIGTERM."""
        self.note("is asked to leave")
        self._stop.set(SIGTERM)
        self.hear(StopRequested())

    def lose_simulator(self) -> None:
        """Have the simulator killed, for its memory."""
        self.note("loses its simulator")
        simulator = self.supervisor._simulator
        assert isinstance(simulator, FormulaSimulator)
        simulator.be_killed()

    def steps(self) -> Steps:
        """Serve until asked to stop."""
        for pattern in (KEYS.work(self.wid), KEYS.ctl(self.wid)):
            self.network.subscribe(self.session, pattern)
        self.network.watch(self.session, KEYS.coordinator_token())
        while not self.service._is_over(self.now):
            yield Listen(self.service._wait_seconds(self.now))
            for event in self.events():
                self.service._take(event, self.now)  # type: ignore[arg-type]
            self.service._step(self.now)

    def _start_simulator(self) -> FormulaSimulator:
        return FormulaSimulator(self, self._task, self._speed, self._failures, self.hear, self._bad)

    def _new_service(self) -> WorkerService:
        with (
            patch.object(serving, "BackgroundRequests", lambda *_: SimulatedRequests(self)),
            patch.object(serving, "BuilderClient", lambda *_: SimulatedBuilder(self, self._failures)),
            patch.object(serving, "worker_id", lambda _: self.wid),
        ):
            how = {"job": JOB, "grace": GRACE, "builds": self._builds}
            return WorkerService(self.bus, self._stop, self.supervisor, SimpleQueue(), **how)


class Forger(Process):
    """A process with a worker's certificate that forges results of others' leases."""

    def __init__(self, world: World, network: Network, wid: str) -> None:
        self._key = int(wid, 16).to_bytes(32)
        self._wid = worker_id(self._key)
        super().__init__(world, network, f"forger {int(wid, 16)}")

    def steps(self) -> Steps:
        """Overhear results, and forge."""
        self.network.subscribe(self.session, KEYS.result())
        while True:
            yield Listen()
            for event in self.events():
                if not isinstance(event, Sample) or event.encoding != messages.encoding(Result):
                    continue
                if (result := messages.decode(event.payload, Result)).attempt:
                    self._forge(result)

    def _forge(self, result: Result) -> None:
        """Answer that batch, and those that are likely to be at work."""
        epoch, count = struct.unpack(">QQ", result.batch)
        outcomes = np.full(result.n, Outcome.HELD, dtype=np.uint8).tobytes()
        for ahead in range(4):
            batch = struct.pack(">QQ", epoch, count + ahead)
            columns = result.columns | {"outcome": outcomes}
            forged = {"batch": batch, "attempt": 0, "columns": columns, "failures": []}
            own, strange = {"wid": self._wid, "key": self._key}, {"wid": result.wid, "key": bytes(32)}
            for name in (own, strange):
                put(
                    self.bus, KEYS.result(str(name["wid"])), msgspec.structs.replace(result, **forged, **name)
                )
