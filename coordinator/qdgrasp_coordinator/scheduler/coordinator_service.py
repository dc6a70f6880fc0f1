"""The coordinator on the bus: ask, dispatch, settle, tell - for every run of a job at once.

One thread does everything but opening runs; callbacks of the bus, in its threads, and the run loader only
put events into its inbox, and requests wait for the answer of the one thread. `JobScheduler` decides on each
event; its decisions are carried out here.
"""

import time
from collections.abc import Callable
from concurrent.futures import Future
from contextlib import ExitStack, closing, suppress
from dataclasses import dataclass, field
from math import inf
from pathlib import Path
from queue import Empty, SimpleQueue
from typing import TypeVar

import structlog

from qdgrasp_coordinator.metrics.job_status import EventLog
from qdgrasp_coordinator.scheduler.job_scheduler import (
    JobScheduler,
    JoinRequest,
    SchedulerEvent,
)
from qdgrasp_coordinator.scheduler.recorder_client import RowSink
from qdgrasp_coordinator.scheduler.run_plan import RunPlan, RunQueue
from qdgrasp_coordinator.scheduler.run_registry import RunLoader, RunRegistry
from qdgrasp_coordinator.scheduler.status_publisher import StatusPublisher
from qdgrasp_protocol import messages
from qdgrasp_protocol.bus import Bus, Channel, LinkChange, Query, TokenChange, answer_chunk, answer_file_chunk
from qdgrasp_protocol.errors import MessageError, NoReply, Refused
from qdgrasp_protocol.keys import Keys, last_chunk
from qdgrasp_protocol.messages import Join, Message, Opened, Order, OrderReply, shorten, worker_id
from qdgrasp_protocol.process import Stop

log = structlog.get_logger()

ANSWER_TIMEOUT = 5.0  # seconds that a question waits for the coordinator's one thread

T = TypeVar("T")
M = TypeVar("M", Join, Order)


@dataclass(frozen=True)
class AdminRequest:
    """An administrator's command, and its answer in words."""

    order: Order
    answer: Future[str] = field(default_factory=Future)


Inbox = SimpleQueue[SchedulerEvent | AdminRequest | None]
"""Input of the coordinator's one thread, in the order it came; None: check for signals."""


def _await(answer: "Future[T]") -> T:
    try:
        return answer.result(ANSWER_TIMEOUT)
    except TimeoutError:
        raise NoReply("the coordinator is busy") from None


def _decoded(query: Query, kind: type[M]) -> M:
    try:
        return messages.decode(query.payload, kind)
    except MessageError as error:
        raise Refused(str(error)) from None


MOST_EVENTS = 256  # events between two steps
MOST_WAIT = 0.5  # seconds that the inbox is waited for, at most


