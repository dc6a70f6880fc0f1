"""Runs that a new one takes from: poses to score again and rank, or weights.

A warm start is weights that give the value of candidates and of cells by their features; cells themselves are
not handed on, as they belong to an object. Weights are learned from journals, by replaying them into their
searches.
"""

from collections.abc import Iterable, Sequence

import msgspec
import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from qdgrasp_assets.catalog import find_gripper
from qdgrasp_assets.genes import STEEPEST_VALUE
from qdgrasp_assets.scene import SceneObject
from qdgrasp_coordinator.metrics.cells import GenomeReader, cell_keys, cells, niches, without_synergy
from qdgrasp_coordinator.metrics.grasp_quality import (
    MM,
    object_motion,
    recorded_margins,
    settled_mask,
    settled_poses,
)
from qdgrasp_coordinator.metrics.successes import TrialPlan, best_first, eta_error
from qdgrasp_coordinator.scheduler.run_plan import plan_run
from qdgrasp_coordinator.search.base import search_space
from qdgrasp_coordinator.search.registry import learns_value, prior_of, search_words
from qdgrasp_coordinator.search.success_model import STARTS, pooled_weights
from qdgrasp_coordinator.search.value_search import ValueSearch
from qdgrasp_coordinator.storage import outputs
from qdgrasp_coordinator.storage.outputs import ORIGIN, RANKING, SOURCE
from qdgrasp_coordinator.storage.run_folder import PreparedScene, RunFolder
from qdgrasp_coordinator.storage.tables import aligned_text, csv_text
from qdgrasp_protocol.errors import InputError, ReplayError
from qdgrasp_protocol.rows import Outcome, Rows
from qdgrasp_protocol.spec import FirstWeights, RunSpec
from qdgrasp_protocol.text import counted

