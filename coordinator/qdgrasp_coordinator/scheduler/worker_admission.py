"""Workers as they join, show signs of life, leave or are lost; and what is shown of them.

What each of them holds is the dispatcher's to know; time is passed in, in seconds of any steady clock.
"""

from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future
from dataclasses import dataclass, field
from math import exp, expm1

import structlog

from qdgrasp_coordinator.metrics.job_status import WORKERS_PER_PAGE, EventLog, WorkersPage, WorkerStatus
from qdgrasp_coordinator.scheduler.dispatcher import Dispatcher, LostWorker
from qdgrasp_coordinator.scheduler.worker_registry import Worker
from qdgrasp_coordinator.storage.run_folder import admit_platform
from qdgrasp_protocol import messages
from qdgrasp_protocol.bus import Channel
from qdgrasp_protocol.errors import Refused
from qdgrasp_protocol.keys import Keys
from qdgrasp_protocol.messages import VERSION, Control, Heartbeat, Join, Joined, Message

RATE_SECONDS = 10.0  # Seconds after which what was counted weighs 1 / e


class RateMeter:
    """Recent rate of counting. Time is passed in, in seconds of any steady clock."""

    def __init__(self, now: float) -> None:
        self._since = self._last = now
        self._weighed = 0.0

    def count(self, amount: float, now: float) -> None:
        """Add an amount counted at `now`."""
        self._weighed = self._weighed * exp((self._last - now) / RATE_SECONDS) + amount
        self._last = now

    def at(self, now: float) -> float:
        """Return the rate [1/s]: an exponentially weighted mean over the time there was."""
        if now <= self._since:
            return 0.0
        return (
            self._weighed
            * exp((self._last - now) / RATE_SECONDS)
            / (RATE_SECONDS * -expm1((self._since - now) / RATE_SECONDS))
        )


GONE_SECONDS = 60.0  # Seconds for which a worker that is gone is still shown
MOST_GONE = 1024  # Most workers shown that are gone
WID_DIGITS = 8  # Characters of a worker's id that people are shown


