"""Subscriptions, queries and administrators' commands of a coordinator on the bus.

What comes goes into the inbox in threads of the bus, and is answered by the coordinator's one thread.
Commands (pause, continue, cancel, drain) have no say in what a run finds: they decide when and where rows
are evaluated, and when a coordinator ends. Whatever is recorded stays.
"""

from collections.abc import Callable
from concurrent.futures import Future
from contextlib import ExitStack
from typing import Self, TypeVar

from qdgrasp_assets.scene import Bundle
from qdgrasp_coordinator.metrics.job_status import WorkerStatus
from qdgrasp_coordinator.scheduler.job_scheduler import (
    AdminRequest,
    Inbox,
    JobScheduler,
    JoinRequest,
    LinkChange,
    TokenChange,
)
from qdgrasp_coordinator.scheduler.status_publisher import StatusCache
from qdgrasp_protocol import bundle_transfer, messages
from qdgrasp_protocol.bus import Bus, Query
from qdgrasp_protocol.errors import Cancelled, EndedEarly, MessageError, NoReply, Refused
from qdgrasp_protocol.keys import Keys, last_chunk
from qdgrasp_protocol.messages import Join, Order, OrderReply, shorten
from qdgrasp_protocol.text import counted, first_few

ANSWER_TIMEOUT = 5.0  # seconds that a question waits for the coordinator's one thread

T = TypeVar("T")


class RpcHandlers:
    """Passes requests to the coordinator's one thread, and answers scene queries.

    Parameters
    ----------
    scene
        The scene of a digest, or None; called in any thread.
    """

    def __init__(self, inbox: Inbox, scene: Callable[[str], Bundle | None]) -> None:
        self._inbox = inbox
        self._scene = scene

    def join(self, query: Query) -> bytes:
        """Hand a request to join over, and wait for the answer.

        Raises
        ------
        Refused
            It is no such request, or is refused.
        NoReply
            The coordinator is busy.
        """
        try:
            request = JoinRequest(messages.decode(query.payload, Join))
        except MessageError as error:
            raise Refused(str(error)) from None
        self._inbox.put(request)
        return _awaited(request.answer)

    def order(self, query: Query) -> bytes:
        """Hand an order over, and wait for what happened.

        Raises
        ------
        Refused
            It is no such order, or cannot be obeyed.
        NoReply
            The coordinator is busy.
        """
        try:
            request = AdminRequest(messages.decode(query.payload, Order))
        except MessageError as error:
            raise Refused(str(error)) from None
        self._inbox.put(request)
        return messages.encode(OrderReply(words=shorten(_awaited(request.answer))))

    def scene(self, query: Query) -> bytes:
        """One chunk of a scene.

        Raises
        ------
        Refused
            No run in progress has this scene.
        """
        digest = last_chunk(query.key)
        scene = self._scene(digest)
        if scene is None:
            raise Refused(f"no run in progress has the scene {digest[:12]}")
        return bundle_transfer.answer_chunk(query, scene.payload, digest)


def _awaited(answer: "Future[T]") -> T:
    try:
        return answer.result(ANSWER_TIMEOUT)
    except TimeoutError:
        raise NoReply("the coordinator is busy") from None


class BusSubscriptions:
    """The coordinator's bus subscriptions; a context manager that closes them."""

    def __init__(
        self, bus: Bus, keys: Keys, inbox: Inbox, reception: RpcHandlers, display: StatusCache
    ) -> None:
        self._bus = bus
        self._keys = keys
        self._inbox = inbox
        self._reception = reception
        self._display = display
        self._stack = ExitStack()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._stack.close()

    def open(self) -> None:
        """Subscribe for recorders, monitors and administrators."""
        enter, bus, keys = self._stack.enter_context, self._bus, self._keys
        enter(bus.subscribe(keys.recorded, self._inbox.put))
        enter(bus.watch(keys.recorder_token(), self._token_changed))
        enter(bus.answer(keys.control, self._reception.order))
        for shown in (keys.stat(), keys.meta, keys.recent):
            enter(bus.answer_values(shown, self._display.values))

    def open_to_workers(self, epoch: int) -> None:
        """Subscribe to results, joins and scene queries, then put up the token for workers."""
        enter, bus, keys = self._stack.enter_context, self._bus, self._keys
        enter(bus.subscribe(keys.result(), self._inbox.put))
        enter(bus.subscribe(keys.stat("worker/*"), self._inbox.put))
        enter(bus.answer(keys.join, self._reception.join))
        enter(bus.answer(keys.asset(), self._reception.scene))
        enter(bus.watch(keys.worker_token(), self._token_changed))
        enter(bus.on_link(lambda up: self._inbox.put(LinkChange(up))))
        enter(bus.watch(keys.coordinator_token(), self._token_changed))
        enter(bus.token(keys.coordinator_token(epoch)))

    def _token_changed(self, key: str, alive: bool) -> None:
        self._inbox.put(TokenChange(key, alive))


