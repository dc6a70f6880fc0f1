"""A task: a batch at the simulator, with what is known of its rows so far. Pure: no process, no clock.

Time is passed in, in seconds of any steady clock.
"""

from dataclasses import dataclass, field

from qdgrasp_protocol.messages import Failure, Result, Work, short
from qdgrasp_worker.serving.frames import Evaluate, Part


@dataclass(eq=False)
class Task:
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
    _parts: list[Part] = field(default_factory=list)
    _failures: list[Failure] = field(default_factory=list)

    @property
    def is_done(self) -> bool:
        """All rows are known."""
        return self.done >= self.work.n

    def seconds_left(self, now: float) -> float:
        """How long the rest takes if it goes on like this; while no row is known, as long as until now."""
        passed = now - self.since
        return passed / self.done * (self.work.n - self.done) if self.done else passed

    def request(self, bundle: bytes | None) -> Evaluate:
        """What the simulator is asked: to evaluate the rows that are not known yet."""
        work = self.work
        self.is_loading = bundle is not None
        columns = {name: blob[self.done * (len(blob) // work.n) :] for name, blob in work.columns.items()}
        return Evaluate(
            scene=work.scene,
            bundle=bundle,
            prior=work.prior,
            n=work.n - self.done,
            genes=work.genes,
            columns=columns,
            is_careful=self.is_careful,
        )

    def add(self, part: Part) -> None:
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
            self.add(Part(n=1, failures=[Failure(row=0, reason=short(reason))]))
        self.is_careful = True

    def fail(self, reason: str) -> None:
        """Note that no row can be evaluated, for one reason."""
        n = self.work.n
        self._parts, self.done = [], n
        self._failures = [Failure(row=row, reason=short(reason)) for row in range(n)]

    def result(self, wid: str) -> Result:
        """The answer to the batch, by a worker."""
        work = self.work
        shape = next((part for part in self._parts if part.columns), Part(n=1))
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
