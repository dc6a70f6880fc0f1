"""The roster: which workers there are, what they hold, and how long they are waited for.

Rules 1, 3 and 4 of docs/bus.md: credit, join numbers, lost tokens and leases that pass. Time is passed in,
in seconds of any steady clock.
"""

from collections import OrderedDict
from collections.abc import Iterator
from dataclasses import dataclass, field
from heapq import heapify, heappop, heappush
from math import inf

from qdgrasp_coordinator.pace import Patience

GRACE = 1.0
"""Seconds between the loss of a worker's token and the end of its leases."""
SCENES = 8
"""Scenes that a worker keeps open, least recently used first out."""


@dataclass(eq=False)
class Member:
    """What is known of a worker."""

    wid: str
    number: int
    """How often it has joined."""
    credit: int
    """How many batches it may hold."""
    progress: float
    """When it last showed progress, or was leased something while it held nothing."""
    batches: dict[bytes, None] = field(default_factory=dict)
    """The ids of the batches it holds."""
    scenes: OrderedDict[str, None] = field(default_factory=OrderedDict)
    """The scenes it holds, the latest last."""
    gone_at: float | None = None
    """When its token vanished; None: it is there."""
    is_stuck: bool = False
    """It let a lease pass; until it shows progress it gets no work, unless all are stuck."""
    is_drained: bool = False
    """It is to leave: it gets no more work."""
    since: float = 0.0
    """When it joined first."""
    rows: int = 0
    """How many rows it has settled."""

    @property
    def is_well(self) -> bool:
        """It is there to stay, and makes progress."""
        return self.gone_at is None and not self.is_stuck and not self.is_drained

    @property
    def has_credit(self) -> bool:
        """It may be leased more."""
        return len(self.batches) < self.credit and not self.is_drained

    @property
    def state(self) -> str:
        """How it is, in a word."""
        if self.gone_at is not None:
            return "gone"
        if self.is_drained:
            return "leaving"
        if self.is_stuck:
            return "stuck"
        return "working" if self.batches else "idle"

    def deadline(self, limit: float) -> float:
        """When it is given up unless something is heard of it; infinite: never."""
        if self.gone_at is not None:
            return self.gone_at + GRACE
        return self.progress + limit if self.batches else inf

    def progressed(self, now: float) -> None:
        """Hear a sign of progress."""
        self.progress = now
        self.is_stuck = False

    def hold(self, batch_id: bytes, scene: str, now: float) -> None:
        """Take a batch into its hands."""
        if not self.batches:
            self.progress = now
        self.batches[batch_id] = None
        self.scenes[scene] = None
        self.scenes.move_to_end(scene)
        if len(self.scenes) > SCENES:
            self.scenes.popitem(last=False)


class Roster:
    """The workers of a job."""

    def __init__(self) -> None:
        self.patience = Patience()
        self._members: dict[str, Member] = {}
        self._drained: set[str] = set()
        self._link_is_up = True

    def __iter__(self) -> Iterator[Member]:
        """All that are known, also those that are gone and not yet given up."""
        return iter(self._members.values())

    def __len__(self) -> int:
        """How many workers are there to stay, and make progress."""
        return sum(member.is_well for member in self._members.values())

    def get(self, wid: str) -> Member | None:
        """What is known of a worker; None: nothing."""
        return self._members.get(wid)

    def admit(self, wid: str, number: int, credit: int, now: float) -> Member:
        """Take a worker on, with empty hands."""
        member = Member(wid, number, credit, progress=now, since=now, is_drained=wid in self._drained)
        if (old := self._members.get(wid)) is not None:
            member.scenes, member.since, member.rows = old.scenes, old.since, old.rows
        self._members[wid] = member
        return member

    def drain(self, wid: str) -> None:
        """Give a worker no more work, whenever it joins."""
        self._drained.add(wid)
        if wid in self._members:
            self._members[wid].is_drained = True

    def is_drained(self, wid: str) -> bool:
        """Whether a worker is to leave."""
        return wid in self._drained

    def seen(self, wid: str, now: float) -> None:
        """Hear that a worker makes progress."""
        if wid in self._members:
            self._members[wid].progressed(now)

    def settled(self, wid: str, rows: int) -> None:
        """Hear that a worker has settled rows."""
        if wid in self._members:
            self._members[wid].rows += rows

    def gone(self, wid: str, now: float) -> None:
        """Hear that a worker's token has vanished."""
        if wid in self._members and self._members[wid].gone_at is None:
            self._members[wid].gone_at = now

    def back(self, wid: str) -> None:
        """Hear that a worker's token is there."""
        if wid in self._members:
            self._members[wid].gone_at = None

    def link(self, is_up: bool, now: float) -> None:
        """Hear that the coordinator's own link went down or came up; while it is down no time passes."""
        if is_up and not self._link_is_up:
            for member in self._members.values():
                member.progress = now
                member.gone_at = None if member.gone_at is None else now
        self._link_is_up = is_up

    def overdue(self, now: float) -> list[tuple[Member, str]]:
        """The workers to give up now, and why; those whose token vanished are forgotten."""
        limit = self.patience.limit
        late = [
            member for member in self._members.values() if self._link_is_up and now >= member.deadline(limit)
        ]
        return [(member, self._give_up(member)) for member in late]

    def _give_up(self, member: Member) -> str:
        if member.gone_at is not None:
            del self._members[member.wid]
            return "its token vanished"
        member.is_stuck = True
        return f"no sign of progress for {self.patience.limit:.0f} seconds"

    def next_deadline(self) -> float:
        """When `overdue` has somebody if nothing happens before; infinite: never."""
        if not self._link_is_up:
            return inf
        limit = self.patience.limit
        return min((member.deadline(limit) for member in self._members.values()), default=inf)

    def free(self) -> "FreeHands":
        """The workers that may be leased more; stuck ones are among them only if all are stuck."""
        here = [member for member in self._members.values() if member.gone_at is None]
        return FreeHands([member for member in here if not member.is_stuck] or here)


class FreeHands:
    """Workers with credit left, the one with the fewest batches first.

    Of equals it is the one that was quiet for longest: with it every stuck worker gets its turn.
    """

    def __init__(self, members: list[Member]) -> None:
        self._heap = [
            (len(member.batches), member.progress, order, member)
            for order, member in enumerate(members)
            if member.has_credit
        ]
        heapify(self._heap)

    @property
    def first(self) -> Member | None:
        """The worker whose turn it is; None: nobody has credit left."""
        return self._heap[0][-1] if self._heap else None

    def next(self) -> None:
        """Hear that the first was leased something."""
        *_, order, member = heappop(self._heap)
        if member.has_credit:
            heappush(self._heap, (len(member.batches), member.progress, order, member))
