"""A generation: the rows of it that are to be evaluated, and the slot that waits for them."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from qdgrasp_protocol.errors import ReplayError
from qdgrasp_protocol.genome import Genomes
from qdgrasp_protocol.rows import Rows, Shape


@dataclass(frozen=True)
class Generation:
    """Rows of one generation that are to be evaluated."""

    number: int
    indices: NDArray[np.uint32]
    """(n,): places in the generation."""
    trials: NDArray[np.uint16]
    """(n,): 0, nominal."""
    genomes: Genomes
    """(n, d)."""


class Slot:
    """One generation that is asked and not yet told.

    Parameters
    ----------
    limit
        How many of its rows are needed at most, from index 0 on.
    """

    handed_out: bool = False
    final: int = 0
    """How many of its rows are final."""

    def __init__(self, number: int, genomes: Genomes, shape: Shape, limit: int) -> None:
        self.number = number
        self.rows = shape.empty(len(genomes))
        self.rows["generation"] = number
        self.rows["index"] = np.arange(len(genomes))
        self.rows["genome"] = genomes
        self._here = np.zeros(min(limit, len(genomes)), dtype=bool)

    def hand_out(self) -> Generation:
        """The rows that are still missing."""
        self.handed_out = True
        rows = self.rows[: len(self._here)][~self._here]
        return Generation(self.number, rows["index"], rows["trial"], rows["genome"])

    def place(self, rows: Rows) -> tuple[int, int]:
        """Put rows in their places; gives how many were here already, and how many were not asked."""
        asked = rows[(rows["index"] < len(self._here)) & (rows["trial"] == 0)]
        index, first = np.unique(asked["index"], return_index=True)
        new = first[~self._here[index]]
        places = asked["index"][new]
        self.rows[places] = asked[new]
        self._here[places] = True
        return len(asked) - len(new), len(rows) - len(asked)

    def arrived(self) -> Rows:
        """The rows behind the final ones, up to the first that is missing."""
        waiting = self._here[self.final :]
        n = len(waiting) if waiting.all() else int(waiting.argmin())
        return self.rows[self.final : self.final + n]

    def replay(self, rows: Rows) -> None:
        """Take what belongs here of recorded rows that begin behind the final ones.

        Raises
        ------
        ReplayError
            Keys or genomes differ from those asked, in any bit.
        """
        stop = min(self.final + len(rows), len(self._here))
        asked, recorded = self.rows[self.final : stop], rows[: stop - self.final]
        for column in ("generation", "index", "trial", "genome"):
            if asked[column].tobytes() != recorded[column].tobytes():
                raise ReplayError(self._mismatch(asked, recorded, column))
        asked[:] = recorded
        self._here[self.final : stop] = True

    def _mismatch(self, asked: Rows, recorded: Rows, column: str) -> str:
        pairs = zip(asked[column], recorded[column], strict=True)
        place = next(i for i, (one, other) in enumerate(pairs) if one.tobytes() != other.tobytes())
        return (
            f"The journal's {column} differs from what the spec asks in generation {self.number}, "
            f"index {asked['index'][place]}: it was recorded by another spec or version of qdgrasp, "
            "so this run cannot go on from it."
        )
