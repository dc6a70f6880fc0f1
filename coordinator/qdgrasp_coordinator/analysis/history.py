"""History: what one run found over its evaluations, from one pass over its journal.

Counted are nominal rows; a success's randomised trials give its eta and nothing else. Of a run that keeps its
successes alone, what all rows came to is told; where every genome counts, the place of a success says after
how many evaluations it was found.
"""

import math
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from qdgrasp_coordinator.analysis.diversity import Diversity, diversity, niche_archive
from qdgrasp_coordinator.analysis.finds import Finds, joined
from qdgrasp_coordinator.analysis.metrics import NEAR, Metrics
from qdgrasp_coordinator.analysis.steps import Steps
from qdgrasp_coordinator.analysis.sums import sums_of
from qdgrasp_coordinator.analysis.target import Target
from qdgrasp_coordinator.counts.scores import ROBUST
from qdgrasp_coordinator.counts.tally import counted
from qdgrasp_coordinator.folders.folder import RunFolder
from qdgrasp_coordinator.folders.journal import Journal
from qdgrasp_protocol.rows import Rows
from qdgrasp_protocol.spec import RunSpec
from qdgrasp_protocol.trials import trials

NU_BINS = 24
"""Bins of nu from 0 to pi, 7.5 degrees each: six of them reach to pi / 4."""


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
