"""A simulated coordinator: the real turn, lanes and link to the recorder, on one thread."""

from collections.abc import Callable, Iterator
from concurrent.futures import Future
from dataclasses import dataclass

from tests.simulation.network import Asked, Network, World
from tests.simulation.process import Busy, Life, Listen, Process
from tests.simulation.worker import JOB, KEYS

from qdgrasp_coordinator.scheduler.coordinator_service import MOST_WAIT
from qdgrasp_coordinator.scheduler.job_scheduler import JobScheduler, JoinRequest, LinkChange
from qdgrasp_coordinator.scheduler.recorder_client import RecorderClient
from qdgrasp_coordinator.scheduler.run_plan import RunPlan
from qdgrasp_coordinator.scheduler.run_registry import ActiveRun, RunNotOpened, RunOpened
from qdgrasp_protocol import messages
from qdgrasp_protocol.bus import Bus, Channel
from qdgrasp_protocol.errors import InputError, NoReply, RecorderFellBack, Refused, TookOver
from qdgrasp_protocol.keys import last_chunk
from qdgrasp_protocol.messages import Join, Message

RETRY = 0.5
"""Seconds between two tries to open a run; fewer tries than in the service, for the sake of time."""


class NotNow(Exception):
    """Nobody answers; there will be another try."""


def not_now() -> None:
    """Wait for another try."""
    raise NotNow


class Lanes:
    """The open runs."""

    def __init__(self) -> None:
        self.open: dict[str, ActiveRun] = {}

    def __iter__(self) -> Iterator[ActiveRun]:
        return iter(list(self.open.values()))

    def get(self, run: str) -> ActiveRun | None:
        return self.open.get(run)


@dataclass
class Line:
    """What the link to the recorder needs of a bus."""

    host: "Coordinator"

    def put(self, key: str, payload: bytes, *, encoding: str, channel: Channel) -> None:
        self.host.network.put(self.host.session, key, payload, encoding, channel)

    def ask(self, key: str, payload: bytes, *, timeout: float) -> bytes:
        return self.host.network.ask_now(self.host.session, key, payload)


