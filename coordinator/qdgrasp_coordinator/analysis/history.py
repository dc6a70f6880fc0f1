"""History: what one run found over its evaluations, from one pass over its journal.

Counted are nominal rows; a success's randomised trials give its eta and nothing else. Of a run that keeps its
successes alone, what all rows came to is told; where every genome counts, the place of a success says after
how many evaluations it was found.
"""

import math
from collections.abc import Iterable, Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from qdgrasp_coordinator.analysis.diversity import Diversity, diversity, niche_archive
from qdgrasp_coordinator.analysis.growth import first_times
from qdgrasp_coordinator.analysis.metrics import NEAR, Metrics
from qdgrasp_coordinator.analysis.reference import ReferenceSet
from qdgrasp_coordinator.analysis.released import ReleasedArchive
from qdgrasp_coordinator.analysis.sums import sums_of
from qdgrasp_coordinator.analysis.target import Target
from qdgrasp_coordinator.counts.cells import cells, keys
from qdgrasp_coordinator.counts.scores import ROBUST
from qdgrasp_coordinator.counts.tally import counted, successes, successful
from qdgrasp_coordinator.folders.folder import RunFolder
from qdgrasp_coordinator.folders.journal import Journal
from qdgrasp_protocol.rows import Rows
from qdgrasp_protocol.spec import Overlaps, RunSpec
from qdgrasp_protocol.trials import trials

NU_BINS = 24
"""Bins of nu from 0 to pi, 7.5 degrees each: six of them reach to pi / 4."""

ROUNDING = 1e-6
"""Taken from every nu [rad]: where a prior ends at pi / 4, float32 goes beyond."""


@dataclass(frozen=True)
class Steps:
    """A number that changes at some of a run's evaluations; 0 at its beginning."""

    evaluations: NDArray[np.int64]
    """(n,), ascending: counted evaluations at which it changes."""
    totals: NDArray[np.int64]
    """(n,): what it is from there on."""

    def after(self, evaluations: ArrayLike) -> NDArray[np.int64]:
        """What it is after so many counted evaluations."""
        place = np.searchsorted(self.evaluations, evaluations, side="right")
        return np.append(0, self.totals)[place]

    @property
    def end(self) -> int:
        """What it is in the end."""
        return int(self.totals[-1]) if len(self.totals) else 0


def steps(evaluations: NDArray[np.int64], changes: NDArray[np.integer] | NDArray[np.bool_]) -> Steps:
    """Add `changes` (n,) up, each of which came with the counted evaluation of that number (n,)."""
    some = np.flatnonzero(changes)
    return Steps(evaluations[some], np.cumsum(changes[some], dtype=np.int64))


@dataclass(frozen=True)
class Finds:
    """The nominal successes of a run in journal order."""

    rows: Rows
    """(n,)."""
    evaluations: NDArray[np.int64]
    """(n,): counted evaluations so far, itself included."""

    @classmethod
    def among(cls, rows: Rows, overlaps: Overlaps, before: int = 0) -> Self:
        """Those among rows in journal order, before which their run counted so many evaluations."""
        evaluations = before + np.cumsum(counted(rows, overlaps))
        success = successful(rows)
        return cls(rows[success], evaluations[success])

    @classmethod
    def placed(cls, rows: Rows, population: int) -> Self:
        """Those among kept rows, where every genome counts and there are so many in a generation."""
        found = successes(rows)
        generation, index = (found[name].astype(np.int64) for name in ("generation", "index"))
        return cls(found, generation * population + index + 1)

    @property
    def nu(self) -> NDArray[np.float64]:
        """(m,) [rad], 0 to pi: of those that aim at a surface point."""
        aimed = self.rows["nu"][self.rows["surface_point"].any(axis=1)].astype(np.float64)
        return np.clip(aimed - ROUNDING, 0.0, math.pi)

    def cells(self, fitness: int = 0) -> Steps:
        """Distinct 1 cm cells with a success of at least this fitness."""
        chosen = self.rows["fitness"] >= fitness
        descriptors = self.rows["descriptor"][chosen][:, :3]
        return steps(self.evaluations[chosen], first_times(keys(cells(descriptors))))

    def found(self, reference: ReferenceSet, fitness: int = 0) -> Steps:
        """Distinct entries of a set that were found with at least this fitness."""
        chosen = self.rows["fitness"] >= fitness
        reached = keys(cells(self.rows["base_to_object"][chosen][:, :3]))
        new = first_times(reached) & np.isin(reached, keys(reference.cells))
        return steps(self.evaluations[chosen], new)

    def published(self, reference: ReferenceSet, archive: ReleasedArchive) -> Steps:
        """Elites of the released code's archive that are in a set: each counts, and may be displaced."""
        positions = self.rows["base_to_object"][:, :3]
        shared = np.isin(keys(cells(positions)), keys(reference.cells))
        gains = _gains(archive.keys(positions), self.rows["fitness"], shared.astype(np.int64))
        return steps(self.evaluations, gains)


