"""The pipeline of one run: orders asks and tells, and ends the run with its budget.

Results arrive in any order; the search is told generation by generation, and the journal is that order:
by generation, within it nominal rows by index, then the trials of successes by (index, trial). Pure state: in
any order of arrival, the rows that become final and the genomes that are asked are a function of the spec
(docs/reproducibility.md).
"""

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from qdgrasp_coordinator.metrics.arrays import join_rows, row_bytes, take_rows
from qdgrasp_coordinator.metrics.run_stats import RunCounter
from qdgrasp_coordinator.search.base import SearchAlgorithm
from qdgrasp_coordinator.storage.journal import JournalSlice
from qdgrasp_protocol.errors import ReplayError
from qdgrasp_protocol.messages import Failure
from qdgrasp_protocol.rows import Genomes, Outcome, Rows, RowShape
from qdgrasp_protocol.spec import RunSpec

MOST_FINAL = 4096  # The most rows that become final at once
Places = NDArray[np.int64]  # (n,): indices, or trials, of rows
RowKey = tuple[int, int, int]  # Generation, index and trial


@dataclass(frozen=True)
class Generation:
    """Rows of one generation that are to be evaluated."""

    number: int
    indices: NDArray[np.uint32]
    """(n,): places in the generation."""
    trials: NDArray[np.uint16]
    """(n,): 0 is nominal, 1 and up are randomised."""
    genomes: Genomes
    """(n, d): their genomes."""

    def __len__(self) -> int:
        return len(self.indices)

    def __getitem__(self, places: slice) -> "Generation":
        return Generation(self.number, self.indices[places], self.trials[places], self.genomes[places])


