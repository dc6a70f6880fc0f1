"""Grasps of a run from which a new one takes its poses, to score them again."""

from typing import Any

import msgspec
import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from qdgrasp_coordinator.metrics.cells import GenomeReader, cell_keys, cells, niches, without_synergy
from qdgrasp_coordinator.metrics.contact_niches import contact_niches
from qdgrasp_coordinator.metrics.successes import best_first
from qdgrasp_coordinator.search.fixed_poses import as_given
from qdgrasp_coordinator.search.registry import prior_of
from qdgrasp_coordinator.storage import outputs
from qdgrasp_coordinator.storage.outputs import SOURCE
from qdgrasp_coordinator.storage.run_folder import RunFolder
from qdgrasp_protocol.errors import InputError
from qdgrasp_protocol.rows import GIVEN, HARD_TRIALS, LIFT, TRIALS, Outcome, Rows
from qdgrasp_protocol.spec import DEFAULT_ENGINE, GOAL_KEYS, OBJECTIVE_KEYS, RunSpec, run_spec, to_values


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
        rows = rows[check((poses[:, :3], poses[:, 3:], starts)).is_reachable]
    if not len(rows):
        raise InputError(
            f"The hand comes to no grasp of {folder.path} in this way; take another --resting-pose, or a "
            "shorter --approach-distance."
        )
    return rows


def best_of_kinds(rows: Rows, kinds: NDArray[np.int64] | None = None) -> Rows:
    """Return the best row of each kind, best first.

    `kinds` (n,) are equal for rows of a kind; None: their 1 cm cells. `best_first` orders rows.
    """
    kinds = cell_keys(cells(rows["descriptor"][:, :3])) if kinds is None else kinds
    order = best_first(rows)
    _, first = np.unique(kinds[order], return_index=True)
    return rows[order[np.sort(first)]]


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


def read_source(folder: RunFolder) -> RankingSource:
    """Read the origin of the poses of a run that scores grasps again; raises FolderError."""
    try:
        return msgspec.json.decode(outputs.read(folder.path / SOURCE), type=RankingSource)
    except (msgspec.MsgspecError, RecursionError) as error:
        raise outputs.damaged_file(folder.path / SOURCE, str(error)) from None


def rerank_spec(
    source: RunFolder, chosen: Rows, base: str | None = None, engine: str | None = None, **asked: Any
) -> RunSpec:
    """The spec of a run that scores grasps of another.

    Its base and engine are those of the run unless given.
    """
    genomes = as_given(source.scene(), prior_of(source.spec), chosen)
    poses = [[float(str(number)) for number in genome] for genome in genomes]  # the shortest decimals
    disturbed = base or ("physical" if source.spec.nominal_protocol in ("physical", LIFT) else "paper")
    if disturbed == "physical" and asked.get("trials") == TRIALS:
        asked["trials"] += HARD_TRIALS
    values = to_values(source.spec) | {
        "method": GIVEN,
        "base": disturbed,
        "engine": engine or source.spec.engine or DEFAULT_ENGINE,
        "evaluations": len(poses),
        "population": len(poses),
        "generations_in_flight": 1,
        "overlaps": "count",
        "poses": poses,
    }
    return run_spec({key: value for key, value in values.items() if key not in OF_A_SEARCH} | asked, "rerank")


OF_A_SEARCH = (*OBJECTIVE_KEYS, "in_flight", "trials", "reseated", *GOAL_KEYS)
"""Keys of a run that do not go over to the run that scores its grasps again."""
