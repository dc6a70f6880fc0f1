"""Runs that a new one takes poses from, to score them again and rank them."""

import msgspec
import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from qdgrasp_coordinator.metrics.cells import GenomeReader, cell_keys, cells, niches, without_synergy
from qdgrasp_coordinator.metrics.contact_niches import contact_niches
from qdgrasp_coordinator.metrics.grasp_quality import (
    MM,
    object_motion,
    recorded_margins,
    settled_mask,
    settled_poses,
)
from qdgrasp_coordinator.metrics.successes import TrialPlan, best_first, eta_error
from qdgrasp_coordinator.search.registry import prior_of
from qdgrasp_coordinator.storage import outputs
from qdgrasp_coordinator.storage.outputs import RANKING, SOURCE
from qdgrasp_coordinator.storage.run_folder import RunFolder
from qdgrasp_coordinator.storage.tables import aligned_text, csv_text
from qdgrasp_protocol.errors import InputError
from qdgrasp_protocol.rows import Outcome, Rows
from qdgrasp_protocol.spec import RunSpec
from qdgrasp_protocol.text import counted

RANKS_SHOWN = 10  # Grasps that are shown to a person
ETA_DIGITS = 4  # Their decimals, at most
RANKING_COLUMNS = (
    "rank", "eta", "eta_hard", "eta_error", "trials", "nominal_fitness",
    "source_generation", "source_index", "source_fitness",
    "cell_x", "cell_y", "cell_z", "x", "y", "z", "qx", "qy", "qz", "qw",
    "settled_x", "settled_y", "settled_z", "settled_qx", "settled_qy", "settled_qz", "settled_qw",
    "penetration", "motion_mm", "margin",
)  # fmt: skip


class SourceRow(Struct, frozen=True):
    """Origin of a pose: a row of the run that found it."""

    generation: int
    index: int
    fitness: float
    """Fitness that the search was told."""


class RankingSource(Struct, frozen=True):
    """Origin of the poses of a run."""

    run: str
    """The folder of the run that found them."""
    rows: tuple[SourceRow, ...]
    """Origins in the order of the poses."""


def read_run_grasps(folder: RunFolder) -> Rows:
    """Read the grasps of a run (n,) in journal order, with the fitness that its search got.

    A grasp survived a nominal disturbance; under a protocol with trials all of its own are recorded.
    """
    rows = folder.successes().scored
    rows["trial"] = 0
    return rows[rows["outcome"] >= Outcome.SHAKEN]


def reachable_grasps(
    folder: RunFolder,
    rows: Rows,
    approach_distance: float | None = None,
    resting_pose: int | str | None = None,
) -> Rows:
    """Return the grasps of a run that the hand comes to (`ReachabilityCheck.asked`).

    Raises InputError where there is none.
    """
    from qdgrasp_assets.grippers.reachability import ReachabilityCheck  # scipy takes its time

    scene, poses = folder.scene(), rows["base_to_object"]
    check = ReachabilityCheck.asked(scene, folder.spec, approach_distance, resting_pose)
    if check is not None:
        starts = GenomeReader.of(scene, prior_of(folder.spec)).postures(rows)
        rows = rows[check(poses[:, :3], poses[:, 3:], starts).is_reachable]
    if not len(rows):
        raise InputError(
            f"The hand comes to no grasp of {folder.path} in this way; take another --resting-pose, or a "
            "shorter --approach-distance."
        )
    return rows


def best_of_kinds(rows: Rows, most: int, kinds: NDArray[np.int64] | None = None) -> Rows:
    """Return the best row of each kind, and of these the `most` best, best first.

    `kinds` (n,) are equal for rows of a kind; None: their 1 cm cells. `best_first` orders rows.
    """
    kinds = cell_keys(cells(rows["descriptor"][:, :3])) if kinds is None else kinds
    order = best_first(rows)
    _, first = np.unique(kinds[order], return_index=True)
    return rows[order[np.sort(first)]][:most]


def kinds_of_run(spec: RunSpec, rows: Rows, reader: GenomeReader) -> NDArray[np.int64] | None:
    """Return the kinds (n,) of rows for `best_of_kinds`, as the run's search told them apart.

    None: by their cells.
    """
    if spec.diversity == "orientation":
        return without_synergy(niches(rows, reader))
    return contact_niches(rows).astype(np.int64) if spec.diversity == "contact" else None


def source_file(source: RunFolder, rows: Rows) -> dict[str, bytes]:
    """Return the file that names the rows of a run from which the poses of another were taken."""
    places = tuple(SourceRow(*values) for values in rows[["generation", "index", "fitness"]].tolist())
    noted = RankingSource(str(source.path.absolute()), places)
    return {SOURCE: msgspec.json.encode(noted)}


def is_reranking(folder: RunFolder) -> bool:
    """Return whether a run scores the grasps of another."""
    return (folder.path / SOURCE).is_file()


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
    try:
        source = msgspec.json.decode(outputs.read(folder.path / SOURCE), type=RankingSource)
    except (msgspec.MsgspecError, RecursionError) as error:
        raise outputs.damaged_file(folder.path / SOURCE, str(error)) from None
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
