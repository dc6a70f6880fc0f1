"""The backlog: rows of all runs that wait for a worker, and whose turn it is."""

import secrets
from collections import deque
from collections.abc import Collection
from dataclasses import dataclass, field

from qdgrasp_coordinator.dispatching.batch import Batch
from qdgrasp_coordinator.dispatching.pace import Pace

GUESS = 0.01
"""What a row is expected to cost before one of its run was measured [CPU s]."""
SLACK = 5.0
"""How many CPU seconds a run may be ahead of the others on workers that hold its scene."""


class Backlog:
    """Cuts rows into batches, and takes batches back that are to be leased again.

    Parameters
    ----------
    batch_size
        Rows in a batch; None: measured.
    """

    def __init__(self, batch_size: int | None) -> None:
        self._turn = secrets.token_bytes(8)
        self._batch_size = batch_size
        self._queues: dict[str, _Queue] = {}
        self._cut = 0
        self._served = 0.0

    def __bool__(self) -> bool:
        """Whether something waits."""
        return any(self._queues.values())

    @property
    def seconds(self) -> float:
        """What the waiting rows are expected to cost [CPU s]."""
        return sum(len(queue) * (queue.pace.seconds_per_row or GUESS) for queue in self._queues.values())

    def submit(self, chunk: Batch) -> None:
        """Take rows of one generation that were never leased."""
        queue = self._queues.setdefault(chunk.run, _Queue(Pace(self._batch_size)))
        if not queue:
            queue.served = max(queue.served, self._served)
        queue.chunks.append(chunk)

    def withdraw(self, run: str) -> None:
        """Forget a run."""
        self._queues.pop(run, None)

    def turn(self, scenes: Collection[str]) -> str | None:
        """The run that was served least; within the slack one whose scene is at hand. None: nothing waits.

        Parameters
        ----------
        scenes
            Those that the worker holds.
        """
        least = at_hand = None
        for run, queue in self._queues.items():
            if queue and (least is None or queue.served < least[0]):
                least = (queue.served, run)
            if queue and queue.scene in scenes and (at_hand is None or queue.served < at_hand[0]):
                at_hand = (queue.served, run)
        if least is None:
            return None
        return at_hand[1] if at_hand and at_hand[0] <= least[0] + SLACK else least[1]

    def take(self, run: str, workers: int) -> Batch:
        """The next batch of a run that has one: one that came back, or a new one.

        Parameters
        ----------
        workers
            Workers that share the runs.
        """
        queue = self._queues[run]
        batch = queue.take_back() or self._cut_batch(queue, workers)
        self._served = queue.served
        queue.served += len(batch) * (queue.pace.seconds_per_row or 0.0)
        return batch

    def put_back(self, batch: Batch) -> None:
        """Have a batch leased again, before anything new of its run."""
        self._queues[batch.run].back[batch.id] = batch

    def put_back_row(self, batch: Batch, place: int) -> None:
        """Have a row of a settled batch on which the simulator failed leased again, on its own."""
        self.put_back(batch.part(self._new_id(), slice(place, place + 1), batch.failed + 1))

    def remove(self, batch: Batch) -> None:
        """Forget a batch that was put back, if it still waits."""
        if batch.run in self._queues:
            self._queues[batch.run].back.pop(batch.id, None)

    def measure(self, batch: Batch, cpu_seconds: float) -> None:
        """Learn what a batch cost."""
        self._queues[batch.run].pace.measure(len(batch), cpu_seconds)

    def _cut_batch(self, queue: "_Queue", workers: int) -> Batch:
        """A new batch of the oldest generation."""
        chunk = queue.chunks.popleft()
        n = queue.pace.rows(len(chunk), workers, len(self._queues))
        if n < len(chunk):
            queue.chunks.appendleft(chunk.part(b"", slice(n, None)))
        return chunk.part(self._new_id(), slice(n))

    def _new_id(self) -> bytes:
        """An id that no other batch has, nor had in any turn: epochs come again where a disk was restored."""
        self._cut += 1
        return self._turn + self._cut.to_bytes(8)


@dataclass
class _Queue:
    """What waits of a run."""

    pace: Pace
    chunks: deque[Batch] = field(default_factory=deque)
    """Rows that were never leased, of a generation each, without an id."""
    back: dict[bytes, Batch] = field(default_factory=dict)
    """Batches that are to be leased again, by id."""
    served: float = 0.0
    """CPU seconds that were leased, made level with the others when the run comes back to the backlog."""

    def __len__(self) -> int:
        return sum(map(len, self.chunks)) + sum(map(len, self.back.values()))

    def __bool__(self) -> bool:
        return bool(self.chunks or self.back)

    @property
    def scene(self) -> str:
        return (next(iter(self.back.values())) if self.back else self.chunks[0]).scene

    def take_back(self) -> Batch | None:
        """The batch that came back first; None: there is none."""
        return self.back.pop(next(iter(self.back))) if self.back else None