def _gains(
    cell: NDArray[np.int64], fitness: NDArray[np.number], worth: NDArray[np.int64]
) -> NDArray[np.int64]:
    """What each comer (n,) adds to the worth of all elites: its own, less that of the elite it displaces."""
    order = np.argsort(cell, kind="stable")
    place = np.unique(cell[order], return_inverse=True)[1]
    above = np.float64(1.0 + np.max(fitness, initial=0))
    best = np.maximum.accumulate(place * above + fitness[order])  # within a cell: earlier cells are smaller
    elite = order[np.diff(best, prepend=-1.0) > 0]
    before = np.append(0, worth[elite][:-1])
    foreign = np.append(True, cell[elite][1:] != cell[elite][:-1])[: len(elite)]
    gains = np.zeros(len(cell), dtype=np.int64)
    gains[elite] = worth[elite] - np.where(foreign, 0, before[: len(elite)])
    return gains


@dataclass(frozen=True)
class History:
    """What one run found. Reference figures are None where there is no set to compare with."""

    path: Path
    spec: RunSpec
    target: Target
    evaluations: int
    complete: bool
    simulated: int
    proposals: int
    overlaps: int
    dead_ends: int
    successes: int
    cells: Steps
    """Distinct 1 cm cells with a success."""
    robust_cells: Steps
    """Those with a success of fitness 2."""
    found: Steps | None
    """Distinct entries of the reference set."""
    robust_found: Steps | None
    """Those of fitness 2, found with fitness 2."""
    published: Steps | None
    """Entries as the released code counts them; None for a hand that it does not have."""
    diversity: Diversity
    """As `info` prints it."""
    qd_score: float
    """As `info` prints it."""
    nu: NDArray[np.int64]
    """(24,): successes by nu, from 0 to pi."""
    near: int
    """Successes with nu below pi / 4."""
    eta: float | None
    """Mean over the successes whose trials are recorded; None where the protocol has none."""
    cpu_seconds: float

    def coverage(self, evaluations: ArrayLike) -> NDArray[np.float64]:
        """The share of the reference set found after so many evaluations; NaN without one."""
        return self._share(self.found, evaluations)

    def published_coverage(self, evaluations: ArrayLike) -> NDArray[np.float64]:
        """The same as the released code counts; NaN without a set, and for a hand that it does not have."""
        return self._share(self.published, evaluations)

    def _share(self, found: Steps | None, evaluations: ArrayLike) -> NDArray[np.float64]:
        if found is None or not self.target.size:
            return np.full(np.shape(evaluations), np.nan)
        return found.after(evaluations) / self.target.size

    @property
    def near_share(self) -> float | None:
        """The share of successes with nu below pi / 4; None without a success that has a nu."""
        aimed = int(self.nu.sum())
        return self.near / aimed if aimed else None


def has_curves(folder: RunFolder) -> bool:
    """Whether the history of a run can be told: of its successes alone it can where every genome counts."""
    with folder.journal() as journal:
        return _has_curves(journal, folder.spec)


def history(folder: RunFolder, target: Target) -> History:
    """Read what a run found, also while it goes on.

    Raises
    ------
    FolderError
        Its journal cannot be read, or does not hold enough of it (`has_curves`).
    """
    spec = folder.spec
    with folder.journal() as journal:
        if not _has_curves(journal, spec):
            journal.check_whole()
        metrics, kept, found = Metrics(trials(spec.protocol)), niche_archive(folder), list[Finds]()
        blocks = metrics.counting(kept.inserting(_finding(journal, spec, found)))
        sums = sums_of(journal, spec, blocks)
        finds = joined(found, journal.shape.empty(0))
    known, archive = target.reference, target.archive
    return History(
        path=folder.path,
        spec=spec,
        target=target,
        **asdict(sums),
        successes=metrics.successes,
        cells=finds.cells(),
        robust_cells=finds.cells(fitness=ROBUST),
        found=None if known is None else finds.found(known),
        robust_found=None if known is None else finds.found(known.robust, fitness=ROBUST),
        published=None if known is None or archive is None else finds.published(known, archive),
        diversity=diversity(kept),
        qd_score=metrics.qd_score,
        nu=np.histogram(finds.nu, bins=NU_BINS, range=(0.0, math.pi))[0],
        near=int(np.count_nonzero(finds.nu < NEAR)),
        eta=None if metrics.eta is None else metrics.eta.mean,
    )


def _has_curves(journal: Journal, spec: RunSpec) -> bool:
    return not journal.sources or (len(journal.sources) == 1 and spec.overlaps == "count")


def joined(found: Iterable[Finds], none: Rows) -> Finds:
    """The finds of several blocks in one."""
    parts = [Finds(none, np.zeros(0, np.int64)), *found]
    return Finds(
        np.concatenate([part.rows for part in parts]), np.concatenate([part.evaluations for part in parts])
    )


def _finding(journal: Journal, spec: RunSpec, found: list[Finds]) -> Iterator[Rows]:
    """The rows that a journal holds, in blocks; what each one found is added as it passes."""
    before = 0
    for block in journal.kept():
        if journal.sources:
            found.append(Finds.placed(block, spec.population))
        else:
            found.append(Finds.among(block, spec.overlaps, before))
            before += int(counted(block, spec.overlaps).sum())
        yield block
