"""A member of the roster: what is known of one worker, and whose turn it is among several.

Rules 1, 3 and 4 of docs/bus.md. Time is passed in, in seconds of any steady clock.
"""

from collections import OrderedDict
from dataclasses import dataclass, field
from heapq import heapify, heappop, heappush
from math import inf

GRACE = 1.0
"""Seconds between the loss of a worker's token and the end of its leases."""
LATE = 30.0
"""Seconds by which a worker's token may come later than its question to join."""
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
    order: int
    """Which one it was to join first."""
    progress: float
    """When it last showed progress, or was leased something while it held nothing."""
    batches: dict[bytes, None] = field(default_factory=dict)
    """The ids of the batches it holds."""
    scenes: OrderedDict[str, None] = field(default_factory=OrderedDict)
    """The scenes it holds, the latest last."""
    gone_at: float | None = None
    """When its token vanished; None: it is there."""
    is_expected: bool = False
    """Its token is not there yet: it is not gone, but late."""
    is_stuck: bool = False
    """It let a lease pass; until it shows progress it gets no work, unless all are stuck."""
    is_drained: bool = False
    """It is to leave: it gets no more work."""

    @property
    def is_well(self) -> bool:
        """It is there to stay, and makes progress."""
        return self.gone_at is None and not self.is_stuck and not self.is_drained

    @property
    def has_credit(self) -> bool:
        """It is there, and may be leased more."""
        return len(self.batches) < self.credit and self.gone_at is None and not self.is_drained

    @property
    def state(self) -> str:
        """How it is, in a word."""
        if self.gone_at is not None and not self.is_expected:
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


class FreeHands:
    """Workers with credit left, the one with the fewest batches first.

    Of equals it is the one that was quiet for longest: with it every stuck worker gets its turn.
    """

    def __init__(self, members: list[Member]) -> None:
        self._heap = [(len(member.batches), member.progress, member.order, member) for member in members]
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
