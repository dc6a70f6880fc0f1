"""Records: what was found in the runs of jobs, and on what; over the bus or from a folder."""

from dataclasses import dataclass
from typing import Protocol

from qdgrasp_assets.scene import Scene
from qdgrasp_coordinator.counts.entry import RunEntry
from qdgrasp_coordinator.counts.finds import Found


@dataclass(frozen=True)
class Page:
    """Nominal successes of a run, in journal order."""

    found: Found
    """(n,)."""
    next: int
    """The journal number from which to read on."""
    rows: int
    """How many rows the journal has; with `next` there, nothing is left to read for now."""


class Records(Protocol):
    """Finds and scenes of runs. Its methods may take a while; they may be called from several threads.

    Raises
    ------
    InputError
        From any method: there is no such job or run, or it cannot be read.
    BusError, MessageError
        From any method: nobody answers, or not as agreed.
    """

    def scene(self, job: str, run: str) -> Scene:
        """What a run grasps, and with which hand."""

    def page(self, job: str, run: str, first: int) -> Page:
        """Some successes of a run from journal number `first` on; more by asking again with `next`."""

    def entries(self, job: str) -> list[RunEntry]:
        """The runs of a job, finished ones too."""

    def name(self, job: str, run: str) -> str:
        """What commands call the run."""
