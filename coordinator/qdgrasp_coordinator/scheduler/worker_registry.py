"""The workers of a job: joins, tokens, the batches they hold, and their figures.

Rules 1, 3 and 4 of docs/bus.md: credit, join numbers, lost tokens and leases that pass. Time is passed in,
in seconds of any steady clock.
"""

import os
from collections import OrderedDict, deque
from collections.abc import Collection, Iterator
from dataclasses import dataclass, field
from math import ceil, inf

from qdgrasp_coordinator.metrics.job_status import WORKERS_PER_PAGE, WorkersPage, WorkerStatus
from qdgrasp_coordinator.metrics.time_left import WorkersAtWork
from qdgrasp_coordinator.storage.platforms import admit_platform
from qdgrasp_protocol.errors import Refused
from qdgrasp_protocol.messages import TRUST_VARIABLE, VERSION, Heartbeat, Join, worker_key
from qdgrasp_protocol.text import first_few

BUILD_SECONDS = 5400.0  # Time that a worker may take for a shape; its process has limits of its own
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
    batches: dict[bytes, bool] = field(default_factory=dict)
    """The ids of the batches it holds; True: a shape that it builds."""
    scenes: OrderedDict[str, None] = field(default_factory=OrderedDict)
    """The scenes it holds, the latest last."""
    gone_at: float | None = None
    """When its token vanished; None: it is there."""
    is_expected: bool = False
    """True: its token is not gone, but late."""
    is_stuck: bool = False
    """It let a lease pass; until it answers or joins again it gets no work, unless no worker is well."""
    is_proven: bool = False
    """It answered a batch first, and held none for long since; until then it holds one at most."""
    is_trusted: bool = False
    """Its owner has the job's secret: it checks the rows of others."""
    is_drained: bool = False
    """It is to leave: it gets no more work."""
    owes_since: float = 0.0
    """Since when it owes an answer: its last one, or when it was leased something while it held nothing."""
    rows: int = 0
    """Rows that it settled."""
    sign: Heartbeat = NO_SIGN
    """Its latest sign; before the first one, one that says nothing."""

    @property
    def wid(self) -> str:
        """Its id."""
        return self.join.wid

    @property
    def is_well(self) -> bool:
        """True if it is present, answers, and is not leaving."""
        return self.gone_at is None and not (self.is_stuck or self.is_drained)

    @property
    def is_building(self) -> bool:
        """True if it builds a shape: its core is taken for long."""
        return any(self.batches.values())

    @property
    def has_credit(self) -> bool:
        """True if it is present and may be leased more."""
        is_open = self.gone_at is None and not self.is_drained and not self.is_building
        return is_open and len(self.batches) < (
            self.join.credit if self.is_proven else min(1, self.join.credit)
        )

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

    @property
    def description(self) -> str:
        """Id, host and process, for people."""
        return f"Worker {self.wid[:WID_DIGITS]} on {self.join.host} (process {self.join.pid})"

    def deadline(self, timeout: "LeaseTimeout") -> float:
        """Return when it is given up if nothing is heard of it; infinite: never."""
        if self.gone_at is not None:
            return self.gone_at + TOKEN_GRACE
        return min(self.progress + timeout.limit, self.answer_by(timeout)) if self.batches else inf

    def answer_by(self, timeout: "LeaseTimeout") -> float:
        """Return when it is given up without an answer, whatever progress it shows."""
        return self.owes_since + (BUILD_SECONDS if self.is_building else timeout.answer)

    def status(self, now: float) -> WorkerStatus:
        """Return its figures."""
        seconds = now - self.since
        return WorkerStatus(
            wid=self.wid,
            host=self.join.host,
            pid=self.join.pid,
            state=self.state,
            batches=len(self.batches),
            rows=self.rows,
            rate=round(self.rows / seconds, 2) if seconds > 0 else 0.0,
            seconds=round(seconds, 2),
            seen=round(now - self.heard, 2),
            memory=self.sign.memory,
            restarts=self.sign.restarts,
        )


LEASE_SECONDS = 10.0  # The shortest time without a sign of progress after which a lease is over
STRAGGLER_SECONDS, STRAGGLER_TURNAROUNDS = 0.25, 3
"""Age of a lease after which an idle worker gets the batch too: so many seconds, or median turnarounds."""
FIRST_STRAGGLER_SECONDS = 2.0  # The same while no batch has been answered: scenes are made first
LEASE_TURNAROUNDS = 10  # A lease may take so many times the 95th percentile of turnarounds, if that is longer
FIRST_ANSWER_SECONDS, ANSWER_SECONDS, ANSWER_LIMITS = 600.0, 60.0, 6
"""Time that a worker which shows progress may go without an answer.

The first, while no batch has been answered; later so many seconds, or lease timeouts if that is longer.
"""
TURNAROUNDS_KEPT = 256


