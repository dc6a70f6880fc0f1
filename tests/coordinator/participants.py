"""Who takes part in a simulated history: workers, a recorder, and the coordinator in miniature.

The pure state machines of the coordinator run here unchanged; the glue is the same few lines that the service
has.
"""

from collections import Counter
from dataclasses import dataclass, field
from math import inf
from typing import TYPE_CHECKING

import numpy as np

from qdgrasp_coordinator.batch import Settlement
from qdgrasp_coordinator.dispatch import Dispatch
from qdgrasp_coordinator.outbox import Outbox
from qdgrasp_coordinator.service import MAX_PATIENCE
from qdgrasp_coordinator.stretch import Stretch
from qdgrasp_protocol.errors import RecorderFellBack
from qdgrasp_protocol.messages import Failure, Result, Work
from qdgrasp_protocol.outcome import Outcome
from qdgrasp_protocol.rows import RESULT, Rows, pack, unpack

if TYPE_CHECKING:
    from tests.coordinator.simulated import World


@dataclass
class Worker:
    """A worker process: joins, evaluates one batch after the other, answers."""

    world: "World"
    wid: str
    number: int = 0
    work: dict[bytes, Work] = field(default_factory=dict)
    is_alive: bool = True
    is_zombie: bool = False
    is_linked: bool = True
    joined: bool = False
    busy: bool = False

    def join(self) -> None:
        """Ask to join until an answer comes."""
        self.number += 1
        self.joined = False
        number, held = self.number, list(self.work)
        self.world.send(self, lambda: self.world.hear_join(self, number, held))
        self.world.later(1.0 + self.world.chance.random(), lambda: self._join_again(number))

    def _join_again(self, number: int) -> None:
        if self.is_alive and not self.joined and number == self.number:
            self.join()

    def hear_joined(self, number: int, drop: list[bytes]) -> None:
        if self.is_alive and number == self.number:
            self.joined = True
            for batch_id in drop:
                self.work.pop(batch_id, None)

    def hear_work(self, work: Work) -> None:
        if self.is_alive and not self.is_zombie and work.join >= self.number:
            self.work[work.batch] = work
            self._begin()

    def _begin(self) -> None:
        if self.is_alive and not self.is_zombie and not self.busy and self.work:
            self.busy = True
            work = next(iter(self.work.values()))
            seconds = work.n * self.world.plan.row_seconds * self.world.chance.uniform(0.5, 2)
            self.world.later(seconds, lambda: self._finish(work))

    def _finish(self, work: Work) -> None:
        self.busy = False
        if not self.is_alive or self.is_zombie:
            return
        if self.work.pop(work.batch, None) is not None:
            result = self._result(work)
            self.world.send(self, lambda: self.world.hear_result(self.wid, result))
        self._begin()

    def _result(self, work: Work) -> Result:
        task = self.world.plan.task
        rows = task.shape.empty(work.n)
        rows["genome"] = np.frombuffer(work.columns["genome"], "<f4").reshape(work.n, work.genes)
        rows["trial"] = np.frombuffer(work.columns["trial"], "<u2")
        found = task.evaluate(rows)
        failures = []
        for place, row in enumerate(found):
            if row["outcome"] == Outcome.ERROR or self.world.hiccup(
                row["genome"].tobytes() + row["trial"].tobytes()
            ):
                found[place] = np.zeros((), task.shape.dtype)
                failures.append(Failure(row=place, reason="the child aborted"))
        self.world.evaluated[work.batch] += 1
        return Result(
            epoch=work.epoch,
            run=work.run,
            generation=work.generation,
            batch=work.batch,
            attempt=work.attempt,
            wid=self.wid,
            n=work.n,
            joints=task.shape.joints,
            descriptors=task.shape.descriptors,
            columns=pack(found, RESULT),
            cpu_seconds=work.n * self.world.plan.row_seconds,
            failures=failures,
        )


