"""A coordinator as a worker sees it: it admits workers, leases batches and takes results."""

import hashlib
import threading
from collections import deque
from collections.abc import Callable
from contextlib import ExitStack
from typing import Self

import msgspec
from tests.common import PATIENCE
from tests.fakes.memory_bus import MemoryNetwork
from tests.fakes.messages import put

from qdgrasp_protocol import messages
from qdgrasp_protocol.bus import Channel, Query, Sample, answer_chunk
from qdgrasp_protocol.errors import Refused
from qdgrasp_protocol.keys import Keys
from qdgrasp_protocol.messages import Control, Heartbeat, Join, Joined, Result, Work


class LeasingCoordinator:
    """One job's coordinator on a local network; a context manager that closes it.

    It leases as many batches as the worker has credit for, and the next when a result comes.
    """

    def __init__(
        self, network: MemoryNetwork, job: str = "job", epoch: int = 1, scene: bytes = b"a scene"
    ) -> None:
        self.bus = network.session()
        self.job, self.epoch, self.scene = job, epoch, scene
        self.digest = hashlib.sha256(scene).hexdigest()
        self.joins: list[Join] = []
        self.results: list[Result] = []
        self.signs = 0  # So many told that the simulator does something
        self.sign: Heartbeat | None = None  # The latest
        self.fetched = 0
        self.workers: set[str] = set()
        self.refusal = ""
        self.drains = False  # The worker was asked to leave, and is so whenever it joins
        self._keys = Keys(job)
        self._queue: deque[Work] = deque()
        self._leased: dict[bytes, Work] = {}
        self._changed = threading.Condition(threading.RLock())
        self._stack = ExitStack()
        self.told: Callable[[Result], object] = lambda result: None

    def __enter__(self) -> Self:
        enter = self._stack.enter_context
        enter(self.bus)
        enter(self.bus.answer(self._keys.join, self._on_join))
        enter(self.bus.answer(self._keys.asset(), self._answer_chunk))
        enter(self.bus.subscribe(self._keys.result(), self._take))
        enter(self.bus.subscribe(self._keys.stat("worker/*"), self._on_heartbeat))
        enter(self.bus.watch(self._keys.worker_token(), self._on_token))
        enter(self.bus.token(self._keys.coordinator_token(self.epoch)))
        return self

    def __exit__(self, *_: object) -> None:
        self._stack.close()

    def give(self, *works: Work) -> None:
        """Have batches leased, now or when there is credit."""
        with self._changed:
            self._queue += [msgspec.structs.replace(work, scene=self.digest) for work in works]
            self._lease()

    def control(self, *drop: Work, drain: bool = False) -> None:
        """Take batches back, or ask the worker to leave."""
        for work in drop:
            self._leased.pop(work.batch, None)
        self.drains |= drain
        message = Control(epoch=self.epoch, drop=[work.batch for work in drop], drain=drain)
        put(self.bus, self._keys.ctl(self.joins[-1].wid), message, Channel.CONTROL)

    def wait(self, condition: Callable[[], object], what: str) -> None:
        """Wait until something holds that the worker makes true."""
        with self._changed:
            assert self._changed.wait_for(condition, PATIENCE), f"waited in vain for {what}"

    def answered(self) -> list[int]:
        """The first byte of each batch that was answered, in that order."""
        return [result.batch[0] for result in self.results]

    def _on_join(self, query: Query) -> bytes:
        if self.refusal:
            raise Refused(self.refusal)
        with self._changed:
            join = messages.decode(query.payload, Join)
            self.joins.append(join)
            given_up = [self._leased.pop(batch) for batch in list(self._leased) if batch not in join.held]
            self._queue.extendleft(reversed(given_up))
            self._changed.notify_all()
            # as on a real bus, these may arrive before the answer to the join does
            if self.drains:
                self.control(drain=True)
            self._lease()
        return messages.encode(Joined(epoch=self.epoch, drop=[]))

    def _answer_chunk(self, query: Query) -> bytes:
        with self._changed:
            self.fetched += 1
            self._changed.notify_all()
        return answer_chunk(query, self.scene, self.digest)

    def _take(self, sample: Sample) -> None:
        with self._changed:
            result = messages.decode(sample.payload, Result)
            self.results.append(result)
            self.told(result)
            self._leased.pop(result.batch, None)
            self._lease()
            self._changed.notify_all()

    def _lease(self) -> None:
        while not self.drains and self.joins and self._queue and len(self._leased) < self.joins[-1].credit:
            number = self.joins[-1].number
            work = msgspec.structs.replace(self._queue.popleft(), epoch=self.epoch, join=number)
            self._leased[work.batch] = work
            put(self.bus, self._keys.work(self.joins[-1].wid), work)

    def _on_heartbeat(self, sample: Sample) -> None:
        with self._changed:
            self.sign = msgspec.json.decode(sample.payload, type=Heartbeat)
            self.signs += self.sign.progressed
            self._changed.notify_all()

    def _on_token(self, key: str, alive: bool) -> None:
        with self._changed:
            (self.workers.add if alive else self.workers.discard)(key.rsplit("/", 1)[-1])
            self._changed.notify_all()
