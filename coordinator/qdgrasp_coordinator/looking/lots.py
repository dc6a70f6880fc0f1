"""Lots: recorded rows that are evaluated again together, of one run each, as the programme of a job."""

from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from qdgrasp_coordinator.campaigns.programme import Extent
from qdgrasp_coordinator.folders.folder import RunFolder
from qdgrasp_coordinator.folders.provenance import Provenance
from qdgrasp_coordinator.looking.own_shape import own_shape
from qdgrasp_coordinator.runs.assignment import Assignment
from qdgrasp_coordinator.runs.preparation import scene_shape
from qdgrasp_coordinator.runs.repetition import Repetition
from qdgrasp_coordinator.searches.search import method
from qdgrasp_protocol.rows import Rows
from qdgrasp_protocol.spec import to_toml

MOST = 4096
"""Rows in a lot."""


@dataclass(frozen=True)
class Lot:
    """Some rows of one run."""

    folder: RunFolder
    found_by: Provenance
    numbers: NDArray[np.int64]
    """(n,): of the rows in the folder's journal, ascending."""

    def rows(self) -> Rows:
        """The rows as they are recorded, in the shape of their own run."""
        first, stop = int(self.numbers[0]), int(self.numbers[-1]) + 1
        with self.folder.journal() as journal:
            parts, begin = [], first
            for rows in journal.kept(first, stop):
                here = self.numbers[(self.numbers >= begin) & (self.numbers < begin + len(rows))]
                parts.append(rows[here - begin])
                begin += len(rows)
        return own_shape(np.concatenate(parts), self.folder, self.found_by, self.folder.scene())


Compared = Callable[[Lot, int, np.void, np.void, str], None]
"""Takes a row by its lot and its place there, as it is recorded and as it is now, and why it failed."""


class Lots:
    """The programme of a job that evaluates lots of rows again; each is read when its turn comes."""

    def __init__(self, lots: Sequence[Lot], compared: Compared) -> None:
        self._lots = {str(number): lot for number, lot in enumerate(lots)}
        self._left = deque(self._lots)
        self._compared = compared
        self.extent = Extent.of({name: len(lot.numbers) for name, lot in self._lots.items()})

    def next(self) -> Assignment | None:
        """The next lot; None when there is none left."""
        if not self._left:
            return None
        name = self._left.popleft()
        return self._assignment(name, self._lots[name])

    def put_back(self, run: str) -> None:
        """Have a lot evaluated from its beginning, before any other."""
        self._left.appendleft(run)

    def _assignment(self, name: str, lot: Lot) -> Assignment:
        spec, recorded = lot.found_by.spec, lot.rows()
        prior = method(spec.method).prior

        def compare(place: int, now: np.void, reason: str) -> None:
            self._compared(lot, place, recorded[place], now, reason)

        return Assignment(
            name,
            to_toml(spec).encode(),
            lot.folder.bundle(),
            prior,
            scene_shape(lot.folder.scene(), prior),
            Repetition(recorded, compare),
            len(recorded),
        )
