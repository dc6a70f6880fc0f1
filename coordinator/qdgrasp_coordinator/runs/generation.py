"""A generation: the rows of it that are to be evaluated, and the slot that waits for them."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from qdgrasp_coordinator.counts.whole import taken, whole
from qdgrasp_protocol.errors import ReplayError
from qdgrasp_protocol.genome import Genomes
from qdgrasp_protocol.outcome import Outcome
from qdgrasp_protocol.rows import Rows, Shape

LOOK = 4096
"""The most rows that become final at once."""
Places = NDArray[np.int64]
"""(n,): indices, or trials, of rows."""


@dataclass(frozen=True)
class Generation:
    """Rows of one generation that are to be evaluated."""

    number: int
    indices: NDArray[np.uint32]
    """(n,): places in the generation."""
    trials: NDArray[np.uint16]
    """(n,): 0 is nominal, 1 and up are randomised."""
    genomes: Genomes
    """(n, d)."""


class Slot:
    """One generation that is asked and not yet told.

    The journal has its nominal rows by index, then the trials of its successes by (index, trial).

    Parameters
    ----------
    limit
        How many of its nominal rows are needed at most, from index 0 on.
    trials
        How many trials a success has.
    """

    final: int = 0
    """How many of its rows are final, in journal order."""

    def __init__(self, number: int, genomes: Genomes, shape: Shape, limit: int, trials: int = 0) -> None:
        self.number = number
        self._trials = trials
        self._nominal = min(limit, len(genomes))
        """Nominal rows that the journal is to hold."""
        self._rows = shape.empty(len(genomes) * (1 + trials)).reshape(len(genomes), 1 + trials)
        """By index and trial; what is never written costs no memory."""
        self._bytes = whole(self._rows)
        self._rows["generation"][:, 0] = number
        self._rows["index"][:, 0] = np.arange(len(genomes))
        self._rows["genome"][:, 0] = genomes
        self._here = np.zeros((self._nominal, 1 + trials), dtype=bool)
        self._is_success = np.zeros(self._nominal, dtype=bool)
        self._handed_out = False
        self._opened = 0
        """Nominal rows, from index 0 on, whose trials were handed out where they are successes."""

    @property
    def told(self) -> Rows:
        """Its nominal rows by index as the search hears them: fitness is the sum over a success's trials."""
        rows = taken(self._rows, np.s_[:, 0])
        if self._trials:
            found = self._found
            rows["fitness"][found] = self._rows["fitness"][found, 1:].sum(axis=1)
        return rows

    @property
    def missing(self) -> int:
        """How many nominal rows are not final yet."""
        return max(0, self._nominal - self.final)

    @property
    def is_complete(self) -> bool:
        """Whether every row that the journal is to hold is final."""
        return not self.missing and self.final == self._nominal + self._trials * len(self._found)

    def hand_out(self) -> Generation | None:
        """Rows that are missing and were not handed out yet; None when there are none now.

        Nominal rows first; the trials of a success once all nominal rows up to it are here.
        """
        if not self._handed_out:
            self._handed_out = True
            indices = np.flatnonzero(~self._here[: self._nominal, 0])
            if len(indices):
                return self._to_evaluate(indices, np.zeros_like(indices))
        return self._hand_out_trials() if self._trials else None

    def _hand_out_trials(self) -> Generation | None:
        gapless = _gapless(self._here[self._opened : self._nominal, 0])
        found = self._opened + np.flatnonzero(self._is_success[self._opened :][:gapless])
        self._opened += gapless
        places, trials = np.nonzero(~self._here[found, 1:])
        return self._to_evaluate(found[places], trials + 1) if len(places) else None

    def place(self, rows: Rows) -> None:
        """Put rows in their places; those that are here already, or were not asked, are ignored."""
        indices, trials = rows["index"].astype(np.int64), rows["trial"].astype(np.int64)
        is_new = self._is_asked(indices, trials)
        is_new[is_new] = ~self._here[indices[is_new], trials[is_new]]
        first = np.flatnonzero(is_new)[::-1]  # of equal places the last one written stays
        self._put(taken(rows, first), indices[first], trials[first])

    @property
    def has_arrived(self) -> bool:
        """Whether the row behind the final ones is here."""
        if self.missing:
            return bool(self._here[self.final, 0])
        indices, trials = self._next(1)
        return bool(self._here[indices, trials].any())

    def arrived(self) -> Rows:
        """Rows behind the final ones, up to the first that is missing: nominal ones, or else trials."""
        if self.missing:
            n = _gapless(self._here[self.final : self._nominal, 0][:LOOK])
            return taken(self._rows, np.s_[self.final : self.final + n, 0])
        indices, trials = self._next(LOOK)
        n = _gapless(self._here[indices, trials])
        return taken(self._rows, (indices[:n], trials[:n]))

    def cut(self) -> None:
        """Hear that nominal rows behind the final ones are not needed: the budget is spent."""
        self._nominal = min(self._nominal, self.final)

    def replay(self, rows: Rows) -> None:
        """Take what belongs here of recorded rows that begin behind the final ones.

        Raises
        ------
        ReplayError
            Keys or genomes differ from those asked, in any bit.
        """
        nominal = _gapless(rows["trial"] == 0)  # where the budget ends a generation, trials follow early
        indices, trials = self._next(max(1, nominal) if self.missing else len(rows))
        recorded = rows[: len(indices)]
        asked = self._rows[indices[: len(recorded)], 0]
        asked["trial"] = trials[: len(recorded)]
        for column in ("generation", "index", "trial", "genome"):
            if asked[column].tobytes() != recorded[column].tobytes():
                raise ReplayError(self._mismatch(asked, recorded, column))
        self._put(recorded, indices[: len(recorded)], trials[: len(recorded)])

    @property
    def _found(self) -> Places:
        """The successes among the nominal rows that the journal is to hold, by index."""
        return np.flatnonzero(self._is_success[: self._nominal])

    def _is_asked(self, indices: Places, trials: Places) -> NDArray[np.bool_]:
        """Which places are of this slot: nominal ones, and trials of successes once they were handed out."""
        is_known: NDArray[np.bool_] = (indices < len(self._here)) & (trials <= self._trials)
        if not self._trials:
            return is_known
        safe = np.where(is_known, indices, 0)
        asked: NDArray[np.bool_] = (trials == 0) | (safe < self._opened) & self._is_success[safe]
        return is_known & asked

    def _to_evaluate(self, indices: Places, trials: Places) -> Generation:
        genomes = self._rows["genome"][indices, 0]
        return Generation(self.number, indices.astype(np.uint32), trials.astype(np.uint16), genomes)

    def _put(self, rows: Rows, indices: Places, trials: Places) -> None:
        self._bytes[indices, trials] = whole(rows)
        self._here[indices, trials] = True
        nominal = indices[trials == 0]
        self._is_success[nominal] = self._rows["outcome"][nominal, 0] >= Outcome.DROPPED

    def _next(self, most: int) -> tuple[Places, Places]:
        """Indices and trials of the rows behind the final ones, in journal order: nominal, or else trials."""
        if self.missing:
            indices = np.arange(self.final, min(self.final + most, self._nominal))
            return indices, np.zeros_like(indices)
        found, first = self._found, self.final - self._nominal
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


def _gapless(here: NDArray[np.bool_]) -> int:
    """How many there are before the first that is missing."""
    return len(here) if here.all() else int(here.argmin())
