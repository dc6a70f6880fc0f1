"""The coordinator on the bus: ask, dispatch, settle, tell - for every run of a job at once.

One thread does everything but opening runs; callbacks of the bus and the run loader only fill its inbox.
`JobScheduler` decides on each event; its decisions are carried out here.
"""

import time
from collections.abc import Callable
from concurrent.futures import Future
from contextlib import closing

import structlog

from qdgrasp_coordinator.metrics.job_status import EventLog, JobStatus
from qdgrasp_coordinator.scheduler.inbox import AdminRequest, BusSubscriptions, Inbox, Wake
from qdgrasp_coordinator.scheduler.job_scheduler import EarlyStop, JobScheduler
from qdgrasp_coordinator.scheduler.recorder_client import RowSink
from qdgrasp_coordinator.scheduler.run_plan import RunPlan, RunQueue
from qdgrasp_coordinator.scheduler.run_registry import RunLoader, RunRegistry
from qdgrasp_coordinator.scheduler.status_publisher import StatusPublisher
from qdgrasp_protocol import messages
from qdgrasp_protocol.bus import Bus, Channel
from qdgrasp_protocol.errors import Refused
from qdgrasp_protocol.keys import Keys
from qdgrasp_protocol.messages import Message, Opened, Order
from qdgrasp_protocol.process import Stop

log = structlog.get_logger()

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
        self._inbox = Inbox()
        self._events = EventLog(lambda event: self._publisher.publish_event(event))
        self._runs = RunRegistry(queue, RunLoader(queue, make_sink, self._inbox.put, stop, begin_epoch))
        self.scheduler = JobScheduler(
            job,
            self._runs,
            self._put,
            batch_size=batch_size,
            events=self._events,
            stopping=EarlyStop(seconds, time.monotonic()),
            on_epoch=self._open_to_workers,
            on_finished=lambda run, now: self._publisher.publish_run(run, now),
        )
        self.scheduler.is_paused = paused
        self._publisher = StatusPublisher(bus, self.scheduler)
        self._subscriptions = BusSubscriptions(
            bus, Keys(job), self._inbox, self._runs.asset, self._publisher.cache.answer
        )

    def run(self, on_step: Callable[[float], None] = lambda _now: None) -> None:
        """Carry all runs out until they are finished and recorded, or until asked to stop.

        `on_step` is called with the time at every step. Raises TookOver if another coordinator goes on with
        the job, Cancelled if the job was cancelled, and RunsFailed if runs could not be carried out, while
        the others were: a scene that cannot be built, a recorder that holds another run, a journal that is
        not what its spec replays to.
        """
        self._stop.tell(lambda: self._inbox.put(Wake()))
        scheduler, runs = self.scheduler, self._runs
        with closing(runs), self._subscriptions:
            self._publisher.open(time.monotonic())
            self._subscriptions.open()
            while not (self._stop.is_set or runs.are_done or scheduler.has_ended(time.monotonic())):
                self._step()
                on_step(time.monotonic())
            cancelled = scheduler.stopping.reason
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

    def status(self, now: float) -> JobStatus:
        """Return the job's figures."""
        return self.scheduler.status(now)

    def _step(self) -> None:
        now = time.monotonic()
        deadline = min(self.scheduler.next_deadline(), self._publisher.due)
        for event in self._inbox.take(min(MOST_WAIT, max(0.0, deadline - now))):
            if isinstance(event, AdminRequest):
                self._obey(event.order, event.answer, time.monotonic())
            else:
                self.scheduler.handle(event, time.monotonic())
        now = time.monotonic()
        self.scheduler.step(now)
        self._publisher.publish_due(now)

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

    def _open_to_workers(self, epoch: int, identity: str) -> None:
        self._subscriptions.open_to_workers(epoch)
        self._publisher.publish_meta(identity)

    def _put(self, key: str, message: Message, channel: Channel) -> None:
        kind = messages.encoding(type(message))
        self._bus.put(key, messages.encode(message), encoding=kind, channel=channel)