class CoordinatorService:
    """Carries out the runs of a job, each from its start or the end of its journal.

    As many runs of the queue are carried out at once as keep the workers busy; `make_sink` makes the sink
    that takes a run's rows, and `begin_epoch` asks a recorder for an epoch (`RunLoader`). A batch has
    `batch_size` rows; None: measured. After `seconds` leases are withdrawn, what was found is recorded, and
    `run` returns; None: never. If `paused`, nothing is handed out until a command continues the job.
    """

    def __init__(
        self,
        bus: Bus,
        stop: Stop,
        *,
        job: str,
        queue: RunQueue,
        make_sink: Callable[[RunPlan], RowSink],
        begin_epoch: Callable[[Callable[[], None]], Opened] | None = None,
        batch_size: int | None = None,
        seconds: float | None = None,
        paused: bool = False,
    ) -> None:
        self._bus = bus
        self._stop = stop
        self.inbox: Inbox = SimpleQueue()
        self._events = EventLog(lambda event: self._publisher.publish_event(event))
        self._runs = RunRegistry(queue, RunLoader(queue, make_sink, self.inbox.put, stop, begin_epoch))
        self.scheduler = JobScheduler(
            job,
            self._runs,
            self._put,
            batch_size=batch_size,
            events=self._events,
            ends_at=inf if seconds is None else time.monotonic() + seconds,
            on_epoch=self.open_to_workers,
            on_finished=lambda run, now: self._publisher.publish_run(run, now),
        )
        self.scheduler.is_paused = paused
        self._publisher = StatusPublisher(bus, self.scheduler)
        self._keys = Keys(job)
        self.subscriptions = ExitStack()

    def run(self, on_step: Callable[[float], None] = lambda _now: None) -> None:
        """Carry all runs out until they are finished and recorded, or until asked to stop.

        `on_step` is called with the time at every step. Raises TookOver if another coordinator goes on with
        the job, Cancelled if the job was cancelled, and RunsFailed if runs could not be carried out, while
        the others were: a scene that cannot be built, a recorder that holds another run, a journal that is
        not what its spec replays to.
        """
        self._stop.tell(lambda: self.inbox.put(None))
        self.inbox.put(None)  # the first step waits for nothing
        scheduler, runs = self.scheduler, self._runs
        with closing(runs), self.subscriptions:
            self._publisher.open(time.monotonic())
            self._subscribe()
            while not (self._stop.is_set or runs.are_done or scheduler.has_ended(time.monotonic())):
                self._step()
                on_step(time.monotonic())
            cancelled = scheduler.stop_reason
            reason = str("asked to stop" if self._stop.is_set else cancelled or "done")
            is_early = not (self._stop.is_set or runs.are_done)
            scheduler.is_cancelled = is_early and scheduler.has_ended(time.monotonic())
            self._publisher.publish(time.monotonic())
            self._events.note("job", f"The coordinator ends: {reason.rstrip('.')}.")
        log.info("ended", reason=reason, dropped=scheduler.drops.count, **scheduler.dispatcher.counters)
        if self._stop.is_set:
            return
        if cancelled and not runs.are_done:
            raise cancelled
        runs.check()

    def _step(self) -> None:
        now = time.monotonic()
        deadline = min(self.scheduler.ends_at, self._publisher.due)
        with suppress(Empty):
            self._take(self.inbox.get(timeout=min(MOST_WAIT, max(0.0, deadline - now))))
            for _ in range(MOST_EVENTS):
                self._take(self.inbox.get_nowait())
        now = time.monotonic()
        self.scheduler.step(now)
        if now >= self._publisher.due:
            self._publisher.publish(now)

    def _take(self, event: SchedulerEvent | AdminRequest | None) -> None:
        if isinstance(event, AdminRequest):
            self._obey(event.order, event.answer, time.monotonic())
        elif event is not None:
            self.scheduler.handle(event, time.monotonic())

    def _obey(self, order: Order, answer: "Future[str]", now: float) -> None:
        try:
            words = self.scheduler.obey(order, now)
        except Refused as refusal:
            answer.set_exception(refusal)
            return
        log.info("obeyed", order=order.act, words=words)
        self._events.note("job", words)
        self._publisher.publish(now)  # a status that is queried after the answer shows it done
        answer.set_result(words)

    # Callbacks of the bus, in any thread, only put events into the inbox.

    def _subscribe(self) -> None:
        """Subscribe for recorders, monitors and administrators."""
        enter, bus, keys = self.subscriptions.enter_context, self._bus, self._keys
        enter(bus.subscribe(keys.recorded, self.inbox.put))
        enter(bus.watch(keys.recorder_token(), self._put_token))
        enter(bus.answer(keys.control, self._answer_order))
        for shown in (keys.stat(), keys.meta, keys.recent):
            enter(bus.answer_values(shown, self._publisher.cache.answer))

    def open_to_workers(self, epoch: int, identity: str) -> None:
        """Subscribe to results, joins and scene queries, then put up the token for workers."""
        enter, bus, keys = self.subscriptions.enter_context, self._bus, self._keys
        enter(bus.subscribe(keys.result(), self.inbox.put))
        enter(bus.subscribe(keys.stat("worker/*"), self.inbox.put))
        enter(bus.answer(keys.join, self._answer_join))
        enter(bus.answer(keys.asset(), self._answer_asset))
        enter(bus.watch(keys.worker_token(), self._put_token))
        enter(bus.on_link(lambda up: self.inbox.put(LinkChange(up))))
        enter(bus.watch(keys.coordinator_token(), self._put_token))
        enter(bus.token(keys.coordinator_token(epoch)))
        self._publisher.publish_meta(identity)

    def _put_token(self, key: str, alive: bool) -> None:
        self.inbox.put(TokenChange(key, alive))

    def _answer_join(self, query: Query) -> bytes:
        request = JoinRequest(_decoded(query, Join))
        if worker_id(request.join.key) != request.join.wid:
            raise Refused(
                f"the id {request.join.wid} is not that of the worker's key: it is another worker's"
            )
        self.inbox.put(request)
        return _await(request.answer)

    def _answer_order(self, query: Query) -> bytes:
        request = AdminRequest(_decoded(query, Order))
        self.inbox.put(request)
        return messages.encode(OrderReply(words=shorten(_await(request.answer))))

    def _answer_asset(self, query: Query) -> bytes:
        digest = last_chunk(query.key)
        asset = self._runs.asset(digest)
        if asset is None:
            raise Refused(f"no run in progress has the scene {digest[:12]}")
        if isinstance(asset, Path):
            return answer_file_chunk(query, asset)
        return answer_chunk(query, asset.payload, digest)

    def _put(self, key: str, message: Message, channel: Channel) -> None:
        kind = messages.encoding(type(message))
        self._bus.put(key, messages.encode(message), encoding=kind, channel=channel)
