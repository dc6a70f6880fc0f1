"""The roster: which workers there are, what they hold, and how long they are waited for.

Rules 1, 3 and 4 of docs/bus.md: credit, join numbers, lost tokens and leases that pass. Time is passed in,
in seconds of any steady clock.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from math import inf

from qdgrasp_coordinator.dispatching.member import GRACE, LATE, FreeHands, Member
from qdgrasp_coordinator.dispatching.pace import Patience


@dataclass(frozen=True)
class Overdue:
    """A worker that is given up."""

    wid: str
    reason: str
    batches: list[bytes]
    """The ids of those it held."""


class Roster:
    """The workers of a job.

    With a thousand of them nobody looks at all for the sake of one: who is well, who has credit, and when the
    next may be overdue, is noted with every change.
    """

    def __init__(self) -> None:
        self.patience = Patience()
        self._members: dict[str, Member] = {}
        self._drained: set[str] = set()
        self._link_is_up = True
        self._joined = 0
        self._well: set[str] = set()
        self._free: dict[str, Member] = {}
        self._quiet_until = inf  # nobody is overdue before, with the patience that was left then
        self._limit = self.patience.limit

    def __iter__(self) -> Iterator[Member]:
        """All that are known, also those that are gone and not yet given up."""
        return iter(self._members.values())

    def __len__(self) -> int:
        """How many workers are there to stay, and make progress."""
        return len(self._well)

    def get(self, wid: str) -> Member | None:
        """What is known of a worker; None: nothing."""
        return self._members.get(wid)

    def admit(self, wid: str, number: int, credit: int, now: float) -> Member:
        """Take a worker on, with empty hands."""
        self._joined += 1
        member = Member(wid, number, credit, self._joined, now, is_drained=wid in self._drained)
        if (old := self._members.get(wid)) is not None:
            member.order, member.scenes = old.order, old.scenes
        self._members[wid] = member
        self._note(member)
        return member

    def hold(self, member: Member, batch_id: bytes, scene: str, now: float) -> None:
        """Hear that a worker is leased a batch."""
        member.hold(batch_id, scene, now)
        self._note(member)

    def release(self, wid: str, batch_id: bytes) -> None:
        """Hear that a worker holds a batch no more."""
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
        """Whether a worker is to leave."""
        return wid in self._drained

    def seen(self, wid: str, now: float) -> None:
        """Hear that a worker makes progress."""
        if (member := self._members.get(wid)) is not None:
            member.progressed(now)
            self._note(member)

    def gone(self, wid: str, now: float) -> None:
        """Hear that a worker's token has vanished."""
        if (member := self._members.get(wid)) is not None and member.gone_at is None:
            member.gone_at = now
            self._note(member)

    def expect(self, wid: str, now: float) -> None:
        """Wait for the token of a worker that has just joined: it is late, or the worker is gone."""
        self.gone(wid, now + LATE - GRACE)
        if (member := self._members.get(wid)) is not None:
            member.is_expected = True

    def back(self, wid: str) -> None:
        """Hear that a worker's token is there."""
        if (member := self._members.get(wid)) is not None:
            member.gone_at, member.is_expected = None, False
            self._note(member)

    def link(self, is_up: bool, now: float) -> None:
        """Hear that the coordinator's own link went down or came up; while it is down no time passes."""
        if is_up and not self._link_is_up:
            for member in self._members.values():
                member.progress = now
                member.gone_at = None if member.gone_at is None else now
            self._look_at_all()
        self._link_is_up = is_up

    def overdue(self, now: float) -> list[Overdue]:
        """Give up those whose time is over: their hands are emptied; whose token vanished is forgotten."""
        if now < self.next_deadline():
            return []
        self._look_at_all()
        late = [member for member in self._members.values() if now >= member.deadline(self._limit)]
        given_up = [self._give_up(member) for member in late]
        self._look_at_all()
        return given_up

    def _give_up(self, member: Member) -> Overdue:
        batches, member.batches = list(member.batches), {}
        if member.gone_at is not None:
            del self._members[member.wid]
            self._well.discard(member.wid)
            self._free.pop(member.wid, None)
            return Overdue(member.wid, "its token vanished", batches)
        member.is_stuck = True
        self._note(member)
        return Overdue(member.wid, f"no sign of progress for {self._limit:.0f} seconds", batches)

    def next_deadline(self) -> float:
        """Before when `overdue` has nobody if nothing happens; infinite: never."""
        if self.patience.limit < self._limit:
            self._look_at_all()
        return self._quiet_until if self._link_is_up else inf

    def free(self) -> FreeHands:
        """The workers that may be leased more; stuck ones are among them only if no other is left."""
        return FreeHands([member for member in self._free.values() if not (member.is_stuck and self._well)])

    def _note(self, member: Member) -> None:
        """Take note of what has changed of a member."""
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
        """Find when the next one may be overdue, with the patience that there is now."""
        self._limit = self.patience.limit
        self._quiet_until = min(
            (member.deadline(self._limit) for member in self._members.values()), default=inf
        )
