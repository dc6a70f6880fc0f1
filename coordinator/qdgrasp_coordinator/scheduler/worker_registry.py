"""The workers of a job: what each of them holds, and how long it is waited for.

Rules 1, 3 and 4 of docs/bus.md: credit, join numbers, lost tokens and leases that pass. Time is passed in,
in seconds of any steady clock.
"""

from collections import OrderedDict, deque
from collections.abc import Iterator
from dataclasses import dataclass, field
from heapq import heapify, heappop, heappush
from math import ceil, inf

LEASE_SECONDS = 10.0  # The shortest time without a sign of progress after which a lease is over
LEASE_TURNS = 10  # A lease may take so many times the 95th percentile of turnarounds, if that is longer
_TURNS = 256


TOKEN_GRACE = 1.0  # Seconds between the loss of a worker's token and the end of its leases
TOKEN_DELAY = 30.0  # Seconds by which a worker's token may come later than its request to join
SCENES_KEPT = 8  # Scenes that a worker keeps open, least recently used first out


@dataclass(eq=False)
class Worker:
    """A worker and its leases."""

    wid: str
    number: int
    """Number of its latest join."""
    credit: int
    """Most batches it may hold."""
    order: int
    """Ascends with its first join."""
    progress: float
    """When it last showed progress, or was leased something while it held nothing."""
    batches: dict[bytes, None] = field(default_factory=dict)
    """The ids of the batches it holds."""
    scenes: OrderedDict[str, None] = field(default_factory=OrderedDict)
    """The scenes it holds, the latest last."""
    gone_at: float | None = None
    """When its token vanished; None: it is there."""
    is_expected: bool = False
    """True: its token is not gone, but late."""
    is_stuck: bool = False
    """It let a lease pass; until it shows progress it gets no work, unless all are stuck."""
    is_drained: bool = False
    """It is to leave: it gets no more work."""

    @property
    def is_well(self) -> bool:
        """True if it is present, progressing and not leaving."""
        return self.gone_at is None and not self.is_stuck and not self.is_drained

    @property
    def has_credit(self) -> bool:
        """True if it is present and may be leased more."""
        return len(self.batches) < self.credit and self.gone_at is None and not self.is_drained

    @property
    def state(self) -> str:
        """Its state: gone, leaving, stuck, working or idle."""
        if self.gone_at is not None and not self.is_expected:
            return "gone"
        if self.is_drained:
            return "leaving"
        if self.is_stuck:
            return "stuck"
        return "working" if self.batches else "idle"

    def deadline(self, limit: float) -> float:
        """Return when it is given up if nothing is heard of it; infinite: never."""
        if self.gone_at is not None:
            return self.gone_at + TOKEN_GRACE
        return self.progress + limit if self.batches else inf

    def progressed(self, now: float) -> None:
        """Record a sign of progress."""
        self.progress = now
        self.is_stuck = False

    def hold(self, batch_id: bytes, scene: str, now: float) -> None:
        """Add a batch to those it holds."""
        if not self.batches:
            self.progress = now
        self.batches[batch_id] = None
        self.scenes[scene] = None
        self.scenes.move_to_end(scene)
        if len(self.scenes) > SCENES_KEPT:
            self.scenes.popitem(last=False)


class IdleWorkerQueue:
    """Workers with credit left, the one with the fewest batches first.

    Among equals the one that was quiet for longest comes first, so that every stuck worker is tried.
    """

    def __init__(self, members: list[Worker]) -> None:
        self._heap = [(len(member.batches), member.progress, member.order, member) for member in members]
        heapify(self._heap)

    @property
    def first(self) -> Worker | None:
        """The worker to lease to next; None: no worker has credit left."""
        return self._heap[0][-1] if self._heap else None

    def next(self) -> None:
        """Update the order after the first was leased a batch."""
        *_, order, member = heappop(self._heap)
        if member.has_credit:
            heappush(self._heap, (len(member.batches), member.progress, order, member))


@dataclass(frozen=True)
class OverdueWorker:
    """A worker that is given up."""

    wid: str
    reason: str
    batches: list[bytes]
    """Ids of the batches it held."""


