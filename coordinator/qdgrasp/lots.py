"""Lots: genomes that a program asks for together, as runs of a job that lasts until it is closed."""

from concurrent.futures import Future
from queue import SimpleQueue

from qdgrasp_coordinator.campaigns.programme import Extent
from qdgrasp_coordinator.runs.assignment import Assignment
from qdgrasp_coordinator.serving.record import Memory
from qdgrasp_protocol.rows import Rows


class Lot:
    """Genomes that were asked for together, and what becomes of them."""

    def __init__(self, assignment: Assignment) -> None:
        self.assignment = assignment
        self.memory = Memory(assignment.shape)
        self.rows: Future[Rows] = Future()
        """Rows as in a journal, trials too."""

    def look(self) -> None:
        """See whether all of them are there."""
        if self.assignment.pipeline.finished is not None and not self.rows.done():
            self.rows.set_result(self.memory.rows)

    def fail(self, why: BaseException) -> None:
        """Tell whoever waits that there will be no rows."""
        if not self.rows.done():
            self.rows.set_exception(why)


class Lots:
    """A programme whose runs are made as somebody asks for them, until it is closed."""

    def __init__(self) -> None:
        self.extent = Extent.of({})
        self._waiting: SimpleQueue[Assignment | None] = SimpleQueue()

    def put(self, assignment: Assignment) -> None:
        """Have it carried out."""
        self._waiting.put(assignment)

    def close(self) -> None:
        """Ask for no more."""
        self._waiting.put(None)

    def next(self) -> Assignment | None:
        """The next one, waited for; None when there will be none."""
        return self._waiting.get()

    def put_back(self, run: str) -> None:
        """What is kept in memory loses nothing."""
