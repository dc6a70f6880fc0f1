"""The batches at the simulator, and what is known of their rows when it speaks, or ends.

Pure: no process, no clock. Time is passed in, in seconds of any steady clock.
"""

from collections import deque
from dataclasses import dataclass, field

from qdgrasp_protocol.messages import Failure, Result, Work, shorten
from qdgrasp_worker.runtime.simulator_messages import (
    AnySimulatorMessage,
    BatchRejected,
    EvaluateRows,
    PartialResult,
    SceneLoaded,
    SceneMissing,
)


@dataclass(eq=False)
class BatchProgress:
    """A batch of a job that the simulator works on, or is to."""

    job: str
    work: Work
    is_careful: bool = False
    """Its rows are evaluated one by one: a simulator ended while it was at it."""
    is_loading: bool = False
    """Its scene went along, and does not stand yet."""
    done: int = 0
    """How many of its rows are known."""
    since: float = 0.0
    """When the simulator came to it."""
    cpu_seconds: float = 0.0
    _parts: list[PartialResult] = field(default_factory=list)
    _failures: list[Failure] = field(default_factory=list)

    @property
    def is_done(self) -> bool:
        """All rows are known."""
        return self.done >= self.work.n

    def seconds_left(self, now: float) -> float:
        """How long the rest takes if it goes on like this; while no row is known, as long as until now."""
        passed = now - self.since
        return passed / self.done * (self.work.n - self.done) if self.done else passed

    def request(self, bundle: bytes | None) -> EvaluateRows:
        """What the simulator is asked: to evaluate the rows that are not known yet."""
        work = self.work
        self.is_loading = bundle is not None
        columns = {name: blob[self.done * (len(blob) // work.n) :] for name, blob in work.columns.items()}
        return EvaluateRows(
            scene=work.scene,
            bundle=bundle,
            prior=work.prior,
            n=work.n - self.done,
            genes=work.genes,
            columns=columns,
            is_careful=self.is_careful,
        )

    def add(self, part: PartialResult) -> None:
        """Take what the next rows gave."""
        self._failures += [
            Failure(row=self.done + failed.row, reason=failed.reason) for failed in part.failures
        ]
        self._parts.append(part)
        self.done += part.n
        self.cpu_seconds += part.cpu_seconds

    def stumble(self, reason: str) -> None:
        """Hear that the simulator ended while it was at this.

        While it loads the scene that speaks against all rows. While it goes row by row it speaks against the
        first that is not known; else nobody knows which one it was, and they are tried one by one.
        """
        if self.is_loading:
            self.fail(f"{reason} while it loaded the scene")
        elif self.is_careful or self.done == self.work.n - 1:
            self.add(PartialResult(n=1, failures=[Failure(row=0, reason=shorten(reason))]))
        self.is_careful = True

    def fail(self, reason: str) -> None:
        """Note that no row can be evaluated, for one reason."""
        n = self.work.n
        self._parts, self.done = [], n
        self._failures = [Failure(row=row, reason=shorten(reason)) for row in range(n)]

    def result(self, wid: str) -> Result:
        """The answer to the batch, by a worker."""
        work = self.work
        shape = next((part for part in self._parts if part.columns), PartialResult(n=1))
        return Result(
            epoch=work.epoch,
            run=work.run,
            generation=work.generation,
            batch=work.batch,
            attempt=work.attempt,
            wid=wid,
            n=work.n,
            joints=shape.joints,
            descriptors=shape.descriptors,
            columns={name: self._column(name, len(blob) // shape.n) for name, blob in shape.columns.items()},
            cpu_seconds=self.cpu_seconds,
            failures=self._failures,
        )

    def _column(self, name: str, width: int) -> bytes:
        """One column of all rows, `width` bytes each; a row that ended its simulator holds zeros."""
        return b"".join(part.columns.get(name, bytes(width * part.n)) for part in self._parts)


MAX_IN_FLIGHT = 2
"""Batches at the simulator: the one that it works on, and one that waits, so that it is never idle."""


class InFlightBatches:
    """Batches in the order in which the simulator has them."""

    def __init__(self) -> None:
        self._there: deque[BatchProgress] = deque()
        self._again: deque[BatchProgress] = deque()

    @property
    def head(self) -> BatchProgress | None:
        """What the simulator works on; None: nothing."""
        return self._there[0] if self._there else None

    @property
    def has_room(self) -> bool:
        """Another batch may go to the simulator."""
        return len(self._there) < MAX_IN_FLIGHT

    @property
    def tasks(self) -> list[BatchProgress]:
        """All batches, those first that are to be sent again."""
        return [*self._again, *self._there]

    @property
    def next_again(self) -> BatchProgress | None:
        """The batch that is to be sent again before any other; None: there is none."""
        return self._again[0] if self._again else None

    def send(self, task: BatchProgress, now: float) -> None:
        """Note that a batch goes to the simulator, for the first time or again."""
        if task is self.next_again:
            self._again.popleft()
        task.since = now
        self._there.append(task)

    def drop(self, task: BatchProgress) -> None:
        """Forget a batch that was to be sent again."""
        self._again.remove(task)

    def hear(self, frame: AnySimulatorMessage, now: float) -> BatchProgress | None:
        """Take what the simulator says of the batch that it works on; gives it when it is done."""
        task = self.head
        if task is None:
            return None
        match frame:
            case SceneLoaded():
                task.is_loading = False
            case PartialResult():
                task.add(frame)
            case BatchRejected(reason=reason):
                task.fail(reason)
            case SceneMissing():
                self._again.append(self._there.popleft())
        if not task.is_done:
            return None
        self._there.popleft()
        if self.head is not None:
            self.head.since = now
        return task

    def stumble(self, reason: str) -> BatchProgress | None:
        """Hear that the simulator ended of what it was at; gives that batch if it is done with.

        The others go to the next simulator, as does the rest of that one.
        """
        task = self.head
        if task is None:
            return None
        task.stumble(reason)
        if task.is_done:
            self._there.popleft()
        self.again()
        return task if task.is_done else None

    def again(self) -> None:
        """Have all batches that are there go to the next simulator."""
        self._again.extendleft(reversed(self._there))
        self._there.clear()

    def lose(self) -> list[BatchProgress]:
        """Hear that the simulator was killed from outside; gives the batches that were there."""
        lost = list(self._there)
        self._there.clear()
        return lost
