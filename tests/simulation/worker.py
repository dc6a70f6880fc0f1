"""A simulated worker: the real service and workshop, with a simulator that is a formula."""

import struct
from collections.abc import Callable
from contextlib import AbstractContextManager
from dataclasses import dataclass
from math import inf
from queue import SimpleQueue
from signal import SIGTERM
from unittest.mock import patch

import msgspec
import numpy as np
from tests.coordinator.runs.plans import Task
from tests.simulation.formula import Formula, Mishaps, Speed
from tests.simulation.network import Network
from tests.simulation.process import Life, Listen, Process
from tests.simulation.world import World

from qdgrasp_coordinator.serving.inbox import LinkChange, TokenChange
from qdgrasp_protocol import codec
from qdgrasp_protocol.bus import Bus, Channel, Declaration, Sample
from qdgrasp_protocol.errors import MessageError, NoReply, QdgraspError
from qdgrasp_protocol.keys import Keys
from qdgrasp_protocol.lifetime import Stop
from qdgrasp_protocol.messages import Join, Joined, Result
from qdgrasp_protocol.outcome import Outcome
from qdgrasp_worker.serving import service as serving
from qdgrasp_worker.serving.bundles import Bundles
from qdgrasp_worker.serving.desk import Desk
from qdgrasp_worker.serving.errands import JOIN_SECONDS, Answered, Fetched
from qdgrasp_worker.serving.events import Asked, CoordinatorSeen, Event, LinkChanged
from qdgrasp_worker.serving.service import WorkerService
from qdgrasp_worker.serving.workshop import Workshop

JOB = "job"
KEYS = Keys(JOB)
GRACE = 1.5
FETCH_SECONDS = 5.0
CREDIT = 2
"""What a worker asks for; a job that shares it with others gets less."""


@dataclass
class Line:
    """What a worker's service needs of a bus."""

    host: "Worker"

    def put(self, key: str, payload: bytes, *, encoding: str, channel: Channel = Channel.DATA) -> None:
        self.host.network.put(self.host.session, key, payload, encoding, channel)

    def token(self, key: str) -> AbstractContextManager[None]:
        self.host.network.token(self.host.session, key)
        return Declaration(lambda: self.host.network.hand_in(self.host.session, key))


@dataclass
class SimulatedErrands:
    """Questions, each on its own way; what comes back goes to the inbox."""

    host: "Worker"

    def join(self, job: str, join: Join) -> None:
        def back(answer: bytes | Exception) -> None:
            self.host.hear(Answered(job, join.number, _joined(answer)))

        self._ask(Keys(job).join, codec.encode(join), JOIN_SECONDS, back)

    def fetch(self, job: str, scene: str) -> None:
        def back(answer: bytes | Exception) -> None:
            assert isinstance(answer, bytes | QdgraspError)
            self.host.hear(Fetched(job, scene, answer))

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


def _joined(answer: bytes | Exception) -> Joined | QdgraspError:
    if isinstance(answer, bytes):
        try:
            return codec.decode(answer, Joined)
        except MessageError as error:
            return error
    assert isinstance(answer, QdgraspError)
    return answer


class Worker(Process):
    """A worker process."""

    def __init__(
        self, world: World, network: Network, wid: str, task: Task, mishaps: Mishaps, speed: Speed
    ) -> None:
        self.wid = wid
        self._task = task
        self._mishaps = mishaps
        self._speed = speed
        self._stop = Stop()
        super().__init__(world, network, f"worker {int(wid, 16)}")
        self.workshop = Workshop(self._hire, row_seconds=60.0, memory=1 << 30)
        self.service = self._new_service()

    @property
    def desk(self) -> Desk | None:
        """What it holds of the job; None while it knows of none."""
        appointment = self.service._jobs.get(JOB)
        return appointment.desk if appointment else None

    def leave(self) -> None:
        """Be asked to leave, by SIGTERM."""
        self.note("is asked to leave")
        self._stop.set(SIGTERM)
        self.hear(Asked())

    def lose_simulator(self) -> None:
        """Have the simulator killed, for its memory."""
        self.note("loses its simulator")
        simulator = self.workshop._simulator
        assert isinstance(simulator, Formula)
        simulator.be_killed()

    def life(self) -> Life:
        """Serve until asked to stop."""
        for pattern in (KEYS.work(self.wid), KEYS.ctl(self.wid)):
            self.network.subscribe(self.session, pattern)
        self.network.watch(self.session, KEYS.coordinator_token())
        while not self.service._leave.is_over(self.now):
            patience = self.service._patience(self.now)
            yield Listen(inf if patience is None else patience)
            for event in self.events():
                self.service._take(_event(event), self.now)
            self.service._act(self.now)

    def _hire(self) -> Formula:
        return Formula(self, self._task, self._speed, self._mishaps, self.hear)

    def _new_service(self) -> WorkerService:
        bus: Bus = Line(self)  # type: ignore[assignment]
        with (
            patch.object(serving, "Errands", lambda *_: SimulatedErrands(self)),
            patch.object(serving.secrets, "token_hex", lambda _: self.wid),
        ):
            return WorkerService(
                bus, self._stop, self.workshop, SimpleQueue(), bundles=Bundles(None), job=JOB, grace=GRACE
            )  # type: ignore[arg-type]


def _event(event: object) -> Event:
    """An event as a worker has it."""
    match event:
        case TokenChange(key, alive):
            return CoordinatorSeen(key, alive)
        case LinkChange(up):
            return LinkChanged(up)
        case _:
            return event  # type: ignore[return-value]


class Forger(Process):
    """Somebody with a worker's certificate, who answers with nonsense what others were leased."""

    def __init__(self, world: World, network: Network, wid: str) -> None:
        self._wid = wid
        super().__init__(world, network, f"forger {int(wid, 16)}")

    def life(self) -> Life:
        """Overhear results, and forge."""
        self.network.subscribe(self.session, KEYS.result())
        while True:
            yield Listen()
            for event in self.events():
                if isinstance(event, Sample) and (result := codec.decode(event.payload, Result)).attempt:
                    self._forge(result)

    def _forge(self, result: Result) -> None:
        """Answer that batch, and those that are likely to be at work."""
        epoch, count = struct.unpack(">QQ", result.batch)
        outcomes = np.full(result.n, Outcome.HELD, dtype=np.uint8).tobytes()
        for ahead in range(4):
            batch = struct.pack(">QQ", epoch, count + ahead)
            columns = result.columns | {"outcome": outcomes}
            forged = {"batch": batch, "attempt": 0, "wid": self._wid, "columns": columns, "failures": []}
            message = codec.encode(msgspec.structs.replace(result, **forged))
            key, encoding = KEYS.result(self._wid), codec.encoding(Result)
            self.network.put(self.session, key, message, encoding, Channel.DATA)