RANKS_SHOWN = 10  # Grasps that are shown to a person
ETA_DIGITS = 4  # Their decimals, at most
RANKING_COLUMNS = (
    "rank", "eta", "eta_error", "trials", "nominal_fitness",
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


def best_of_kinds(rows: Rows, most: int, body: SceneObject, kinds: NDArray[np.int64] | None = None) -> Rows:
    """Return the best row of each kind, and of these the `most` best, best first.

    `kinds` (n,) are equal for rows of a kind; None: their 1 cm cells. `best_first` orders rows, by
    margins of their contacts with the object, which take some milliseconds each.
    """
    kinds = cell_keys(cells(rows["descriptor"][:, :3])) if kinds is None else kinds
    order = np.argsort(-rows["fitness"], kind="stable")
    _, first = np.unique(kinds[order], return_index=True)
    best = np.sort(rows["fitness"][order[first]])[-most:]
    decisive = rows["fitness"] >= best.min(initial=np.inf)  # no other row can be among the best
    rows, kinds = rows[decisive], kinds[decisive]
    order = best_first(rows, body, len(rows))
    _, first = np.unique(kinds[order], return_index=True)
    return rows[order[np.sort(first)]][:most]


def kinds_of_run(spec: RunSpec, rows: Rows, reader: GenomeReader) -> NDArray[np.int64] | None:
    """Return the kinds (n,) of rows for `best_of_kinds`, as the run's search told them apart.

    None: by their cells.
    """
    if spec.diversity in (None, "position"):
        return None
    keys = niches(rows, reader)
    return without_synergy(keys) if spec.diversity == "orientation" else keys


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
    shown = [[f"{round(value, ETA_DIGITS):g}" for value in line[:11]] for line in table[:RANKS_SHOWN]]
    text = aligned_text([RANKING_COLUMNS[:11], *shown])
    return f"{text}\n{counted(len(table), 'grasp')} ranked in {folder.path / RANKING}"


def rank_poses(folder: RunFolder) -> list[list[float]]:
    """Rank a run's poses, best first, ties in their order; each as in `RANKING_COLUMNS`.

    The greatest eta comes first. A pose that is no success any more has eta 0: it has no trials.
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
        *(etas, eta_error(etas, trials), trials, rows["fitness"]),
        [msgspec.structs.astuple(source.rows[place]) for place in range(len(rows))],
        *(cells(rows["descriptor"][:, :3]), rows["base_to_object"], settled),
        *(rows["penetration"], object_motion(rows)[:, 0] / MM, margins),
    )
    ordered = np.column_stack(columns)[np.lexsort((-etas, -trials))]
    return [[rank, *line] for rank, line in enumerate(ordered.tolist(), start=1)]


SAME_KEYS = ("aim_for", "nominal_protocol", "overlaps")
"""Keys of a spec that must be the same, so that touch and quality mean the same."""


class WarmStartRun(Struct, frozen=True):
    """A run whose journal weights were learned from."""

    run: str
    """Its folder."""
    rows: int
    """Rows that were in its journal then."""


class WarmStart(Struct, frozen=True):
    """Weights for a new run, and where they come from."""

    weights: FirstWeights
    runs: tuple[WarmStartRun, ...]

    @classmethod
    def learned(cls, spec: RunSpec, folders: Sequence[RunFolder]) -> "WarmStart":
        """Learn the weights that a run of `spec` begins with from other runs.

        Raises InputError where one is of another hand, or its search learned something else, or has no whole
        journal, or where all of them found too little; `FolderError` where a journal cannot be read.
        """
        if not learns_value(spec):
            raise InputError(
                "A warm start is for the method 'aimed' that aims for hold, eta or margin, by position, and "
                f"{search_words(spec)} learns no such value; leave --warm-start out."
            )
        for folder in folders:
            _check_alike(spec, folder)
        replayed = [_replayed(folder) for folder in folders]
        weights = learned_weights([search for search, _ in replayed])
        if weights == FirstWeights():
            raise InputError(
                f"{', '.join(str(folder.path) for folder in folders)} found too few successes or failures to "
                "learn from; go on with a run, or name others."
            )
        return cls(weights, tuple(origin for _, origin in replayed))

    @property
    def files(self) -> dict[str, bytes]:
        """The file of the new run's folder that names the runs which its weights were learned from."""
        return {ORIGIN: msgspec.json.encode({"runs": self.runs})}


def learned_weights(searches: Sequence[ValueSearch]) -> FirstWeights:
    """Return weights by what searches were told; None where that is too little."""
    return FirstWeights(**{name: _pooled(name, searches) for name in STARTS})


def replayed_search(spec: RunSpec, prepared: PreparedScene, blocks: Iterable[Rows]) -> ValueSearch:
    """Return a run's search, told its journal; raise ReplayError where it did not ask that."""
    search = ValueSearch(spec, search_space(prepared.scene, prior_of(spec)))
    plan = plan_run(spec, prepared, search=search)
    for rows in blocks:
        plan.pipeline.replay(rows)
    return search


def _check_alike(spec: RunSpec, folder: RunFolder) -> None:
    """Check that what a run learned means the same in a run of `spec`."""
    source = folder.spec
    if not learns_value(source):
        raise InputError(
            f"{folder.path} has learned no value that could be handed on: it is a run of "
            f"{search_words(source)}; name runs of 'aimed' that aim for {spec.aim_for} by position."
        )
    for key in SAME_KEYS:
        mine, its = getattr(spec, key), getattr(source, key)
        if mine != its:
            raise InputError(
                f"{folder.path} has {key.replace('nominal_', '')} '{its}' and this run '{mine}', so that it "
                "learned another value; name runs that agree in it."
            )
    hand, its_hand = find_gripper(spec.gripper).on_carrier(spec.nominal_protocol), folder.scene().gripper
    if hand != its_hand:
        raise InputError(
            f"{folder.path} is a run of the hand '{its_hand.name}' as its files were then, and this one is "
            f"of '{hand.name}' as they are: what was learned of one hand is not handed on to another."
        )


def _replayed(folder: RunFolder) -> tuple[ValueSearch, WarmStartRun]:
    try:
        with folder.journal() as journal:
            origin = WarmStartRun(str(folder.path.absolute()), journal.count)
            return replayed_search(folder.spec, folder.prepared_scene(), journal.blocks()), origin
    except ReplayError as error:
        raise InputError(f"{folder.path} cannot be learned from: {error}") from None


def _pooled(name: str, searches: Sequence[ValueSearch]) -> tuple[float, ...] | None:
    """Return weights of a model by the examples of all, as far as genes can hold them."""
    weights = pooled_weights([search.models[name] for search in searches], STARTS[name])
    if weights is None:
        return None
    return tuple(np.clip(weights, -STEEPEST_VALUE, STEEPEST_VALUE).tolist())
