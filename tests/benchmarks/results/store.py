"""The store of results: the table and its page, which never disagree."""

from collections.abc import Collection, Iterable
from pathlib import Path

import msgspec
from tests.benchmarks.results import table as tables
from tests.benchmarks.results.measure import harvest
from tests.benchmarks.results.page import page
from tests.benchmarks.results.programme import Programme, Wanted
from tests.benchmarks.results.row import Key, Row

from qdgrasp_coordinator.analysis.target import Targets
from qdgrasp_coordinator.folders import disk

PAGE = "index.md"


class Added(msgspec.Struct, frozen=True):
    """What adding runs came to."""

    new: int
    """Rows that were not in, or are others now."""
    kept: int
    """Rows that were left out, as the table has them of today's code."""
    bare: tuple[str, ...]
    """Scenes of which no reference set is known on this machine."""
    whole: int
    """Rows in the table."""

    @property
    def words(self) -> str:
        """For a person."""
        kept = f"; {self.kept} of other code were left out" if self.kept else ""
        bare = f" No S_G on this machine of {', '.join(self.bare)}: no coverage." if self.bare else ""
        return f"{self.new} new rows, {self.whole} in all{kept}.{bare}"


class Store:
    """A table with its page beside it.

    Parameters
    ----------
    file
        The table.
    known
        The programme, for the page and for what is missing.
    current
        Digests of evaluation code that count as today's.
    """

    def __init__(self, file: Path, known: Programme, current: Collection[str]) -> None:
        self.file = file
        self.known = known
        self._current = current

    @property
    def table(self) -> dict[Key, Row]:
        """The table as it is now; raises as `table.read`."""
        return tables.read(self.file)

    def missing(self, asked: Programme) -> list[Wanted]:
        """What of a programme the table does not have of today's code."""
        return asked.missing(self.table, self._current)

    def add(self, directories: Iterable[Path], *, again: bool = True) -> Added:
        """Add the finished runs in folders, and make the page again if that changes anything.

        Parameters
        ----------
        again
            Whether runs that the table has of today's code are looked at, too.
        """
        here = {} if again else self.table
        found = [row for path in directories for row in harvest(path, self._budgets(here), Targets())]
        with tables.held(self.file):
            before = self.table
            after = tables.merged(before, found, self._current)
            if after != before or not self.file.exists():
                tables.write(self.file, after)
                self.write_page()
        return Added(
            new=sum(before.get(key) != row for key, row in after.items()),
            kept=sum(after[row.key] != row for row in found),
            bare=tuple(sorted({f"{row.gripper} on {row.object}" for row in found if row.set_size is None})),
            whole=len(after),
        )

    def write_page(self) -> None:
        """Make the page again."""
        with disk.writing(self.file.parent):
            disk.write(self.file.with_name(PAGE), page(self.known, self.table).encode())

    def _budgets(self, here: tables.Table) -> "_Budgets":
        return _Budgets(self.known, {one for one, row in here.items() if row.code in self._current})


class _Budgets:
    """The budgets of a run whose rows are of use: its own and the programme's, less those that are in."""

    def __init__(self, known: Programme, done: Collection[Key]) -> None:
        self._known = known
        self._done = done

    def __call__(self, asked: Key) -> set[int]:
        budgets = self._known.budgets(asked) | {asked.budget}
        return {budget for budget in budgets if asked._replace(budget=budget) not in self._done}
