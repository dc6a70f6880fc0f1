"""The programme of a job: its runs, one after the other, each made when its turn comes."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Protocol

from qdgrasp_coordinator.counts.totals import NOTHING, Totals
from qdgrasp_coordinator.folders.job_folder import RUN
from qdgrasp_coordinator.runs.assignment import Assignment


@dataclass(frozen=True)
class Extent:
    """How much a programme has to do, counted before its first run is opened."""

    runs: int
    evaluations: int
    """The budgets of all runs."""
    budgets: Mapping[str, int]
    """Those of the runs that are to be carried out, by name."""
    runs_done: int = 0
    """Runs that were finished before; they are not opened again."""
    done: Totals = NOTHING
    """What these found."""

    @classmethod
    def of(cls, budgets: Mapping[str, int]) -> "Extent":
        """That of runs with these budgets, by name, none of them finished."""
        return cls(runs=len(budgets), evaluations=sum(budgets.values()), budgets=budgets)

    def with_done(self, found: Mapping[str, Totals]) -> "Extent":
        """The same, where these runs, by name, were finished before."""
        return replace(
            self,
            budgets={run: budget for run, budget in self.budgets.items() if run not in found},
            runs_done=self.runs_done + len(found),
            done=sum(found.values(), self.done),
        )


class Programme(Protocol):
    """What every programme does."""

    extent: Extent

    def next(self) -> Assignment | None:
        """The next run to carry out; None when there is none left.

        Raises
        ------
        RunFailed
            It cannot be made; the one behind it still may.
        DiskFull
            There is no room for it now; it is made when `next` is called again and there is.
        """

    def put_back(self, run: str) -> None:
        """Have `next` make a run again, before any other: it is to be gone on with from its records.

        May be called in another thread than `next`.
        """


class Single:
    """The programme of a job with one run.

    Parameters
    ----------
    make
        Makes the run, at its very beginning.
    evaluations
        Its budget.
    """

    def __init__(self, make: Callable[[], Assignment], evaluations: int) -> None:
        self.extent = Extent.of({RUN: evaluations})
        self._make = make
        self._is_due = True

    def next(self) -> Assignment | None:
        """The run, whenever it is due."""
        if not self._is_due:
            return None  # and nothing is written: it may be put back meanwhile
        self._is_due = False
        return self._make()

    def put_back(self, run: str) -> None:
        """Have it made again."""
        self._is_due = True
