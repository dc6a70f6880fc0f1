"""The team: what is known of a job's workers besides what they hold. Time is passed in."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field

from qdgrasp_coordinator.counts.speed import Speed
from qdgrasp_coordinator.counts.team import PAGE, TeamFigures, WorkerFigures
from qdgrasp_coordinator.dispatching.member import Member
from qdgrasp_protocol.messages import Join
from qdgrasp_protocol.sign import Sign

SHOWN_GONE = 60.0
"""Seconds for which a worker that is gone is still shown."""
MOST_GONE = 1024
"""So many of these at most."""
SHOWN = 8
"""So much of a worker's id tells it from others, mostly."""


@dataclass
class Mate:
    """A worker as it showed itself."""

    join: Join
    """The latest."""
    since: float
    heard: float
    """When something was heard of it last."""
    speed: Speed = field(init=False)
    rows: int = 0
    memory: int = 0
    restarts: int = 0

    def __post_init__(self) -> None:
        self.speed = Speed(self.since)

    @property
    def words(self) -> str:
        """Which one it is."""
        return f"Worker {self.join.wid[:SHOWN]} on {self.join.host} (process {self.join.pid})"

    def figures(self, state: str, batches: int, now: float) -> WorkerFigures:
        """How it is."""
        return WorkerFigures(
            wid=self.join.wid,
            host=self.join.host,
            pid=self.join.pid,
            state=state,
            batches=batches,
            rows=self.rows,
            rate=round(self.speed.at(now), 2),
            seconds=round(now - self.since, 2),
            seen=round(now - self.heard, 2),
            memory=self.memory,
            restarts=self.restarts,
        )


class Team:
    """The workers that have joined, and for a while those that are gone."""

    def __init__(self) -> None:
        self._mates: dict[str, Mate] = {}
        self._gone: dict[str, tuple[Mate, float]] = {}

    def joined(self, join: Join, now: float) -> bool:
        """Note a worker's join; gives whether it was not there before."""
        mate = self._mates.get(join.wid)
        if mate is None:
            back, _ = self._gone.pop(join.wid, (Mate(join, now, now), now))
            self._mates[join.wid] = back
        known = self._mates[join.wid]
        known.join, known.heard = join, now
        return mate is None

    def said(self, wid: str, sign: Sign, now: float) -> None:
        """Note what a worker says of itself."""
        if (mate := self._mates.get(wid)) is not None:
            mate.heard, mate.memory, mate.restarts = now, sign.memory, sign.restarts

    def settled(self, wid: str, rows: int, now: float) -> None:
        """Note that a worker has settled rows."""
        if (mate := self._mates.get(wid)) is not None:
            mate.heard = now
            mate.rows += rows
            mate.speed.count(rows, now)

    def lost(self, wid: str, now: float) -> None:
        """Note that a worker is gone."""
        if (mate := self._mates.pop(wid, None)) is not None:
            self._gone[wid] = (mate, now)
            if len(self._gone) > MOST_GONE:
                del self._gone[next(iter(self._gone))]

    def words(self, wid: str) -> str:
        """Which worker that is, for a person."""
        return self._mates[wid].words if wid in self._mates else f"Worker {wid[:SHOWN]}"

    def is_leaving(self, wid: str) -> bool:
        """Whether a worker has said that it is about to leave."""
        return wid in self._mates and not self._mates[wid].join.credit

    def figures(self, members: Iterable[Member], now: float) -> list[WorkerFigures]:
        """Those that are there, in the order in which they joined."""
        there = ((self._mates.get(member.wid), member) for member in members)
        return [mate.figures(member.state, len(member.batches), now) for mate, member in there if mate]

    def pages(self, members: Iterable[Member], now: float) -> list[TeamFigures]:
        """All that are shown, page by page, at least one; behind those that are there stand the gone ones."""
        shown = [*self.figures(members, now), *self._gone_ones(now)]
        firsts = range(0, max(1, len(shown)), PAGE)
        return [
            TeamFigures(page=page, pages=len(firsts), workers=shown[first : first + PAGE])
            for page, first in enumerate(firsts)
        ]

    def _gone_ones(self, now: float) -> Iterator[WorkerFigures]:
        self._gone = {wid: one for wid, one in self._gone.items() if now - one[1] < SHOWN_GONE}
        for mate, _ in self._gone.values():
            yield mate.figures("gone", 0, now)
