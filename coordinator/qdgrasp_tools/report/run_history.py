"""Reads the successes of one run over its evaluations, in one pass over its journal.

Nominal rows are counted; a success's randomised trials give its eta and nothing else.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from qdgrasp_coordinator.metrics.reference_coverage import CoverageTarget
from qdgrasp_coordinator.metrics.run_stats import RunCounter, count_rows, evaluation_mask
from qdgrasp_coordinator.metrics.scores import TrialPlan
from qdgrasp_coordinator.metrics.success_metrics import (
    NEAR_NU,
    EtaSummary,
    StepSeries,
    SuccessHistory,
    SuccessMetrics,
    join_histories,
)
from qdgrasp_coordinator.storage.journal import Journal
from qdgrasp_coordinator.storage.run_folder import RunFolder
from qdgrasp_protocol.rows import Outcome, Rows
from qdgrasp_protocol.spec import RunSpec

NU_BINS = 24  # Bins of nu from 0 to pi, 7.5 degrees each: six of them reach to pi / 4


@dataclass(frozen=True)
class RunHistory:
    """Growth of one run over its evaluations; without a reference set there is no coverage."""

    path: Path
    spec: RunSpec
    target: CoverageTarget
    counts: RunCounter
    """The sums over its rows."""
    cells: StepSeries
    """Distinct 1 cm cells with a success."""
    robust_cells: StepSeries
    """Distinct 1 cm cells with a robust success."""
    found: StepSeries | None
    """Distinct entries of the reference set."""
    robust_found: StepSeries | None
    """Entries of fitness 2, found by robust successes."""
    published: StepSeries | None
    """Entries as the released code counts them; None for a hand that it does not have."""
    qd_score: float
    nu: NDArray[np.int64]
    """(24,): successes by nu, from 0 to pi."""
    near: int
    """Successes with nu below pi / 4."""
    eta: EtaSummary | None
    """Eta of the successes whose trials are recorded; None where the protocol has none."""
    cpu_seconds: float

    @property
    def evaluations(self) -> int:
        """Number of counted evaluations."""
        return self.counts.evaluations

    @property
    def complete(self) -> bool:
        """True if it has spent its budget or reached its goal."""
        return self.counts.finished is not None

    def coverage(self, evaluations: ArrayLike) -> NDArray[np.float64]:
        """Share of the reference set found after so many evaluations; NaN without one."""
        if self.found is None or not self.target.size:
            return np.full(np.shape(evaluations), np.nan)
        return self.found.after(evaluations) / self.target.size

    def cell_count(self, evaluations: ArrayLike) -> NDArray[np.float64]:
        """Number of success cells after so many evaluations."""
        return self.cells.after(evaluations).astype(np.float64)

    @property
    def near_share(self) -> float | None:
        """Share of successes with nu below pi / 4; None without a success that has a nu."""
        aimed = int(self.nu.sum())
        return self.near / aimed if aimed else None


def read_history(folder: RunFolder, target: CoverageTarget) -> RunHistory:
    """Read what a run found, also while it goes on; FolderError if its journal cannot be read."""
    spec = folder.spec
    with folder.journal() as journal:
        metrics = SuccessMetrics(TrialPlan.of(spec))
        found: list[SuccessHistory] = []
        counts = count_rows(spec, metrics.counting(_collect_successes(journal, spec, found)))
        history, cpu_seconds = join_histories(found, journal.shape.empty(0)), journal.cpu_seconds
    known, archive = target.reference, target.archive
    return RunHistory(
        path=folder.path,
        spec=spec,
        target=target,
        counts=counts,
        cells=history.cells(),
        robust_cells=history.cells(Outcome.HELD),
        found=None if known is None else history.found(known),
        robust_found=None if known is None else history.found(known.robust, Outcome.HELD),
        published=None if known is None or archive is None else history.published(known, archive),
        qd_score=metrics.qd_score,
        nu=np.histogram(history.nu, bins=NU_BINS, range=(0.0, math.pi))[0],
        near=int(np.count_nonzero(history.nu < NEAR_NU)),
        eta=metrics.eta,
        cpu_seconds=cpu_seconds,
    )


def _collect_successes(journal: Journal, spec: RunSpec, found: list[SuccessHistory]) -> Iterator[Rows]:
    """Yield the rows of a journal in blocks; the successes in each are added as it passes."""
    before = 0
    for block in journal.blocks():
        found.append(SuccessHistory.among(block, spec.overlaps, before))
        before += int(evaluation_mask(block, spec.overlaps).sum())
        yield block
