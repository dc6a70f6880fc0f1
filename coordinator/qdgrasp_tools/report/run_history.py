"""Reads the successes of one run over its evaluations, in one pass over its journal.

Nominal rows are counted; a success's randomised trials give its eta and nothing else.
"""

from dataclasses import dataclass
from itertools import chain
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from qdgrasp_coordinator.metrics.reference_coverage import CoverageTarget
from qdgrasp_coordinator.metrics.run_stats import RunCounter
from qdgrasp_coordinator.metrics.success_metrics import (
    EtaSummary,
    NuSummary,
    StepSeries,
    SuccessMetrics,
    cell_growth,
    reference_growth,
    released_growth,
)
from qdgrasp_coordinator.metrics.successes import TrialPlan, find_successes, join_successes
from qdgrasp_coordinator.storage.run_folder import RunFolder
from qdgrasp_protocol.rows import Outcome
from qdgrasp_protocol.spec import RunSpec


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
    nu: NuSummary
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


def read_history(folder: RunFolder, target: CoverageTarget) -> RunHistory:
    """Read what a run found, also while it goes on; FolderError if its journal cannot be read."""
    spec = folder.spec
    with folder.journal() as journal:
        plan, counts = TrialPlan.of(spec), RunCounter.of(spec)
        blocks = counts.counting(chain([journal.shape.empty(0)], journal.blocks()), spec)
        found, cpu_seconds = (
            join_successes([*find_successes(blocks, plan, spec.overlaps)]),
            journal.cpu_seconds,
        )
    metrics = SuccessMetrics(plan)
    metrics.add(found)
    known, archive = target.reference, target.archive
    return RunHistory(
        path=folder.path,
        spec=spec,
        target=target,
        counts=counts,
        cells=cell_growth(found),
        robust_cells=cell_growth(found, Outcome.HELD),
        found=None if known is None else reference_growth(found, known),
        robust_found=None if known is None else reference_growth(found, known.robust, Outcome.HELD),
        published=None if known is None or archive is None else released_growth(found, known, archive),
        qd_score=metrics.qd_score,
        nu=metrics.nu,
        eta=metrics.eta,
        cpu_seconds=cpu_seconds,
    )
