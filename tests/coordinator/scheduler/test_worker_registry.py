"""What the roster notes with every change is what a look at all its members would find."""

import random

import pytest

from qdgrasp_coordinator.scheduler.worker_registry import WorkerRegistry

SCENE = "0" * 64
WORKERS = [f"{number:032x}" for number in range(6)]
CREDIT = 2


class Turmoil:
    """Random things that happen to a roster, as dispatch has them happen."""

    def __init__(self, seed: int) -> None:
        self.roster = WorkerRegistry()
        self.now = 0.0
        self._chance = random.Random(seed)  # noqa: S311
        self._batches = 0
        self._link_is_up = True

    def happen(self) -> None:
        wid = self._chance.choice(WORKERS)
        self._chance.choice(
            [
                self._join,
                self._lease,
                self._lease,
                self._lease,
                self._release,
                self._release,
                lambda _: self._pass(),
                lambda wid: self.roster.seen(wid, self.now),
                lambda wid: self.roster.gone(wid, self.now),
                lambda wid: self.roster.expect(wid, self.now),
                self.roster.back,
                lambda _: self._link(),
                lambda wid: self.roster.drain(wid) if self._chance.random() < 0.02 else None,
                lambda _: self.roster.patience.measure(self._chance.choice([0.1, 2.0, 5.0])),
            ]
        )(wid)

    def _join(self, wid: str) -> None:
        member = self.roster.get(wid)
        self.roster.admit(wid, member.number + 1 if member else 1, CREDIT, self.now)

    def _lease(self, _: str) -> None:
        member = self.roster.free().first
        if member is not None:
            self._batches += 1
            self.roster.hold(member, self._batches.to_bytes(16), SCENE, self.now)

    def _release(self, wid: str) -> None:
        member = self.roster.get(wid)
        for batch in list(member.batches)[:1] if member else ():
            self.roster.release(wid, batch)

    def _pass(self) -> None:
        self.now += self._chance.choice([0.1, 1.0, 7.0])

    def _link(self) -> None:
        self._link_is_up = not self._link_is_up
        self.roster.link(self._link_is_up, self.now)

    # What a look at all of them finds.

    @property
    def deadline(self) -> float:
        limit = self.roster.patience.limit
        deadlines = [member.deadline(limit) for member in self.roster] if self._link_is_up else []
        return min(deadlines, default=float("inf"))

    @property
    def late(self) -> set[str]:
        limit = self.roster.patience.limit
        return {
            member.wid for member in self.roster if self._link_is_up and self.now >= member.deadline(limit)
        }

    @property
    def free(self) -> set[str]:
        well = any(member.is_well for member in self.roster)
        return {member.wid for member in self.roster if member.has_credit and not (member.is_stuck and well)}


def leased_in_turn(roster: WorkerRegistry) -> set[str]:
    """Who would be leased a batch next, if none took more than one."""
    hands, found = roster.free(), set()
    while (member := hands.first) is not None and member.wid not in found:
        found.add(member.wid)
        hands._heap.pop(0)
        hands._heap.sort()
    return found


@pytest.mark.parametrize("seed", range(30))
def test_notes_are_what_a_look_at_all_members_finds(seed: int) -> None:
    turmoil = Turmoil(seed)
    roster = turmoil.roster
    for _ in range(300):
        turmoil.happen()
        assert len(roster) == sum(member.is_well for member in roster)
        assert leased_in_turn(roster) == turmoil.free
        assert roster.next_deadline() <= turmoil.deadline
        late = turmoil.late
        assert {overdue.wid for overdue in roster.overdue(turmoil.now)} == late


def test_who_is_overdue_tells_what_it_held_and_holds_it_no_more() -> None:
    roster = WorkerRegistry()
    member = roster.admit(WORKERS[0], 1, CREDIT, 0.0)
    roster.hold(member, b"a" * 16, SCENE, 0.0)
    roster.gone(WORKERS[0], 1.0)
    (overdue,) = roster.overdue(100.0)
    assert (overdue.wid, overdue.batches) == (WORKERS[0], [b"a" * 16])
    assert roster.get(WORKERS[0]) is None
    assert roster.next_deadline() == float("inf")
