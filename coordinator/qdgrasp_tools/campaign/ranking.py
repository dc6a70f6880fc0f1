"""The ranking of a run that scores the grasps of another again."""

import msgspec
import numpy as np

from qdgrasp_coordinator.metrics.cells import cells
from qdgrasp_coordinator.metrics.grasp_quality import (
    MM,
    object_motion,
    recorded_margins,
    settled_mask,
    settled_poses,
)
from qdgrasp_coordinator.metrics.successes import TrialPlan, best_first, eta_error
from qdgrasp_coordinator.search.source_runs import read_source
from qdgrasp_coordinator.storage import outputs
from qdgrasp_coordinator.storage.outputs import RANKING
from qdgrasp_coordinator.storage.run_folder import RunFolder
from qdgrasp_coordinator.storage.tables import csv_text
from qdgrasp_protocol.rows import Outcome
from qdgrasp_protocol.text import aligned_text, counted

RANKS_SHOWN = 10  # Grasps that are shown to a person
ETA_DIGITS = 4  # Their decimals, at most
RANKING_COLUMNS = (
    "rank", "eta", "eta_hard", "eta_error", "trials", "nominal_fitness",
    "source_generation", "source_index", "source_fitness",
    "cell_x", "cell_y", "cell_z", "x", "y", "z", "qx", "qy", "qz", "qw",
    "settled_x", "settled_y", "settled_z", "settled_qx", "settled_qy", "settled_qz", "settled_qw",
    "penetration", "motion_mm", "margin",
)  # fmt: skip


def write_ranking(folder: RunFolder) -> str:
    """Rank the poses of a complete run that scores grasps again, and write `ranking.csv`.

    Returns the best of them as a table. Raises FolderError if a file cannot be read or written.
    """
    table = rank_poses(folder)
    rows = [dict(zip(RANKING_COLUMNS, (f"{value:.9g}" for value in line), strict=True)) for line in table]
    outputs.replace(folder.path / RANKING, csv_text(rows, RANKING_COLUMNS).encode())
    shown = [[f"{round(value, ETA_DIGITS):g}" for value in line[:12]] for line in table[:RANKS_SHOWN]]
    text = aligned_text([RANKING_COLUMNS[:12], *shown])
    return f"{text}\n{counted(len(table), 'grasp')} ranked in {folder.path / RANKING}"


def rank_poses(folder: RunFolder) -> list[list[float]]:
    """Rank a run's poses, best first, ties in their order; each as in `RANKING_COLUMNS`.

    By eta (`best_first`). A pose that is no success any more has eta 0: it has no trials.
    """
    source = read_source(folder)
    found = folder.successes(Outcome.ERROR)
    rows, trials, etas = found.rows, found.trials, TrialPlan.of(folder.spec).eta(found.scores)
    settled = np.where(settled_mask(rows)[:, None], settled_poses(rows), np.nan)
    margins = np.full(len(rows), np.nan)
    if settled_mask(rows).any():
        margins = recorded_margins(rows, folder.scene().object)
    columns = (
        *(etas, found.eta_hard, eta_error(etas, trials), trials, rows["fitness"]),
        [msgspec.structs.astuple(source.rows[place]) for place in range(len(rows))],
        *(cells(rows["descriptor"][:, :3]), rows["base_to_object"], settled),
        *(rows["penetration"], object_motion(rows)[:, 0] / MM, margins),
    )
    ordered = np.column_stack(columns)[best_first(rows, np.where(trials > 0, etas, -1.0), found.eta_hard)]
    return [[rank, *line] for rank, line in enumerate(ordered.tolist(), start=1)]
