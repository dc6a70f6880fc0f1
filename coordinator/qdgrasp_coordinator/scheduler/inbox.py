"""Events of a coordinator in their order, and the subscriptions that bring them.

Callbacks, in threads of the bus, only put events into the inbox; requests wait for the answer of the
coordinator's one thread.
"""

from collections.abc import Callable
from concurrent.futures import Future
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path
from queue import Empty, SimpleQueue
from typing import TypeVar

from qdgrasp_assets.scene import Bundle
from qdgrasp_coordinator.scheduler.run_registry import LoaderEvent
from qdgrasp_protocol import messages
from qdgrasp_protocol.bus import Bus, LinkChange, Query, Sample, TokenChange, answer_chunk, answer_file_chunk
from qdgrasp_protocol.errors import MessageError, NoReply, Refused
from qdgrasp_protocol.keys import Keys, last_chunk
from qdgrasp_protocol.messages import Join, Order, OrderReply, shorten, worker_id

ANSWER_TIMEOUT = 5.0  # seconds that a question waits for the coordinator's one thread

T = TypeVar("T")


@dataclass(frozen=True)
class JoinRequest:
    """A worker's request to join, and its answer."""

    join: Join
    answer: Future[bytes] = field(default_factory=Future)


@dataclass(frozen=True)
class AdminRequest:
    """An administrator's command, and its answer in words."""

    order: Order
    answer: Future[str] = field(default_factory=Future)


@dataclass(frozen=True)
class Wake:
    """Wakes the thread to check for signals."""


InboxEvent = Sample | JoinRequest | AdminRequest | TokenChange | LinkChange | LoaderEvent | Wake


class Inbox:
    """Events in the order they came."""

    def __init__(self) -> None:
        self._queue: SimpleQueue[InboxEvent] = SimpleQueue()

    def put(self, event: InboxEvent) -> None:
        """Add an event; safe in a signal handler."""
        self._queue.put(event)

    def take(self, patience: float, most: int = 256) -> list[InboxEvent]:
        """Return at most `most` events, waiting at most `patience` seconds for the first."""
        events: list[InboxEvent] = []
        try:
            events.append(self._queue.get(timeout=max(0.0, patience)))
            while len(events) < most:
                events.append(self._queue.get_nowait())
        except Empty:
            pass
        return events


class BusSubscriptions(ExitStack):
    """The coordinator's bus subscriptions; a context manager that closes them.

    `asset` returns the scene of a digest, or the file of a shape, or None; `show` answers queries for the
    job's status. Both are called in any thread.
    """

    def __init__(
        self,
        bus: Bus,
        keys: Keys,
        inbox: Inbox,
        asset: Callable[[str], Bundle | Path | None],
        show: Callable[[Query], dict[str, bytes]],
    ) -> None:
        super().__init__()
        self._bus = bus
        self._keys = keys
        self._inbox = inbox
        self._asset = asset
        self._show = show

    def open(self) -> None:
        """Subscribe for recorders, monitors and administrators."""
        enter, bus, keys = self.enter_context, self._bus, self._keys
        enter(bus.subscribe(keys.recorded, self._inbox.put))
        enter(bus.watch(keys.recorder_token(), self._put_token))
        enter(bus.answer(keys.control, self._answer_order))
        for shown in (keys.stat(), keys.meta, keys.recent):
            enter(bus.answer_values(shown, self._show))

    def open_to_workers(self, epoch: int) -> None:
        """Subscribe to results, joins and scene queries, then put up the token for workers."""
        enter, bus, keys = self.enter_context, self._bus, self._keys
        enter(bus.subscribe(keys.result(), self._inbox.put))
        enter(bus.subscribe(keys.stat("worker/*"), self._inbox.put))
        enter(bus.answer(keys.join, self._answer_join))
        enter(bus.answer(keys.asset(), self._answer_asset))
        enter(bus.watch(keys.worker_token(), self._put_token))
        enter(bus.on_link(lambda up: self._inbox.put(LinkChange(up))))
        enter(bus.watch(keys.coordinator_token(), self._put_token))
        enter(bus.token(keys.coordinator_token(epoch)))

    def _put_token(self, key: str, alive: bool) -> None:
        self._inbox.put(TokenChange(key, alive))

    def _answer_join(self, query: Query) -> bytes:
        try:
            request = JoinRequest(messages.decode(query.payload, Join))
        except MessageError as error:
            raise Refused(str(error)) from None
        if worker_id(request.join.key) != request.join.wid:
            raise Refused(
                f"the id {request.join.wid} is not that of the worker's key: it is another worker's"
            )
        self._inbox.put(request)
        return _await(request.answer)

    def _answer_order(self, query: Query) -> bytes:
        try:
            request = AdminRequest(messages.decode(query.payload, Order))
        except MessageError as error:
            raise Refused(str(error)) from None
        self._inbox.put(request)
        return messages.encode(OrderReply(words=shorten(_await(request.answer))))

    def _answer_asset(self, query: Query) -> bytes:
        digest = last_chunk(query.key)
        asset = self._asset(digest)
        if asset is None:
            raise Refused(f"no run in progress has the scene {digest[:12]}")
        if isinstance(asset, Path):
            return answer_file_chunk(query, asset)
        return answer_chunk(query, asset.payload, digest)


def _await(answer: "Future[T]") -> T:
    try:
        return answer.result(ANSWER_TIMEOUT)
    except TimeoutError:
        raise NoReply("the coordinator is busy") from None
