"""Verification: recorded rows evaluated again by their own priors and genomes, and compared to the bit."""

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from qdgrasp_coordinator.folders import platforms
from qdgrasp_coordinator.folders.folder import RunFolder
from qdgrasp_coordinator.folders.job_folder import JobFolder
from qdgrasp_coordinator.folders.provenance import Provenance, provenances
from qdgrasp_coordinator.looking.agreement import differing, told
from qdgrasp_coordinator.looking.lots import MOST, Lot, Lots
from qdgrasp_coordinator.looking.sampling import balanced
from qdgrasp_coordinator.looking.verified import Different, MadeOn, Values, Verified
from qdgrasp_coordinator.runs.assignment import Assignment
from qdgrasp_coordinator.serving.record import Memory
from qdgrasp_coordinator.watching.errand import run_errand
from qdgrasp_coordinator.watching.progress import Display
from qdgrasp_coordinator.watching.supervisor import Team
from qdgrasp_protocol.errors import InputError
from qdgrasp_protocol.lifetime import Stop
from qdgrasp_protocol.outcome import Outcome
from qdgrasp_protocol.rows import Rows

JOB = "verify"
TRIALS = 16
"""What the kind of a row has beside its outcome where it is a trial."""


@dataclass(frozen=True)
class Stock:
    """The rows of one run in one folder, of which some are chosen."""

    folder: RunFolder
    found_by: Provenance
    numbers: NDArray[np.int64]
    """(n,): of those that can be compared, ascending."""
    kinds: NDArray[np.uint8]
    """(n,): by outcome, nominal rows apart from trials."""


class Findings:
    """What is known of the rows that were evaluated again so far."""

    def __init__(self) -> None:
        self.different: list[Different] = []
        self.columns: Counter[str] = Counter()
        self.outcomes: Counter[Outcome] = Counter()
        self._records: list[Memory] = []

    def compared(self, lot: Lot, place: int, recorded: np.void, now: np.void, reason: str) -> None:
        """Take a row."""
        self.outcomes[Outcome(recorded["outcome"])] += 1
        unlike = differing(recorded.reshape(1), now.reshape(1))
        names = [name for name, differs in unlike.items() if differs[0]]
        if names:
            self.columns.update(names)
            values = {name: Values(recorded=told(recorded, name), now=told(now, name)) for name in names}
            self.different.append(_different(lot, place, recorded, values, reason))

    def record(self, assignment: Assignment) -> Memory:
        """What is told of the rows of a lot besides themselves."""
        self._records.append(Memory(assignment.shape))
        return self._records[-1]

    @property
    def platform(self) -> dict[str, str]:
        """On which they were evaluated."""
        return next((record.platform for record in self._records if record.platform), {})


def run_folders(path: Path) -> list[RunFolder]:
    """The runs at `path`: that of a run's own folder, or those of a campaign.

    Raises
    ------
    FolderError
        There is neither.
    """
    if JobFolder.is_job(path) and JobFolder(path).is_campaign:
        return [RunFolder.open(run) for run in JobFolder(path).run_paths]
    return [RunFolder.open(path)]


def choose(folders: Sequence[RunFolder], most: int | None, seed: int) -> list[Lot]:
    """Rows of all folders, of each kind as many as of any other; all where `most` is None.

    Left out are rows on which the simulator failed: a machine may have been to blame.

    Raises
    ------
    InputError
        There are none.
    """
    stocks = [stock for folder in folders for stock in _stocks(folder)]
    kinds = np.concatenate([np.zeros(0, dtype=np.uint8), *(stock.kinds for stock in stocks)])
    if not len(kinds):
        raise InputError("Nothing is recorded there that could be evaluated again.")
    places = balanced(kinds, len(kinds) if most is None else most, np.random.default_rng(seed))
    return list(_lots(stocks, places))


def repeat(lots: Sequence[Lot], team: Team, display: Display, stop: Stop) -> Verified:
    """Evaluate rows again with workers of this machine, and compare every result bit for bit.

    Raises
    ------
    RunsFailed
        A folder cannot be read.
    EndedEarly
        Workers die again and again.
    """
    found = Findings()
    run_errand(JOB, Lots(lots, found.compared), found.record, team, display, stop)
    rows = sum(found.outcomes.values())
    return Verified(
        rows=rows,
        same=rows - len(found.different),
        runs=len({(lot.folder.path, lot.found_by.run) for lot in lots}),
        outcomes={outcome.name.lower(): found.outcomes[outcome] for outcome in sorted(found.outcomes)},
        different=sorted(found.different, key=lambda one: (one.folder, one.number)),
        columns=dict(found.columns.most_common()),
        platform=found.platform,
        origins=list(_origins(lots, found.platform)),
    )


def _stocks(folder: RunFolder) -> Iterator[Stock]:
    """The rows of a folder that can be compared, run by run."""
    with folder.journal() as journal:
        for found_by in provenances(folder, journal):
            blocks = journal.kept(found_by.rows.start, found_by.rows.stop)
            kinds = np.concatenate([np.zeros(0, dtype=np.uint8), *map(_kinds, blocks)])
            places = np.flatnonzero(kinds % TRIALS != Outcome.ERROR)
            yield Stock(folder, found_by, places + found_by.rows.start, kinds[places])


def _kinds(rows: Rows) -> NDArray[np.uint8]:
    """What kind each row is of: (n,)."""
    kinds: NDArray[np.uint8] = rows["outcome"] + np.where(rows["trial"] > 0, TRIALS, 0).astype(np.uint8)
    return kinds


def _lots(stocks: Sequence[Stock], places: NDArray[np.int64]) -> Iterator[Lot]:
    """The rows at some places of all that are in stock, ascending, in lots."""
    first = 0
    for stock in stocks:
        here = places[(places >= first) & (places < first + len(stock.numbers))] - first
        first += len(stock.numbers)
        for start in range(0, len(here), MOST):
            yield Lot(stock.folder, stock.found_by, stock.numbers[here[start : start + MOST]])


def _different(lot: Lot, place: int, recorded: np.void, values: dict[str, Values], reason: str) -> Different:
    return Different(
        folder=str(lot.folder.path),
        run=lot.found_by.run,
        number=int(lot.numbers[place]),
        generation=int(recorded["generation"]),
        index=int(recorded["index"]),
        trial=int(recorded["trial"]),
        columns=values,
        reason=reason,
    )


def _origins(lots: Sequence[Lot], now: dict[str, str]) -> Iterator[MadeOn]:
    """The platforms that rows were made on, those of most rows first."""
    counts: Counter[tuple[tuple[str, str], ...]] = Counter()
    for lot in lots:
        counts[tuple(sorted(lot.found_by.platform.items()))] += len(lot.numbers)
    for items, rows in counts.most_common():
        platform = dict(items)
        yield MadeOn(rows=rows, platform=platform, differences=platforms.differences(platform, now))
