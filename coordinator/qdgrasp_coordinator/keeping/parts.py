"""Parts: the runs that folders hold rows of, each search once.

Two folders may record one search: a copy is older than what it was copied from, a run was carried out twice,
or under two budgets. What the one with fewer rows kept, the other has too.
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import groupby

import msgspec

from qdgrasp_coordinator.folders.folder import RunFolder
from qdgrasp_coordinator.folders.sources import Source
from qdgrasp_coordinator.keeping.reduction import padded, rows_of, sources
from qdgrasp_protocol.rows import Rows, Shape
from qdgrasp_protocol.spec import to_toml


@dataclass(frozen=True)
class Part:
    """A run that is merged: where its rows are, and which of the sources there it is."""

    folder: RunFolder
    number: int
    source: Source

    @property
    def order(self) -> tuple[str, int, str, str]:
        """Where it stands among others; equal ones are one run."""
        asked = self.source.asked
        return asked.method, asked.seed, self.source.digest, self.source.scene

    @property
    def search(self) -> tuple[str, str]:
        """What it searches, whenever it ends."""
        endless = msgspec.structs.replace(self.source.asked, evaluations=1, successes=None, no_new_cell=None)
        return self.source.scene, to_toml(endless)

    @property
    def length(self) -> tuple[int, int, str]:
        """How much of its search it has; no two are equal."""
        return self.source.kept, self.source.summary["rows"], self.source.digest

    @property
    def place(self) -> str:
        """Where it is, for a person."""
        path = self.folder.path
        return str(path) if self.source.run == path.absolute().name else f"'{self.source.run}' in {path}"

    def rows(self, shape: Shape) -> Iterator[Rows]:
        """Its kept rows, in a shape that is as wide or wider."""
        return (padded(rows, shape) for rows in rows_of(self.folder, self.number))

    def content(self) -> set[bytes]:
        """Its kept rows, each as bytes; no two have the same key."""
        return {row.tobytes() for rows in rows_of(self.folder, self.number) for row in rows}


@dataclass(frozen=True)
class Repeat:
    """A run whose kept rows another one of the same search has too."""

    part: Part
    whole: Part

    @property
    def words(self) -> str:
        """One sentence for a person."""
        return (
            f"{self.part.place} records a part of the search that {self.whole.place} records: it counts once."
        )


def parts_of(folders: Sequence[RunFolder]) -> tuple[list[Part], list[Repeat]]:
    """The runs that folders hold rows of, each search once, and those that are left out for that; in order.

    A run that is named twice, or is in two merged folders, is one run.
    """
    parts = [Part(folder, n, source) for folder in folders for n, source in enumerate(sources(folder))]
    ordered = sorted(parts, key=lambda part: (part.order, part.source.run), reverse=True)
    distinct = {part.order: part for part in ordered}
    repeats = sorted(_repeats(distinct.values()), key=lambda repeat: repeat.part.order)
    left_out = {repeat.part.order for repeat in repeats}
    return [distinct[order] for order in sorted(distinct) if order not in left_out], repeats


def _repeats(parts: Iterable[Part]) -> Iterator[Repeat]:
    searches = groupby(sorted(parts, key=lambda part: part.search), key=lambda part: part.search)
    for _, search in searches:
        records = list(search)
        if len(records) > 1:
            yield from _repeats_of_one(records)


def _repeats_of_one(records: list[Part]) -> Iterator[Repeat]:
    """Which records of one search another of them makes superfluous."""
    wholes: list[tuple[Part, set[bytes]]] = []
    for part in sorted(records, key=lambda part: part.length, reverse=True):
        content = part.content()
        whole = next((one for one, known in wholes if content <= known), None)
        if whole is None:
            wholes.append((part, content))
        else:
            yield Repeat(part, whole)