WID_DIGITS = 8  # Characters of a worker's id that people are shown
WORKERS_NAMED = 5  # Most workers that a refusal names


class AdminCommands:
    """Carries administrators' commands out.

    Parameters
    ----------
    job
        The job's name.
    turn
        Returns the scheduler of the present epoch.
    end
        Ends the coordinator early, for a reason.
    """

    def __init__(self, job: str, turn: Callable[[], JobScheduler], end: Callable[[EndedEarly], None]) -> None:
        self._job = job
        self._turn = turn
        self._end = end

    def obey(self, order: Order, now: float) -> str:
        """Carry a command out; returns what happened, in a sentence.

        Raises
        ------
        Refused
            It cannot be done, and why not.
        """
        if self._turn().is_ending:
            raise Refused(f"job '{self._job}' is ending already")
        return _COMMANDS[order.act](self, order, now)

    def _pause(self, _order: Order, _now: float) -> str:
        turn = self._turn()
        if turn.is_paused:
            return f"Job '{self._job}' is paused already; `qdgrasp continue {self._job}` has it go on."
        turn.is_paused = True
        out = counted(
            sum(len(member.batches) for member in turn.dispatch.members),
            "batch that is out still counts",
            "batches that are out still count",
        )
        return f"Job '{self._job}' is paused: nothing is handed out; {out}."

    def _continue(self, _order: Order, _now: float) -> str:
        turn = self._turn()
        if not turn.is_paused:
            return f"Job '{self._job}' is not paused."
        turn.is_paused = False
        return f"Job '{self._job}' goes on."

    def _cancel(self, _order: Order, _now: float) -> str:
        self._end(Cancelled(self._job))
        return (
            f"Job '{self._job}' ends. What is recorded stays: `qdgrasp resume DIR` (or `campaign`) goes on."
        )

    def _drain(self, order: Order, now: float) -> str:
        turn = self._turn()
        chosen = self._chosen(turn.crew.figures(now), order)
        for worker in chosen:
            turn.crew.drain(worker.wid)
        who = f"{len(chosen)} worker{'s' if len(chosen) > 1 else ''}"
        return f"Asked {who} of job '{self._job}' to finish the batches at hand and leave."

    def _chosen(self, workers: list[WorkerStatus], order: Order) -> list[WorkerStatus]:
        """Return the workers meant: one by the beginning of its id, or all of a host."""
        if not (order.worker or order.host):
            raise Refused("it is not said whom to drain: name a worker or a host")
        if order.host:
            named, found = f"on host '{order.host}'", [one for one in workers if one.host == order.host]
        else:
            found = [one for one in workers if one.wid.startswith(order.worker)]
            named = f"'{order.worker}'"
        if not found:
            raise Refused(f"job '{self._job}' has no worker {named}; {_known_workers(workers)}")
        if order.worker and len(found) > 1:
            raise Refused(
                f"job '{self._job}' has {len(found)} workers whose ids begin so; {_known_workers(found)}"
            )
        return found


_COMMANDS: dict[str, Callable[[AdminCommands, Order, float], str]] = {
    "pause": AdminCommands._pause,
    "continue": AdminCommands._continue,
    "cancel": AdminCommands._cancel,
    "drain": AdminCommands._drain,
}


def _known_workers(workers: list[WorkerStatus]) -> str:
    """Return the known workers in words."""
    if not workers:
        return "none has joined"
    return (
        f"there are {first_few([f'{one.wid[:WID_DIGITS]} on {one.host}' for one in workers], WORKERS_NAMED)}"
    )