class Coordinator(Process):
    """A coordinator process.

    Parameters
    ----------
    runs
        The runs of the job.
    assignment
        Makes one, with a new search.
    met
        Told when its turn begins.
    opening
        The mean time that it takes to open a run [s].
    """

    def __init__(
        self,
        world: World,
        network: Network,
        name: str,
        runs: list[str],
        assignment: Callable[[str], RunPlan],
        batch_size: int | None,
        *,
        met: Callable[["Coordinator"], None],
        opening: float = 0.2,
    ) -> None:
        self._left = list(runs)
        self._assignment = assignment
        self._batch_size = batch_size
        self._opening = opening
        self._met = met
        self._is_opening = False
        self.lanes = Lanes()
        self.turn = JobScheduler(JOB, 0, self.lanes, self._put, batch_size)
        self.link_is_up = True
        """What its turn knows of its link."""
        self.is_done = False
        """All runs are finished and recorded."""
        self.was_replaced = False
        super().__init__(world, network, name)

    def life(self) -> Life:
        """Carry all runs out, or end when another coordinator took over."""
        self.network.subscribe(self.session, KEYS.recorded)
        self.network.watch(self.session, KEYS.recorder_token())
        try:
            while not self.is_done:
                self._open_another()
                yield Listen(self._patience())
                yield Busy(self.world.chance.uniform(0, 0.005))
                self._step()
        except TookOver as reason:
            self.note(str(reason))
            self.was_replaced = True

    def hear(self, event: object) -> None:
        """Do what the reception does: hand requests to join over, and scenes out."""
        if isinstance(event, Asked) and event.query.key != KEYS.join:
            event.reply(self._scene(event.query.key))
        else:
            super().hear(self._request(event) if isinstance(event, Asked) else event)

    def _scene(self, key: str) -> bytes | Exception:
        digests = {lane.assignment.bundle.digest for lane in self.lanes}
        return b"a scene" if last_chunk(key) in digests else Refused("no run in progress has the scene")

    def _request(self, asked: Asked) -> JoinRequest:
        def answered(answer: "Future[bytes]") -> None:
            error = answer.exception()
            asked.reply(error if isinstance(error, Exception) else answer.result())

        request = JoinRequest(messages.decode(asked.query.payload, Join))
        request.answer.add_done_callback(answered)
        return request

    def _be_over(self) -> None:
        super()._be_over()
        if self.session.is_local:
            self.network.go_down()

    def _patience(self) -> float:
        return min(MOST_WAIT, max(0.0, self.turn.next_deadline() - self.now))

    def _step(self) -> None:
        for event in self.events():
            if isinstance(event, RunOpened):
                self._begin(event)
            elif isinstance(event, RunNotOpened):
                raise event.reason
            else:
                self._hear(event)
        self.turn.step(self.now)
        for lane in self.lanes:
            if lane.is_done:
                self.note(f"{lane.run} is done")
                del self.lanes.open[lane.run]
        self.is_done = not (self.lanes.open or self._left or self._is_opening)

    def _hear(self, event: object) -> None:
        """Let the turn hear an event; a run whose records became fewer is opened again."""
        self.link_is_up = event.up if isinstance(event, LinkChange) else self.link_is_up
        try:
            self.turn.take(event, self.now)
        except RecorderFellBack as fallen:
            self.note(str(fallen))
            if self.lanes.open.pop(fallen.run, None) is not None:
                self.turn.withdraw(fallen.run)
                self._left.insert(0, fallen.run)

    # Runs are opened, as in a thread of their own.

    def _open_another(self) -> None:
        if self._left and not self._is_opening and (self.turn.wants_more or not self.lanes.open):
            self._is_opening = True
            self._try_to_open(self._left.pop(0))

    def _try_to_open(self, run: str) -> None:
        if self.is_over:
            return
        if self.is_frozen:
            self.world.later(RETRY, lambda: self._try_to_open(run))
            return
        assignment = self._assignment(run)
        bus: Bus = Line(self)  # type: ignore[assignment]
        lane = ActiveRun(assignment, RecorderClient(bus, JOB, assignment.shape))
        try:
            opened = lane.open(self.turn.epoch, not_now)
        except (NotNow, NoReply):
            self.world.later(RETRY, lambda: self._try_to_open(run))
        except (InputError, TookOver) as refusal:
            self.hear(RunNotOpened(refusal))
        else:
            self.note(f"opened {lane.run} in epoch {opened.epoch} with {opened.durable[0]} rows")
            self.world.later(
                self.world.exponential(self._opening), lambda: self.hear(RunOpened(lane, opened))
            )

    def _begin(self, news: RunOpened) -> None:
        self._is_opening = False
        if not self.turn.epoch:
            self._begin_turn(news.opened.epoch)
        self.turn.begin(news.lane, news.opened)
        self.lanes.open[news.lane.run] = news.lane

    def _begin_turn(self, epoch: int) -> None:
        self.turn = JobScheduler(JOB, epoch, self.lanes, self._put, self._batch_size)
        self.link_is_up = True
        self._met(self)
        for pattern in (KEYS.result(), KEYS.stat("worker/*")):
            self.network.subscribe(self.session, pattern)
        self.network.answer(self.session, KEYS.join)
        self.network.answer(self.session, KEYS.asset())
        self.network.watch(self.session, KEYS.worker_token())
        self.network.watch(self.session, KEYS.coordinator_token())
        self.network.token(self.session, KEYS.coordinator_token(epoch))

    def _put(self, key: str, message: Message, channel: Channel) -> None:
        kind = messages.encoding(type(message))
        self.network.put(self.session, key, messages.encode(message), kind, channel)
