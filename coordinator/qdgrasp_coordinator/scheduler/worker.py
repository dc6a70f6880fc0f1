"""A worker as its coordinator knows it, and the choice of the next one to lease to.

Time is passed in, in seconds of any steady clock.
"""

from collections import OrderedDict
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from heapq import heapify, heappop, heappush
from math import exp, expm1, inf

from qdgrasp_coordinator.metrics.job_status import WorkerStatus
from qdgrasp_coordinator.scheduler.batch_queue import WorkerName
from qdgrasp_protocol.errors import Refused
from qdgrasp_protocol.messages import Heartbeat, Join
from qdgrasp_protocol.text import first_few

RATE_SECONDS = 10.0  # Seconds after which what was counted weighs 1 / e


class RateMeter:
    """Recent rate of counting."""

    def __init__(self, now: float) -> None:
        self._since = self._last = now
        self._weighed = 0.0

    def count(self, amount: float, now: float) -> None:
        """Add an amount counted at `now`."""
        self._weighed = self._weighed * exp((self._last - now) / RATE_SECONDS) + amount
        self._last = now

    def rate(self, now: float) -> float:
        """Return the rate [1/s]: an exponentially weighted mean over the time there was."""
        if now <= self._since:
            return 0.0
        return (
            self._weighed
            * exp((self._last - now) / RATE_SECONDS)
            / (RATE_SECONDS * -expm1((self._since - now) / RATE_SECONDS))
        )


ANSWER_SECONDS, ANSWER_LIMITS = 600.0, 6
"""Time that a worker which shows progress may go without an answer: so many seconds, or lease timeouts."""
BUILD_SECONDS = 5400.0  # The same for one that builds a shape, whose process has limits of its own
SICK_SECONDS, MOST_SICK_SECONDS = 30.0, 1800.0
"""Time for which a sick worker gets no work, at first and at most; it doubles each time."""
PROVEN_SECONDS = 60.0  # Seconds for which a worker that answered is preferred to others
TOKEN_GRACE = 1.0  # Seconds between the loss of a worker's token and the end of its leases
SCENES_KEPT = 8  # Scenes that a worker keeps open, least recently used first out
NO_SIGN = Heartbeat(wid=32 * "0", host="")  # A sign that says nothing
WID_DIGITS = 8  # Characters of a worker's id that people are shown