class LeaseTimeout:
    """Lease timeout: the longest wait for progress of a worker that holds leases."""

    def __init__(self) -> None:
        self._turnarounds: deque[float] = deque(maxlen=TURNAROUNDS_KEPT)
        self.limit = LEASE_SECONDS
        """max(10 s, 10 x the 95th percentile of turnarounds) (docs/bus.md, rule 4)."""
        self.answer = FIRST_ANSWER_SECONDS
        """Longest wait for an answer of a worker that shows progress [s]."""
        self.straggling = FIRST_STRAGGLER_SECONDS
        """Age [s] after which a lease is a straggler's: max(0.25 s, 3 x the median turnaround)."""

    def measure(self, seconds: float) -> None:
        """Record the time from lease to result of a batch [s]."""
        self._turnarounds.append(seconds)
        ordered = sorted(self._turnarounds)
        self.limit = max(LEASE_SECONDS, LEASE_TURNAROUNDS * ordered[ceil(0.95 * len(ordered)) - 1])
        self.answer = max(ANSWER_SECONDS, ANSWER_LIMITS * self.limit)
        self.straggling = max(STRAGGLER_SECONDS, STRAGGLER_TURNAROUNDS * ordered[len(ordered) // 2])


AWAY_SECONDS = 30.0  # Seconds for which a worker that was well is expected back
TOKEN_DELAY = 30.0  # Seconds by which a worker's token may come later than its request to join


@dataclass(frozen=True)
class LostWorker:
    """A worker that was given up."""

    worker: Worker
    reason: str
    batches: list[bytes]
    """Ids of the batches it held."""


LOOK_SECONDS = 0.05  # Between two looks for overdue workers
GONE_SECONDS = 60.0  # Seconds for which a worker that is gone is still shown


class WorkerRegistry:
    """The workers of a job, all of one platform.

    Which are well, and which have credit, is updated with every change: an event of one worker needs no pass
    over a thousand.
    """

    # A lease is over at the deadline of its holder. It is the earlier of two times: the last sign of progress
    # plus a multiple of what batches took lately, and the last answer plus a minute or more, for a worker
    # that shows progress and never answers. Both stand still while the coordinator's own link is down.

    def __init__(self) -> None:
        self.platform: dict[str, str] = {}
        """Platform of the job's rows; empty until a worker joins or a recorded run opens."""
        self.alive: set[str] = set()  # Those whose tokens are present
        self.lease_timeout = LeaseTimeout()
        self._workers: dict[str, Worker] = {}
        self._gone: dict[str, tuple[Worker, float]] = {}  # and when it was given up
        self._drained: set[str] = set()
        self._link_is_up = True
        self._joins = 0
        self._settled = 0  # Rows that all of them have settled
        self._well: set[str] = set()
        self.proven: set[str] = set()
        """Workers that are well and proven."""
        self._free: dict[str, Worker] = {}
        self._look_at = -inf  # When overdue workers are looked for next

    def __iter__(self) -> Iterator[Worker]:
        """Iterate over known workers by order of joining, also gone ones not yet given up."""
        return iter(self._workers.values())

    def __len__(self) -> int:
        """Number of workers present, progressing and not leaving."""
        return len(self._well)

    @property
    def at_work(self) -> WorkersAtWork:
        """Workers that build shapes, and those that hold rows."""
        busy = [worker for worker in self if worker.batches]
        signs = [worker.sign for worker in busy if not worker.is_building]
        return WorkersAtWork(len(busy) - len(signs), signs, self._settled)

    def get(self, wid: str) -> Worker | None:
        """Return a worker; None: unknown."""
        return self._workers.get(wid)

    def join(self, join: Join, now: float) -> list[bytes] | None:
        """Admit a worker, or admit it again; the first one sets the platform of the rows.

        Returns the ids of the batches that it held, which are taken from it; None: a join older than the
        latest changes nothing. A worker whose token is not there yet is waited for, at most `TOKEN_DELAY`
        seconds. Raises Refused if it speaks another version of the protocol, or is of another platform.
        """
        if VERSION not in join.versions:
            spoken = f"it speaks versions {join.versions} of the protocol"
            raise Refused(f"{spoken}, this job speaks {VERSION}")
        known = self._workers.get(join.wid)
        self.platform = admit_platform(self.platform, join.platform)
        worker = known or self._add(join, now)
        worker.heard = now
        batches = None
        if known is None or join.number > known.join.number:
            batches, worker.batches = list(worker.batches), {}
            worker.join, worker.progress, worker.is_stuck = join, now, False
            worker.gone_at, worker.is_expected = None, False
        if join.wid not in self.alive:
            _lose_token(worker, now + TOKEN_DELAY - TOKEN_GRACE)
            worker.is_expected = True
        self._update(worker)
        return batches

    def _add(self, join: Join, now: float) -> Worker:
        """Add a worker, with the figures of its former life if it was here lately."""
        self._joins += 1
        worker, _ = self._gone.pop(join.wid, (None, now))
        if worker is None:
            worker = Worker(join, self._joins, now, now, now)
            is_secret = TRUST_VARIABLE in os.environ
            worker.is_trusted = is_secret and join.key == worker_key(join.key[:16])
        worker.join, worker.order, worker.scenes = join, self._joins, OrderedDict()
        worker.is_drained = join.wid in self._drained
        self._workers[join.wid] = worker
        return worker

    def on_token(self, wid: str, alive: bool, now: float) -> None:
        """Record that a worker's token appeared or vanished."""
        (self.alive.add if alive else self.alive.discard)(wid)
        if (worker := self._workers.get(wid)) is None:
            return
        if alive:
            worker.gone_at, worker.is_expected = None, False
        else:
            _lose_token(worker, now)
        self._update(worker)

    def on_link(self, is_up: bool, now: float) -> None:
        """Record a change of the coordinator's own link; while it is down no deadline passes."""
        if is_up and not self._link_is_up:
            for worker in self:
                worker.progress = worker.owes_since = now
                worker.gone_at = None if worker.gone_at is None else now
        self._link_is_up = is_up

    def drain(self, wid: str) -> None:
        """Give a worker no more work, whenever it joins; what it holds still counts."""
        self._drained.add(wid)
        if (worker := self._workers.get(wid)) is not None:
            worker.is_drained = True
            self._update(worker)

    def hold(self, worker: Worker, batch_id: bytes, scene: str | None, now: float) -> None:
        """Record that a worker is leased a batch of a scene; None: a shape that it builds."""
        if not worker.batches:
            worker.progress = worker.owes_since = now
        worker.batches[batch_id] = scene is None
        if scene is not None:
            worker.scenes[scene] = None
            worker.scenes.move_to_end(scene)
            if len(worker.scenes) > SCENES_KEPT:
                worker.scenes.popitem(last=False)
        self._update(worker)

    def release(self, wid: str, batch_id: bytes) -> None:
        """Record that a worker holds a batch no more."""
        if (worker := self._workers.get(wid)) is not None:
            worker.batches.pop(batch_id, None)
            self._update(worker)

    def answered(self, wid: str, batch_id: bytes, now: float, *, is_first: bool = False) -> None:
        """Record that a worker has answered a batch, before any other or not, and holds it no more."""
        if (worker := self._workers.get(wid)) is not None:
            worker.owes_since, worker.is_stuck = now, False
            worker.is_proven |= is_first
        self.progressed(wid, now)
        self.release(wid, batch_id)

    def mark_late(self, wid: str) -> None:
        """Record that a worker has held a batch for long."""
        if (worker := self._workers.get(wid)) is not None and worker.is_proven:
            worker.is_proven = False
            self._update(worker)

    def progressed(self, wid: str, now: float) -> None:
        """Record that a worker makes progress, on any job."""
        if (worker := self._workers.get(wid)) is not None:
            worker.progress = now
            self._update(worker)

    def on_heartbeat(self, wid: str, heartbeat: Heartbeat, now: float) -> None:
        """Record a worker's heartbeat; it renews leases only if the simulator progresses."""
        if (worker := self._workers.get(wid)) is not None:
            worker.heard, worker.sign = now, heartbeat
        if heartbeat.progressed:
            self.progressed(wid, now)

    def on_settled(self, wid: str, rows: int, now: float) -> None:
        """Record that a worker has settled rows."""
        self._settled += rows
        if (worker := self.find(wid)) is not None:
            worker.heard = now
            worker.rows += rows

    def find(self, wid: str) -> Worker | None:
        """Return a worker that is here or has just gone; None: unknown."""
        return self._workers.get(wid) or self._gone.get(wid, (None,))[0]

    def expects_other(self, tried: Collection[str], now: float) -> bool:
        """Return whether a worker besides these is well, or was lately: it may be back soon."""
        if len(self._well) > len(self._well.intersection(tried)):
            return True
        lately = [*self, *(worker for worker, at in self._gone.values() if now < at + AWAY_SECONDS)]
        return any(
            worker.join.credit and not (worker.is_drained or worker.is_stuck or worker.wid in tried)
            for worker in lately
        )

    def idle(self) -> Iterator[Worker]:
        """Yield the worker to lease to next, while one has credit left and took what it was offered.

        Stuck ones only if no worker is well. Those with fewest batches come first, of these proven ones: a
        silent worker's batch is not given to the next silent one. Then comes the one that was quiet for
        longest, so that every stuck worker is tried.
        """
        workers = [worker for worker in self._free.values() if worker.is_well or not self._well]
        for held in range(max((worker.join.credit for worker in workers), default=0)):
            free = [worker for worker in workers if worker.has_credit and len(worker.batches) == held]
            yield from sorted(free, key=lambda worker: (not worker.is_proven, worker.progress, worker.order))

    @property
    def trouble(self) -> str:
        """The workers that are there, if all of them are stuck; else empty."""
        stuck = [] if self._well else [worker.description for worker in self if worker.state == "stuck"]
        return f"no worker answers: {first_few(stuck, 3)}" if stuck else ""

    def overdue(self, now: float) -> list[LostWorker]:
        """Give up overdue workers: take their batches, and forget those whose token vanished."""
        if not self._link_is_up or now < self._look_at:
            return []
        self._look_at = now + LOOK_SECONDS
        late = [worker for worker in self if now >= worker.deadline(self.lease_timeout)]
        return [self._give_up(worker, now) for worker in late]

    def _give_up(self, worker: Worker, now: float) -> LostWorker:
        is_silent = now >= worker.answer_by(self.lease_timeout)
        batches, worker.batches = list(worker.batches), {}
        if worker.gone_at is None:
            worker.is_stuck, worker.is_proven = True, False
            self._update(worker)
            seconds = now - worker.owes_since if is_silent else self.lease_timeout.limit
            reason = f"no {'answer' if is_silent else 'sign of progress'} for {seconds:.0f} seconds"
            return LostWorker(worker, reason, batches)
        del self._workers[worker.wid]
        for index in (self._well, self.proven):
            index.discard(worker.wid)
        self._free.pop(worker.wid, None)
        worker.is_expected = False
        self._gone[worker.wid] = (worker, now)
        return LostWorker(worker, "its token vanished", batches)

    def _update(self, worker: Worker) -> None:
        """Update the indexes after a worker has changed."""
        (self._well.add if worker.is_well else self._well.discard)(worker.wid)
        (self.proven.add if worker.is_well and worker.is_proven else self.proven.discard)(worker.wid)
        if worker.has_credit:
            self._free[worker.wid] = worker
        else:
            self._free.pop(worker.wid, None)

    def pages(self, now: float) -> list[WorkersPage]:
        """Return all workers in pages, at least one; those that have just gone come last."""
        self._gone = {wid: one for wid, one in self._gone.items() if now - one[1] < GONE_SECONDS}
        gone = [worker for worker, _ in self._gone.values()]
        shown = [worker.status(now) for worker in (*self, *gone)]
        firsts = range(0, max(1, len(shown)), WORKERS_PER_PAGE)
        return [
            WorkersPage(page=page, pages=len(firsts), workers=shown[first : first + WORKERS_PER_PAGE])
            for page, first in enumerate(firsts)
        ]


def _lose_token(worker: Worker, at: float) -> None:
    """Record that a worker's token vanished, unless it had before."""
    if worker.gone_at is None:
        worker.gone_at = at


def choose_workers(workers: list[Worker], worker: str, host: str, job: str) -> list[Worker]:
    """Return the workers meant: one by the beginning of its id, or all of a host."""
    found = [one for one in workers if (one.join.host == host if host else one.wid.startswith(worker))]
    if not found or not (host or (worker and len(found) == 1)):
        names = [f"{one.wid[:WID_DIGITS]} on {one.join.host}" for one in workers]
        there = first_few(names, 5) or "none has joined"
        whom = f"{len(found)} workers '{host or worker}'"
        raise Refused(f"job '{job}' has {whom}: name one or a host of {there}")
    return found