@dataclass
class WorkerInfo:
    """A worker's latest join and live figures."""

    join: Join
    """Its latest."""
    since: float
    heard: float
    """Time of its last message."""
    speed: RateMeter = field(init=False)
    rows: int = 0
    memory: int = 0
    restarts: int = 0

    def __post_init__(self) -> None:
        self.speed = RateMeter(self.since)

    @property
    def words(self) -> str:
        """Name of the worker, for people."""
        return f"Worker {self.join.wid[:WID_DIGITS]} on {self.join.host} (process {self.join.pid})"

    def figures(self, state: str, batches: int, now: float) -> WorkerStatus:
        """Return its figures."""
        return WorkerStatus(
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


class WorkerActivity:
    """The workers that have joined, and for a while those that are gone."""

    def __init__(self) -> None:
        self._mates: dict[str, WorkerInfo] = {}
        self._gone: dict[str, tuple[WorkerInfo, float]] = {}

    def joined(self, join: Join, now: float) -> bool:
        """Record a join; returns True if the worker was not there before."""
        mate = self._mates.get(join.wid)
        if mate is None:
            back, _ = self._gone.pop(join.wid, (WorkerInfo(join, now, now), now))
            self._mates[join.wid] = back
        known = self._mates[join.wid]
        known.join, known.heard = join, now
        return mate is None

    def said(self, wid: str, sign: Heartbeat, now: float) -> None:
        """Record a worker's heartbeat."""
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
        """Return a worker's name, for people."""
        return self._mates[wid].words if wid in self._mates else f"Worker {wid[:WID_DIGITS]}"

    def is_leaving(self, wid: str) -> bool:
        """True if a worker has said that it is about to leave."""
        return wid in self._mates and not self._mates[wid].join.credit

    def figures(self, members: Iterable[Worker], now: float) -> list[WorkerStatus]:
        """Return the figures of these members, in their order."""
        there = ((self._mates.get(member.wid), member) for member in members)
        return [mate.figures(member.state, len(member.batches), now) for mate, member in there if mate]

    def pages(self, members: Iterable[Worker], now: float) -> list[WorkersPage]:
        """Return all shown workers in pages, at least one; those that are gone come last."""
        shown = [*self.figures(members, now), *self._gone_ones(now)]
        firsts = range(0, max(1, len(shown)), WORKERS_PER_PAGE)
        return [
            WorkersPage(page=page, pages=len(firsts), workers=shown[first : first + WORKERS_PER_PAGE])
            for page, first in enumerate(firsts)
        ]

    def _gone_ones(self, now: float) -> Iterator[WorkerStatus]:
        self._gone = {wid: one for wid, one in self._gone.items() if now - one[1] < GONE_SECONDS}
        for mate, _ in self._gone.values():
            yield mate.figures("gone", 0, now)


log = structlog.get_logger()

PutMessage = Callable[[str, Message, Channel], None]
"""Sends a message on a key; what is sent while there is no link is lost."""


class WorkerAdmission:
    """The workers, all of one platform.

    Parameters
    ----------
    epoch
        The coordinator's.
    dispatch
        Holds their leases.
    put
        Sends messages.
    chronicle
        Log of what happens to them.
    """

    def __init__(
        self, epoch: int, keys: Keys, dispatch: Dispatcher, put: PutMessage, chronicle: EventLog
    ) -> None:
        self.platform: dict[str, str] = {}
        """Platform of the job's rows; empty until a worker joins or a recorded run opens."""
        self.alive: set[str] = set()
        """Those whose tokens are present."""
        self._epoch = epoch
        self._keys = keys
        self._dispatch = dispatch
        self._put = put
        self._chronicle = chronicle
        self._team = WorkerActivity()

    # They come and go.

    def join(self, join: Join, answer: "Future[bytes]", now: float) -> None:
        """Answer a worker that asks to join."""
        try:
            self._admit(join)
        except Refused as refusal:
            words = f"A worker on {join.host} was refused: {refusal}."
            self._chronicle.note("worker", words, worker=join.wid)
            answer.set_exception(refusal)
            return
        drop = self._dispatch.join(join.wid, join.number, join.credit, join.held, now)
        if join.wid not in self.alive:
            self._dispatch.expect(join.wid, now)
        if self._team.joined(join, now):
            self._chronicle.note("worker", f"{self._team.words(join.wid)} joined.", worker=join.wid)
        if self._dispatch.is_drained(join.wid):
            self._send_away(join.wid)
        log.info("worker joined", worker=join.wid[:8], host=join.host, pid=join.pid)
        answer.set_result(messages.encode(Joined(epoch=self._epoch, drop=drop)))

    def _admit(self, join: Join) -> None:
        """Check a worker's protocol version and platform."""
        if VERSION not in join.versions:
            spoken = f"it speaks versions {join.versions} of the protocol"
            raise Refused(f"{spoken}, this job speaks {VERSION}")
        self.platform = admit_platform(self.platform, join.platform)

    def token_changed(self, wid: str, alive: bool, now: float) -> None:
        """Record that a worker's token appeared or vanished."""
        if alive:
            self.alive.add(wid)
            self._dispatch.back(wid, now)
        else:
            self.alive.discard(wid)
            self._dispatch.gone(wid, now)

    def lost(self, lost: LostWorker, now: float) -> None:
        """Log that a worker was given up: it left, vanished or is stuck."""
        log.info("gave a worker up", worker=lost.wid[:8], reason=lost.reason, requeued=lost.batches)
        end = "is stuck" if lost.is_there else "is gone"
        how = "has left" if self._team.is_leaving(lost.wid) else f"{end}: {lost.reason}"
        again = f"; {lost.batches} of its batches are queued again" if lost.batches else ""
        words = f"{self._team.words(lost.wid)} {how}{again}."
        self._chronicle.note("worker", words, worker=lost.wid)
        if not lost.is_there:
            self._team.lost(lost.wid, now)

    # They work.

    def said(self, wid: str, sign: Heartbeat, now: float) -> None:
        """Record a worker's heartbeat; it renews leases only if the simulator progresses."""
        self._team.said(wid, sign, now)
        if sign.progressed:
            self._dispatch.seen(wid, now)

    def settled(self, wid: str, rows: int, now: float) -> None:
        """Note that a worker has settled rows."""
        self._team.settled(wid, rows, now)

    # They are told what to leave, and shown.

    def drain(self, wid: str) -> None:
        """Have a worker finish what it holds, and leave."""
        self._dispatch.drain(wid)
        self._send_away(wid)

    def drop(self, wid: str, batches: list[bytes]) -> None:
        """Take batches back from a worker."""
        self._put(self._keys.ctl(wid), Control(epoch=self._epoch, drop=batches), Channel.CONTROL)

    def _send_away(self, wid: str) -> None:
        self._put(self._keys.ctl(wid), Control(epoch=self._epoch, drain=True), Channel.CONTROL)

    def figures(self, now: float) -> list[WorkerStatus]:
        """Return the known workers, in the order in which they joined."""
        return self._team.figures(self._dispatch.members, now)

    def pages(self, now: float) -> list[WorkersPage]:
        """Return all workers in pages, also those that have just gone."""
        return self._team.pages(self._dispatch.members, now)