@dataclass(eq=False)
class Worker:
    """A worker, the batches that it holds, and its figures."""

    join: Join
    """Its latest join request."""
    order: int
    """Ascends with its first join."""
    since: float
    """When it joined first."""
    progress: float
    """When it last showed progress, or was leased something while it held nothing."""
    heard: float
    """Time of its last message."""
    speed: RateMeter
    """Rate of the rows that it settles."""
    batches: dict[bytes, bool] = field(default_factory=dict)
    """The ids of the batches it holds; True: a shape that it builds."""
    scenes: OrderedDict[str, None] = field(default_factory=OrderedDict)
    """The scenes it holds, the latest last."""
    gone_at: float | None = None
    """When its token vanished; None: it is there."""
    is_expected: bool = False
    """True: its token is not gone, but late."""
    is_stuck: bool = False
    """It let a lease pass; until it shows progress it gets no work, unless all are stuck."""
    is_silent: bool = False
    """It shows progress and does not answer; it gets no work until it does, unless no worker is well."""
    is_drained: bool = False
    """It is to leave: it gets no more work."""
    answered: float = -inf
    """When it answered last."""
    sick_until: float = -inf
    """When it gets work again: its simulator failed on rows that others evaluated."""
    sick_seconds: float = SICK_SECONDS
    """For how long it is left out when it is sick again."""
    faults: float = 0.0
    """Rows that failed on it and not on the next worker, the latest counting most."""
    is_excluded: bool = False
    """It answered other than two other workers: nothing of it counts any more."""
    owes_since: float = 0.0
    """Since when it owes an answer: its last one, or when it was leased something while it held nothing."""
    rows: int = 0
    """Rows that it settled."""
    memory: int = 0
    restarts: int = 0
    sign: Heartbeat = NO_SIGN
    """Its latest sign; before the first one, one that says nothing."""

    @property
    def wid(self) -> str:
        """Its id."""
        return self.join.wid

    @property
    def name(self) -> WorkerName:
        """Its id and host."""
        return WorkerName(self.wid, self.join.host)

    @property
    def is_well(self) -> bool:
        """True if it is present, progressing, not left out and not leaving."""
        is_left_out = self.is_stuck or self.is_silent or self.is_sick or self.is_drained
        return self.gone_at is None and not is_left_out

    @property
    def is_sick(self) -> bool:
        """True while it is left out because its simulator fails."""
        return self.sick_until > -inf

    @property
    def is_building(self) -> bool:
        """True if it builds a shape: its core is taken for long."""
        return any(self.batches.values())

    @property
    def has_credit(self) -> bool:
        """True if it is present and may be leased more."""
        is_open = self.gone_at is None and not self.is_drained and not self.is_building
        return is_open and len(self.batches) < self.join.credit

    @property
    def state(self) -> str:
        """Its state: gone, excluded, leaving, sick, stuck, working or idle."""
        if self.gone_at is not None and not self.is_expected:
            return "gone"
        if self.is_excluded:
            return "excluded"
        if self.is_drained:
            return "leaving"
        if self.is_sick:
            return "sick"
        if self.is_stuck or self.is_silent:
            return "stuck"
        return "working" if self.batches else "idle"

    @property
    def description(self) -> str:
        """Id, host and process, for people."""
        return f"Worker {self.wid[:WID_DIGITS]} on {self.join.host} (process {self.join.pid})"

    def deadline(self, limit: float) -> float:
        """Return when it is given up if nothing is heard of it; infinite: never."""
        if self.gone_at is not None:
            return self.gone_at + TOKEN_GRACE
        return min(self.progress + limit, self.answer_by(limit)) if self.batches else inf

    def answer_by(self, limit: float) -> float:
        """Return when it is given up without an answer, whatever progress it shows."""
        longest = BUILD_SECONDS if self.is_building else max(ANSWER_SECONDS, ANSWER_LIMITS * limit)
        return self.owes_since + longest

    def hold(self, batch_id: bytes, scene: str | None, now: float) -> None:
        """Add a batch of a scene to those it holds; None: a shape that it builds."""
        if not self.batches:
            self.progress = self.owes_since = now
        self.batches[batch_id] = scene is None
        if scene is None:
            return
        self.scenes[scene] = None
        self.scenes.move_to_end(scene)
        if len(self.scenes) > SCENES_KEPT:
            self.scenes.popitem(last=False)

    def status(self, now: float) -> WorkerStatus:
        """Return its figures."""
        return WorkerStatus(
            wid=self.wid,
            host=self.join.host,
            pid=self.join.pid,
            state=self.state,
            batches=len(self.batches),
            rows=self.rows,
            rate=round(self.speed.rate(now), 2),
            seconds=round(now - self.since, 2),
            seen=round(now - self.heard, 2),
            memory=self.memory,
            restarts=self.restarts,
        )


def names_of(workers: Iterable[WorkerName]) -> str:
    """Return workers by their ids and hosts, for people."""
    return " and ".join(f"{wid[:WID_DIGITS]} on {host}" for wid, host in workers)


def fewest_batches_first(workers: list[Worker], now: float) -> Iterator[Worker]:
    """Yield the worker to lease to next, while one has credit left and took what it was offered.

    Among equals those that answered lately come first: a silent worker's batch is not given to the next
    silent one. Then comes the one that was quiet for longest, so that every stuck worker is tried.
    """

    def place(worker: Worker) -> tuple[int, bool, float, int]:
        is_proven = worker.answered >= now - PROVEN_SECONDS
        return len(worker.batches), not is_proven, worker.progress, worker.order

    heap = [(place(worker), worker) for worker in workers]
    heapify(heap)
    while heap:
        yield heap[0][-1]
        (count, *_), worker = heappop(heap)
        if worker.has_credit and len(worker.batches) > count:
            heappush(heap, (place(worker), worker))


WORKERS_NAMED = 5  # Most workers that a refusal names


def choose_workers(workers: list[Worker], worker: str, host: str, job: str) -> list[Worker]:
    """Return the workers meant: one by the beginning of its id, or all of a host."""
    if not (worker or host):
        raise Refused("it is not said whom to drain: name a worker or a host")
    if host:
        named, found = f"on host '{host}'", [one for one in workers if one.join.host == host]
    else:
        named, found = f"'{worker}'", [one for one in workers if one.wid.startswith(worker)]
    if not found:
        raise Refused(f"job '{job}' has no worker {named}; {_list_workers(workers)}")
    if worker and len(found) > 1:
        raise Refused(f"job '{job}' has {len(found)} workers whose ids begin so; {_list_workers(found)}")
    return found


def _list_workers(workers: list[Worker]) -> str:
    names = [names_of([one.name]) for one in workers]
    return f"there are {first_few(names, WORKERS_NAMED)}" if names else "none has joined"
