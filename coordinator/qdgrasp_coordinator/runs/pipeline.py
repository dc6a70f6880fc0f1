"""The pipeline of one run: in which order its search is asked and told, and when its budget is spent.

Results arrive in any order; the search hears them generation by generation, and the journal is that order:
by generation, within it nominal rows by index, then the trials of successes by (index, trial). Pure state:
whatever came in between, the rows that become final, and what the search is asked, are a function of the spec
(docs/reproducibility.md).
"""

from collections import deque
from collections.abc import Iterator, Sequence

import numpy as np

from qdgrasp_coordinator.counts.curve import Trail
from qdgrasp_coordinator.counts.goals import Goals
from qdgrasp_coordinator.counts.stretch import Stretch
from qdgrasp_coordinator.counts.tally import BUDGET_ALONE, Tally
from qdgrasp_coordinator.counts.whole import joined, taken
from qdgrasp_coordinator.runs.generation import Generation, Slot
from qdgrasp_coordinator.searches.search import Search
from qdgrasp_protocol.errors import ReplayError
from qdgrasp_protocol.messages import Failure
from qdgrasp_protocol.outcome import Outcome
from qdgrasp_protocol.rows import Rows, Shape
from qdgrasp_protocol.spec import Overlaps


class Pipeline:
    """Orders the asks and tells of one search.

    Generation g is asked of the search at the moment when generation g - `generations_in_flight` has been
    told, neither earlier nor later, so that a slow coordinator asks the same genomes as a fast one; `ask`
    only hands out what is there.

    Parameters
    ----------
    search
        A search that nothing has been asked of.
    shape
        The shape of the run's rows.
    evaluations
        The budget: the run ends with the nominal row that reaches it in journal order, and the trials of
        its generation's rows up to that one. Later rows of that generation are not journalled, and that
        generation is not told.
    overlaps
        Whether overlaps count.
    trials
        How many trials each nominal success has; its fitness is then the sum over them.
    goals
        What ends the run before its budget is spent, in the same manner.
    """

    def __init__(
        self,
        search: Search,
        shape: Shape,
        evaluations: int,
        overlaps: Overlaps,
        generations_in_flight: int = 1,
        trials: int = 0,
        goals: Goals = BUDGET_ALONE,
    ) -> None:
        self.tally = Tally(evaluations, overlaps, trials, goals)
        self.trail = Trail()
        """How the tally grew."""
        self._search = search
        self._shape = shape
        self._overlaps = overlaps
        self._trials = trials
        self._open: deque[Slot] = deque()
        self._asked = 0
        self._cpu_seconds = 0.0
        self._reasons: dict[tuple[int, int, int], str] = {}
        for _ in range(generations_in_flight):
            self._prepare()

    @property
    def finished(self) -> str | None:
        """Why the run is over, in words; None while it is not."""
        return self.tally.finished or (None if self._open else "the search has nothing left to ask")

    def ask(self) -> Generation | None:
        """The next rows to evaluate; None when there are none now, or the run is finished."""
        for slot in self._open if self.finished is None else ():
            if (rows := slot.hand_out()) is not None:
                return rows
        return None

    def settle(self, rows: Rows, cpu_seconds: float = 0.0, failures: Sequence[Failure] = ()) -> Stretch:
        """Take evaluated rows, in any order, and give those that have just become final.

        Parameters
        ----------
        rows
            With keys, genomes and results; of any generations. Those that came before, that nobody asked
            for, or that come after the end, are ignored.
        cpu_seconds
            What they cost; given on with the next rows that become final.
        failures
            Why rows with `Outcome.ERROR` failed, by their place in `rows`.

        Returns
        -------
        stretch
            The next rows of the journal, perhaps none.
        """
        self._cpu_seconds += cpu_seconds
        self._reasons |= _by_key(rows, failures)
        if self.finished is None:
            self._place(rows)
        return self._advance()

    def replay(self, rows: Rows) -> None:
        """Take the next recorded rows of the journal as if they had just been evaluated.

        Raises
        ------
        ReplayError
            They are not the rows that this run asks: the journal is of another spec or another version.
        """
        while len(rows):
            if self.finished is not None:
                raise ReplayError(f"The journal goes on after its row {self.tally.rows}: {self.finished}.")
            before = self.tally.rows
            self._open[0].replay(rows)
            self._advance()
            rows = rows[self.tally.rows - before :]

    def _place(self, rows: Rows) -> None:
        """Put each row where its generation waits for it."""
        generations = rows["generation"]
        for slot in self._open:
            is_its = generations == slot.number
            if is_its.all():
                slot.place(rows)
            elif is_its.any():
                slot.place(taken(rows, is_its))

    def _advance(self) -> Stretch:
        """Make final what follows without a gap; tell and ask where a generation is complete."""
        first, errors = self.tally.rows, self.tally.errors
        pieces = list(self._finals())
        if not pieces:
            return Stretch(first, self._shape.empty(0))
        rows = joined(pieces)
        cpu_seconds, self._cpu_seconds = self._cpu_seconds, 0.0
        failures = self._failures(rows) if self.tally.errors > errors else ()
        return Stretch(first, rows, cpu_seconds, failures)

    def _finals(self) -> Iterator[Rows]:
        while self.finished is None and (rows := self._next_finals()) is not None:
            yield rows

    def _next_finals(self) -> Rows | None:
        """The rows of the oldest generation that have become final; None when it has to wait."""
        slot = self._open[0]
        if not slot.has_arrived:
            return None
        rows = slot.arrived()
        rows = rows[: self.tally.until_reached(rows)]
        slot.final += len(rows)
        self.tally.count(rows)
        if self.tally.is_reached:
            slot.cut()
        if slot.is_complete:
            self.tally.end_generation()
            self.trail.note(self.tally)
            self._close(slot)
        return rows

    def _close(self, slot: Slot) -> None:
        """Tell a complete generation, and ask the one that waited for it, unless the run is over."""
        if self.finished is None:
            self._search.tell(slot.number, slot.told)
            self._open.popleft()
            self._prepare()

    def _prepare(self) -> None:
        """Ask the search for the next generation, unless the open ones are sure to spend the budget."""
        needed = self.tally.left
        if self._overlaps == "count":
            needed -= sum(slot.missing for slot in self._open)
        if needed <= 0:
            return
        genomes = self._search.ask(self._asked)
        if len(genomes):
            limit = needed if self._overlaps == "count" else len(genomes)
            self._open.append(Slot(self._asked, genomes, self._shape, limit, self._trials))
            self._asked += 1

    def _failures(self, rows: Rows) -> tuple[Failure, ...]:
        """The reasons of the error rows among final ones."""
        return tuple(
            Failure(row=int(place), reason=self._reasons.pop(_key(rows[place]), ""))
            for place in np.flatnonzero(rows["outcome"] == Outcome.ERROR)
        )


def _key(row: np.void) -> tuple[int, int, int]:
    return int(row["generation"]), int(row["index"]), int(row["trial"])


def _by_key(rows: Rows, failures: Sequence[Failure]) -> dict[tuple[int, int, int], str]:
    """The reasons of failures by the rows' keys."""
    return {_key(rows[failure.row]): failure.reason for failure in failures}