@dataclass
class Recorder:
    """A recorder: appends what follows, commits after a while, reports what is durable."""

    world: "World"
    journal: Rows
    durable: int = 0
    is_alive: bool = True

    def hear(self, epoch: int, stretch: Stretch) -> None:
        if not self.is_alive or epoch != self.world.epoch:
            return
        if stretch.first <= len(self.journal) < stretch.stop:
            new = stretch.part(len(self.journal), stretch.stop)
            self.journal = np.concatenate([self.journal, new.rows])
            self.world.later(self.world.chance.uniform(0, 0.3), self.commit)
        else:
            self.report()

    def commit(self) -> None:
        if self.is_alive:
            self.durable = len(self.journal)
            self.report()

    def report(self) -> None:
        epoch, durable = self.world.epoch, self.durable
        self.world.send(None, lambda: self.world.hear_recorded(epoch, durable))

    def repeat(self) -> None:
        """Report at 1 Hz."""
        if self.is_alive and not self.world.is_over:
            self.report()
        self.world.later(1.0, self.repeat)

    def restart(self, durable: int) -> None:
        """Die with all that is not committed, and come back with so many rows."""
        self.is_alive = False
        self.durable = durable
        self.journal = self.journal[:durable]
        self.world.later(self.world.chance.uniform(0.1, 4), self._come_up)

    def _come_up(self) -> None:
        self.is_alive = True
        self.world.later(self.world.wait(), lambda: self.world.coordinator.recorder_up())


class Coordinator:
    """The service in miniature: carries out what pipeline, dispatch and outbox decide."""

    def __init__(self, world: "World", epoch: int, recorded: Rows) -> None:
        plan = world.plan
        self.world = world
        self.epoch = epoch
        self.is_alive = True
        self.pipeline = plan.pipeline()
        self.dispatch = Dispatch(epoch, batch_size=plan.batch_size)
        step = world.chance.randint(1, 7)
        for first in range(0, len(recorded), step):
            self.pipeline.replay(recorded[first : first + step])
        self.outbox = Outbox(len(recorded))
        self.fresh: Counter[bytes] = Counter()
        self.wake_at = float("inf")

    @property
    def is_done(self) -> bool:
        return self.is_alive and self.pipeline.finished is not None and self.outbox.is_empty

    def step(self) -> None:
        """Do everything that is possible now, and wake up when there may be more."""
        world = self.world
        if not self.is_alive:
            return
        now = world.now
        self.dispatch.tick(now)
        while not self.outbox.is_full and (rows := self.pipeline.ask()):
            self.dispatch.submit("run", "0" * 64, "p", rows.number, rows.indices, rows.trials, rows.genomes)
        if self.pipeline.finished:
            self.dispatch.withdraw("run")
        for lease in self.dispatch.leases(now):
            work, worker = lease.work(self.epoch), world.workers[lease.wid]
            world.send(worker, lambda worker=worker, work=work: worker.hear_work(work))
        for stretch in self.outbox.due(now):
            world.send(None, lambda stretch=stretch: world.recorder.hear(self.epoch, stretch))
        deadline = min(self.dispatch.next_deadline(), now + MAX_PATIENCE if self.outbox.unconfirmed else inf)
        if now < deadline < self.wake_at or self.wake_at <= now < deadline < float("inf"):
            self.wake_at = deadline
            world.later(deadline - now, self.step)

    def hear_join(self, worker: Worker, number: int, held: list[bytes]) -> None:
        drop = self.dispatch.join(worker.wid, number, self.world.plan.credit, held, self.world.now)
        self.world.send(worker, lambda: worker.hear_joined(number, drop))
        self.step()

    def hear_result(self, wid: str, result: Result) -> None:
        shape = self.world.plan.task.shape
        rows = unpack(shape.empty(result.n), RESULT, result.columns, shape)
        settled = self.dispatch.settle(wid, result, rows, self.world.now)
        if settled.superseded is not None:
            worker, batch = self.world.workers[settled.superseded], result.batch
            self.world.send(worker, lambda: worker.work.pop(batch, None))
        if settled.kind is Settlement.FRESH:
            self.fresh[result.batch] += 1
            assert settled.rows is not None
            final = self.pipeline.settle(settled.rows, settled.cpu_seconds, settled.failures)
            for failure in final.failures:
                assert failure.reason == "the child aborted"
                assert final.rows[failure.row]["outcome"] == Outcome.ERROR
            self.outbox.push(final)
        self.step()

    def hear_recorded(self, durable: int) -> None:
        try:
            self.outbox.durable(durable, self.world.now)
        except RecorderFellBack:
            self.world.crash()
        self.step()

    def hear_token(self, wid: str, alive: bool) -> None:
        change = self.dispatch.back if alive else self.dispatch.gone
        change(wid, self.world.now)
        self.step()

    def recorder_up(self) -> None:
        if self.is_alive:
            self.outbox.recorder_up(self.world.now)
            self.step()

    def check(self) -> None:
        """What holds at the end of every life."""
        assert all(times == 1 for times in self.fresh.values())