class WorkerRegistry:
    """The workers of a job.

    Which are well, which have credit, and when the next may be overdue, is updated with every change:
    an event of one worker needs no pass over a thousand.
    """

    def __init__(self) -> None:
        self.patience = LeaseTimeout()
        self._members: dict[str, Worker] = {}
        self._drained: set[str] = set()
        self._link_is_up = True
        self._joined = 0
        self._well: set[str] = set()
        self._free: dict[str, Worker] = {}
        self._quiet_until = inf  # nobody is overdue before, with the patience that was left then
        self._limit = self.patience.limit

    def __iter__(self) -> Iterator[Worker]:
        """Iterate over all known workers, also gone ones not yet given up."""
        return iter(self._members.values())

    def __len__(self) -> int:
        """Number of workers present, progressing and not leaving."""
        return len(self._well)

    def get(self, wid: str) -> Worker | None:
        """Return a worker; None: unknown."""
        return self._members.get(wid)

    def admit(self, wid: str, number: int, credit: int, now: float) -> Worker:
        """Add or replace a worker that joined, without batches."""
        self._joined += 1
        member = Worker(wid, number, credit, self._joined, now, is_drained=wid in self._drained)
        if (old := self._members.get(wid)) is not None:
            member.order, member.scenes = old.order, old.scenes
        self._members[wid] = member
        self._note(member)
        return member

    def hold(self, member: Worker, batch_id: bytes, scene: str, now: float) -> None:
        """Record that a worker is leased a batch."""
        member.hold(batch_id, scene, now)
        self._note(member)

    def release(self, wid: str, batch_id: bytes) -> None:
        """Record that a worker holds a batch no more."""
        if (member := self._members.get(wid)) is not None:
            member.batches.pop(batch_id, None)
            self._note(member)

    def drain(self, wid: str) -> None:
        """Give a worker no more work, whenever it joins."""
        self._drained.add(wid)
        if (member := self._members.get(wid)) is not None:
            member.is_drained = True
            self._note(member)

    def is_drained(self, wid: str) -> bool:
        """True if a worker is to leave."""
        return wid in self._drained

    def seen(self, wid: str, now: float) -> None:
        """Record that a worker makes progress."""
        if (member := self._members.get(wid)) is not None:
            member.progressed(now)
            self._note(member)

    def gone(self, wid: str, now: float) -> None:
        """Record that a worker's token vanished."""
        if (member := self._members.get(wid)) is not None and member.gone_at is None:
            member.gone_at = now
            self._note(member)

    def expect(self, wid: str, now: float) -> None:
        """Await the token of a worker that has just joined, at most `TOKEN_DELAY` seconds."""
        self.gone(wid, now + TOKEN_DELAY - TOKEN_GRACE)
        if (member := self._members.get(wid)) is not None:
            member.is_expected = True

    def back(self, wid: str) -> None:
        """Record that a worker's token is there."""
        if (member := self._members.get(wid)) is not None:
            member.gone_at, member.is_expected = None, False
            self._note(member)

    def link(self, is_up: bool, now: float) -> None:
        """Record a change of the coordinator's own link; while it is down no deadline passes."""
        if is_up and not self._link_is_up:
            for member in self._members.values():
                member.progress = now
                member.gone_at = None if member.gone_at is None else now
            self._look_at_all()
        self._link_is_up = is_up

    def overdue(self, now: float) -> list[OverdueWorker]:
        """Give up overdue workers: take their batches, and forget those whose token vanished."""
        if now < self.next_deadline():
            return []
        self._look_at_all()
        late = [member for member in self._members.values() if now >= member.deadline(self._limit)]
        given_up = [self._give_up(member) for member in late]
        self._look_at_all()
        return given_up

    def _give_up(self, member: Worker) -> OverdueWorker:
        batches, member.batches = list(member.batches), {}
        if member.gone_at is not None:
            del self._members[member.wid]
            self._well.discard(member.wid)
            self._free.pop(member.wid, None)
            return OverdueWorker(member.wid, "its token vanished", batches)
        member.is_stuck = True
        self._note(member)
        return OverdueWorker(member.wid, f"no sign of progress for {self._limit:.0f} seconds", batches)

    def next_deadline(self) -> float:
        """Return the time before which no worker is overdue; infinite: never."""
        if self.patience.limit < self._limit:
            self._look_at_all()
        return self._quiet_until if self._link_is_up else inf

    def free(self) -> IdleWorkerQueue:
        """Return the workers with credit left; stuck ones only if no worker is well."""
        return IdleWorkerQueue(
            [member for member in self._free.values() if not (member.is_stuck and self._well)]
        )

    def _note(self, member: Worker) -> None:
        """Update the indexes after a worker has changed."""
        if member.is_well:
            self._well.add(member.wid)
        else:
            self._well.discard(member.wid)
        if member.has_credit:
            self._free[member.wid] = member
        else:
            self._free.pop(member.wid, None)
        self._quiet_until = min(self._quiet_until, member.deadline(self._limit))

    def _look_at_all(self) -> None:
        """Recompute the next deadline with the present lease timeout."""
        self._limit = self.patience.limit
        self._quiet_until = min(
            (member.deadline(self._limit) for member in self._members.values()), default=inf
        )


class LeaseTimeout:
    """Lease timeout: the longest wait for progress of a worker that holds leases."""

    def __init__(self) -> None:
        self._turns: deque[float] = deque(maxlen=_TURNS)
        self._limit: float | None = LEASE_SECONDS

    def measure(self, seconds: float) -> None:
        """Record the time from lease to result of a batch [s]."""
        self._turns.append(seconds)
        self._limit = None

    @property
    def limit(self) -> float:
        """max(10 s, 10 x the 95th percentile of turnarounds) (docs/bus.md, rule 4)."""
        if self._limit is None and LEASE_TURNS * max(self._turns) <= LEASE_SECONDS:
            self._limit = LEASE_SECONDS
        if self._limit is None:
            turns = sorted(self._turns)
            self._limit = max(LEASE_SECONDS, LEASE_TURNS * turns[ceil(0.95 * len(turns)) - 1])
        return self._limit
