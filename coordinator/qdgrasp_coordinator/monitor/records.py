"""Records: what was found in the runs of jobs, and on what; over the bus or from a folder."""

from dataclasses import dataclass
from shlex import quote
from typing import NamedTuple, Protocol

from qdgrasp_assets.scene import Scene
from qdgrasp_coordinator.counts.curve import Curve
from qdgrasp_coordinator.counts.entry import RunEntries
from qdgrasp_coordinator.counts.finds import Found
from qdgrasp_protocol.printable import printable

COMMANDS = (
    "qdgrasp show {folder} --grasp {number}",
    "qdgrasp render {folder} --grasp {number} -o grasp.png",
)
"""What can be done with one row of a run."""


class JournalId(NamedTuple):
    """Which journal it is: in another one of the same names, the same numbers are of other rows."""

    scene: str
    """sha256 of the scene bundle."""
    began: float
    """When it was begun [s since 1970]."""


class Place(NamedTuple):
    """Where a run lies."""

    folder: str
    """Its path."""
    host: str = ""
    """On which machine; empty: on this one."""

    def commands(self, number: int) -> list[str]:
        """The commands that print all that is known about a row, and draw it, with the machine to run on."""
        folder = quote(printable(self.folder))
        where = f"  # on {printable(self.host)}" if self.host else ""
        return [command.format(folder=folder, number=number) + where for command in COMMANDS]


@dataclass(frozen=True)
class Page:
    """Nominal successes of a run, in journal order."""

    origin: JournalId
    """The journal they are from."""
    found: Found
    """(n,)."""
    next: int
    """The journal number from which to read on."""
    rows: int
    """How many rows the journal has.

    With `next` there nothing is left to read for now; nor where it does not get on, as successes that lack
    trials are told again.
    """

    def is_last(self, first: int) -> bool:
        """Whether nothing is left to read for now, where this was read from journal number `first` on."""
        return self.next >= self.rows or self.next <= first


class Records(Protocol):
    """Finds and scenes of runs. Its methods may take a while; they may be called from several threads.

    Raises
    ------
    InputError
        From any method: there is no such job or run, or it cannot be read.
    BusError, MessageError
        From any method: nobody answers, or not as agreed.
    """

    def scene(self, job: str, run: str, digest: str) -> Scene:
        """What a run grasps, and with which hand: the scene that `page` told of."""

    def page(self, job: str, run: str, first: int) -> Page:
        """Some successes of a run from journal number `first` on; more by asking again with `next`."""

    def entries(self, job: str) -> RunEntries:
        """The runs of a job, finished ones too; those that are not counted yet are left out for now."""

    def curve(self, job: str, run: str) -> Curve:
        """How the run grew from its beginning on, also where it is over; no points: nobody knows."""

    def place(self, job: str, run: str) -> Place:
        """Where the run lies."""