class GenerationBuffer:
    """One generation that is asked and not yet told.

    The journal has its nominal rows by index, then `trials` of each success by (index, trial). At most
    `limit` nominal rows are needed.
    """

    final: int = 0
    """Number of its final rows, in journal order."""

    def __init__(self, number: int, genomes: Genomes, shape: RowShape, limit: int, trials: int = 0) -> None:
        self.number = number
        self._trials = trials
        self._nominal = min(limit, len(genomes))  # Nominal rows that the journal is to hold
        self._rows = shape.empty(len(genomes) * (1 + trials)).reshape(len(genomes), 1 + trials)
        """By index and trial; rows that are never written cost no memory."""
        self._bytes = row_bytes(self._rows)
        self._rows["generation"][:, 0] = number
        self._rows["index"][:, 0] = np.arange(len(genomes))
        self._rows["genome"][:, 0] = genomes
        self._is_present = np.zeros((self._nominal, 1 + trials), dtype=bool)
        self._is_success = np.zeros(self._nominal, dtype=bool)
        self._handed_out = False
        self._opened = 0
        """Nominal rows, from index 0 on, whose trials were handed out where they are successes."""

    @property
    def rows_for_tell(self) -> Rows:
        """Nominal rows as told to the search.

        For a success `fitness` is the sum over its trials, and `trial` their number.
        """
        rows = take_rows(self._rows, np.s_[:, 0])
        if self._trials:
            found = self._successes
            rows["fitness"][found] = self._rows["fitness"][found, 1:].sum(axis=1)
            rows["trial"][found] = self._trials
        return rows

    @property
    def missing(self) -> int:
        """Number of nominal rows not final yet."""
        return max(0, self._nominal - self.final)

    @property
    def is_complete(self) -> bool:
        """True if every row is final."""
        return not self.missing and self.final == self._nominal + self._trials * len(self._successes)

    def hand_out(self) -> Generation | None:
        """Return missing rows not handed out before; None: nothing to hand out now.

        Nominal rows first, then the trials of successes.
        """
        if not self._handed_out:
            self._handed_out = True
            indices = np.flatnonzero(~self._is_present[: self._nominal, 0])
            if len(indices):
                return self._to_evaluate(indices, np.zeros_like(indices))
        if not self._trials:
            return None
        # A success has trials once all nominal rows up to it are here: the budget may end the run before it.
        gapless = _count_before_gap(self._is_present[self._opened : self._nominal, 0])
        found = self._opened + np.flatnonzero(self._is_success[self._opened :][:gapless])
        self._opened += gapless
        places, trials = np.nonzero(~self._is_present[found, 1:])
        return self._to_evaluate(found[places], 1 + trials) if len(places) else None

    def put(self, rows: Rows) -> None:
        """Put rows in their places; those that are here already, or were not asked, are ignored."""
        indices, trials = rows["index"].astype(np.int64), rows["trial"].astype(np.int64)
        is_new = self._is_asked(indices, trials)
        is_new[is_new] = ~self._is_present[indices[is_new], trials[is_new]]
        first = np.flatnonzero(is_new)[::-1]  # of equal places the last one written stays
        self._store(take_rows(rows, first), indices[first], trials[first])

    def ready_rows(self) -> Rows:
        """Rows after the final ones, up to the first that is missing: nominal ones, or else trials."""
        if self.missing:
            n = _count_before_gap(self._is_present[self.final : self._nominal, 0][:MOST_FINAL])
            return take_rows(self._rows, np.s_[self.final : self.final + n, 0])
        indices, trials = self._next(MOST_FINAL)
        n = _count_before_gap(self._is_present[indices, trials])
        return take_rows(self._rows, (indices[:n], trials[:n]))

    def truncate(self) -> None:
        """Drop the nominal rows after the final ones: budget or goal is reached."""
        self._nominal = min(self._nominal, self.final)

    def replay(self, rows: Rows) -> None:
        """Take this generation's part of recorded rows that begin after the final ones.

        Raises ReplayError if keys or genomes differ from those asked, in any bit.
        """
        # Where the budget ends a generation, trials follow early.
        nominal = _count_before_gap(rows["trial"] == 0)
        indices, trials = self._next(max(1, nominal) if self.missing else len(rows))
        recorded = rows[: len(indices)]
        asked = self._rows[indices[: len(recorded)], 0]
        asked["trial"] = trials[: len(recorded)]
        for column in ("generation", "index", "trial", "genome"):
            if asked[column].tobytes() != recorded[column].tobytes():
                raise ReplayError(self._mismatch(asked, recorded, column))
        self._store(recorded, indices[: len(recorded)], trials[: len(recorded)])

    @property
    def _successes(self) -> Places:
        """The successes among the nominal rows that the journal is to hold, by index."""
        return np.flatnonzero(self._is_success[: self._nominal])

    def _is_asked(self, indices: Places, trials: Places) -> NDArray[np.bool_]:
        """Mask of places of this generation: nominal rows, and trials handed out."""
        is_known: NDArray[np.bool_] = (indices < self._nominal) & (trials <= self._trials)
        has_trials = self._is_success[np.where(is_known, indices, 0)] & (indices < self._opened)
        return np.asarray(is_known & ((trials == 0) | has_trials))

    def _to_evaluate(self, indices: Places, trials: Places) -> Generation:
        genomes = self._rows["genome"][indices, 0]
        return Generation(self.number, indices.astype(np.uint32), trials.astype(np.uint16), genomes)

    def _store(self, rows: Rows, indices: Places, trials: Places) -> None:
        self._bytes[indices, trials] = row_bytes(rows)
        self._is_present[indices, trials] = True
        nominal = indices[trials == 0]
        self._is_success[nominal] = self._rows["outcome"][nominal, 0] >= Outcome.DROPPED

    def _next(self, most: int) -> tuple[Places, Places]:
        """Return indices and trials of the next rows in journal order: nominal, or else trials."""
        if self.missing:
            indices = np.arange(self.final, min(self.final + most, self._nominal))
            return indices, np.zeros_like(indices)
        found, first = self._successes, self.final - self._nominal
        places = np.arange(first, min(first + most, self._trials * len(found)))
        return found[places // max(1, self._trials)], 1 + places % max(1, self._trials)

    def _mismatch(self, asked: Rows, recorded: Rows, column: str) -> str:
        pairs = zip(asked[column], recorded[column], strict=True)
        place = next(i for i, (one, other) in enumerate(pairs) if one.tobytes() != other.tobytes())
        return (
            f"The journal's {column} differs from what the spec asks in generation {self.number}, "
            f"index {asked['index'][place]}: it was recorded by another spec or version of qdgrasp, "
            "so this run cannot go on from it."
        )


def _count_before_gap(is_present: NDArray[np.bool_]) -> int:
    return len(is_present) if is_present.all() else int(is_present.argmin())


GROWTH = 8  # Told generations for each further one in flight


def most_in_flight(spec: RunSpec, told: int) -> int:
    """Return how many generations may be in flight, asked and not told, after `told` ones.

    Where the spec has them become more, a genome is made without the results of `generations_in_flight`
    generations and of about a `GROWTH`-th of all told ones.
    """
    first, most = spec.generations_in_flight, (spec.in_flight or 0) // spec.population
    return max(first, min(most, first + told // GROWTH))


class Pipeline:
    """Orders the asks and tells of one search.

    A generation is asked of the search at the moment when fewer are in flight than may be after those that
    were told, neither earlier nor later, so that a slow coordinator asks the same genomes as a fast one;
    `ask` only hands out what is there. Nothing has been asked of the search before.

    The run ends with the nominal row that reaches the budget in journal order, and the trials of its
    generation's rows up to that one. Later rows of that generation are not journalled, and that generation is
    not told. The spec's goals end the run earlier in the same way.
    """

    def __init__(self, search: SearchAlgorithm, shape: RowShape, spec: RunSpec) -> None:
        self.tally = RunCounter(spec)
        self._search = search
        self._shape = shape
        self._spec = spec
        self._open: deque[GenerationBuffer] = deque()
        self._asked = 0
        self._cpu_seconds = 0.0
        self._reasons: dict[RowKey, str] = {}
        self._makers: dict[RowKey, str] = {}
        self._prepare(told=0)

    @property
    def finished(self) -> str | None:
        """Reason why the run is over; None while it is not."""
        return self.tally.finished or (None if self._open else "the search has nothing left to ask")

    def ask(self) -> Generation | None:
        """Return the next rows to evaluate; None: nothing now, or the run is finished."""
        for buffer in self._open if self.finished is None else ():
            if (rows := buffer.hand_out()) is not None:
                return rows
        return None

    def settle(
        self, rows: Rows, cpu_seconds: float = 0.0, failures: Sequence[Failure] = (), maker: str = ""
    ) -> JournalSlice:
        """Take evaluated rows, in any order, and return those that have just become final.

        The rows have keys, genomes and results, and are of any generations. Rows that came before, were not
        asked for, or come after the end, are ignored. `cpu_seconds` are added to the next rows that become
        final; `failures` are the reasons of rows with `Outcome.ERROR`, by their place in `rows`; `maker` is
        the id and host of the worker that made them.
        """
        self._cpu_seconds += cpu_seconds
        keys = _keys(rows)
        self._reasons |= {keys[failure.row]: failure.reason for failure in failures}
        self._makers |= dict.fromkeys(keys, maker)
        if self.finished is None:
            self._put(rows)
        return self._advance()

    def replay(self, rows: Rows) -> None:
        """Take the next recorded rows of the journal as if they had just been evaluated.

        Raises ReplayError if this run does not ask them: the journal is of another spec or version.
        """
        while len(rows):
            if self.finished is not None:
                raise ReplayError(f"The journal goes on after its row {self.tally.rows}: {self.finished}.")
            before = self.tally.rows
            self._open[0].replay(rows)
            self._advance()
            rows = rows[self.tally.rows - before :]

    def _put(self, rows: Rows) -> None:
        generations = rows["generation"]
        for buffer in self._open:
            is_its = generations == buffer.number
            if is_its.all():
                buffer.put(rows)
            elif is_its.any():
                buffer.put(take_rows(rows, is_its))

    def _advance(self) -> JournalSlice:
        """Make final the rows without a gap; tell and ask where a generation is complete."""
        # Rows arrive in any order; only those without a gap before them count, end the run, or are told.
        first, errors = self.tally.rows, self.tally.errors
        pieces: list[Rows] = []
        while self.finished is None and len(ready := self._open[0].ready_rows()):
            pieces.append(self._finalise(self._open[0], ready))
        if not pieces:
            return JournalSlice(first, self._shape.empty(0))
        rows = join_rows(pieces)
        cpu_seconds, self._cpu_seconds = self._cpu_seconds, 0.0
        keys = _keys(rows)
        makers = tuple(self._makers.pop(key, "") for key in keys)
        failures = self._failures(rows, keys) if self.tally.errors > errors else ()
        return JournalSlice(first, rows, cpu_seconds, failures, makers)

    def _finalise(self, buffer: GenerationBuffer, rows: Rows) -> Rows:
        """Count the ready rows of the oldest generation, up to the end of the run."""
        rows = rows[: self.tally.rows_until_stop(rows)]
        buffer.final += len(rows)
        self.tally.count(rows)
        if self.tally.is_reached:
            buffer.truncate()
        if buffer.is_complete:
            self.tally.end_generation()
            self._close(buffer)
        return rows

    def _close(self, buffer: GenerationBuffer) -> None:
        """Tell a complete generation, and ask the one that waited for it, unless the run is over."""
        if self.finished is None:
            self._search.tell(buffer.number, buffer.rows_for_tell)
            self._open.popleft()
            self._prepare(told=buffer.number + 1)

    def _prepare(self, told: int) -> None:
        """Ask for the generations that may be in flight now, unless the budget is sure to be spent."""
        # The search is asked here alone, at a moment that depends on tells and not on time: genomes are
        # then a function of the spec, however late rows come or workers fetch them.
        counts_overlaps = self._spec.overlaps == "count"
        while len(self._open) < most_in_flight(self._spec, told):
            needed = self.tally.left
            if counts_overlaps:
                needed -= sum(buffer.missing for buffer in self._open)
            if needed <= 0 or not len(genomes := self._search.ask(self._asked)):
                return
            limit, trials = needed if counts_overlaps else len(genomes), self._spec.trial_count
            self._open.append(GenerationBuffer(self._asked, genomes, self._shape, limit, trials))
            self._asked += 1

    def _failures(self, rows: Rows, keys: list[RowKey]) -> tuple[Failure, ...]:
        return tuple(
            Failure(row=int(place), reason=self._reasons.pop(keys[place], ""))
            for place in np.flatnonzero(rows["outcome"] == Outcome.ERROR)
        )


def _keys(rows: Rows) -> list[RowKey]:
    """Return generation, index and trial of each row."""
    return list(zip(*(rows[name].tolist() for name in ("generation", "index", "trial")), strict=True))
