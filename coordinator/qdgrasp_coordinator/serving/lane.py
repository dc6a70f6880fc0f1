"""A lane: one run that the coordinator carries out now, with its record."""

import time
from collections.abc import Callable

import msgspec

from qdgrasp_coordinator.counts.curve import Curve
from qdgrasp_coordinator.counts.entry import RunEntry
from qdgrasp_coordinator.counts.figures import Figures
from qdgrasp_coordinator.counts.tally import Tally
from qdgrasp_coordinator.runs.assignment import Assignment
from qdgrasp_coordinator.serving.record import Record
from qdgrasp_protocol.errors import EndedEarly
from qdgrasp_protocol.messages import Opened
from qdgrasp_protocol.spec import from_toml


class Lane:
    """A run from its opening at the recorder to its last durable row."""

    def __init__(self, assignment: Assignment, record: Record) -> None:
        self.assignment = assignment
        self.pipeline = assignment.pipeline
        self.record = record
        self.replayed = 0
        """Counted evaluations that were in the journal when the run was opened."""
        self._spec = from_toml(assignment.spec.decode(), f"the spec of run '{assignment.run}'")
        self._began = time.monotonic()

    def open(self, epoch: int, wait: Callable[[], None]) -> Opened:
        """Open the run and bring its search to where its journal ends: asks and tells, checked bit for bit.

        Parameters
        ----------
        epoch
            The coordinator's turn; 0: one begins.
        wait
            Called between two questions; it may raise to end them.

        Raises
        ------
        InputError
            The recorder refuses the run, or its journal is not what its spec replays to.
        """
        opened = self.record.open(self.assignment.opening, epoch, wait)
        position, durable = 0, opened.durable[0]
        while position < durable:
            stretch = self.record.recorded(position, wait)
            if not len(stretch):
                raise EndedEarly(f"The recorder has {durable} rows but shows none from {position} on.")
            self.pipeline.replay(stretch.rows)
            position = stretch.stop
            self.replayed = self.tally.evaluations
        return opened

    @property
    def run(self) -> str:
        """The run's name."""
        return self.assignment.run

    @property
    def tally(self) -> Tally:
        """What its journal's rows add up to."""
        return self.pipeline.tally

    @property
    def curve(self) -> Curve:
        """How its counts grew."""
        return self.pipeline.trail.curve(self.run)

    @property
    def waiting(self) -> int:
        """Settled rows that are not known to be on disk."""
        return max(0, self.tally.rows - self.record.durable)

    @property
    def is_done(self) -> bool:
        """Whether the run is finished and everything of it is on the disk."""
        return self.pipeline.finished is not None and self.record.is_empty

    def figures(self, workers: int, now: float) -> Figures:
        """How far the run is; `workers` are those of the job."""
        seconds = now - self._began
        entry = RunEntry.of(self.run, self._spec, self.assignment.bundle.digest, self.tally)
        counts = msgspec.structs.asdict(entry) | {"finished": self.pipeline.finished or ""}
        return Figures(
            **counts,
            workers=workers,
            durable=self.record.durable,
            seconds=seconds,
            rate=(entry.evaluations - self.replayed) / seconds if seconds > 0 else 0.0,
            trouble=self.record.trouble,
        )
