"""Reads and chooses grasps of a run from its journal, some thousands at a time."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.lib.recfunctions import repack_fields
from numpy.typing import NDArray

from qdgrasp_assets.geometry.rotation import Floats
from qdgrasp_assets.scene import Scene
from qdgrasp_coordinator.metrics.arrays import join_rows, take_rows
from qdgrasp_coordinator.metrics.grasp_quality import NO_LIMITS, GraspLimits, takes_held
from qdgrasp_coordinator.metrics.scores import genome_numbers, scored_successes
from qdgrasp_coordinator.metrics.trial_schedule import TrialPlan
from qdgrasp_coordinator.storage.engine_table import TABLE, other_tables, verdicts
from qdgrasp_coordinator.storage.journal import Journal
from qdgrasp_coordinator.storage.run_folder import RunFolder, provenances
from qdgrasp_protocol.rows import Outcome, Rows
from qdgrasp_protocol.spec import RunSpec
from qdgrasp_tools.export.grasp_set import Grasps, join_grasps, select_grasps

if TYPE_CHECKING:
    from qdgrasp_assets.grippers.reachability import ReachabilityCheck


class KnownEtas(NamedTuple):
    """The scores of one source's successes with enough trials, in journal order."""

    genomes: NDArray[np.unsignedinteger]
    """(n,): their numbers (`genome_numbers`), ascending."""
    eta: Floats
    """(n,)."""
    trials: NDArray[np.integer]
    """(n,)."""


def read_run(folder: RunFolder, least: Outcome = Outcome.DROPPED) -> Grasps:
    """Read the nominal evaluations of a run that got as far as `least`, in journal order.

    The run may go on: what is recorded by now is read. `DROPPED` gives all successes, `MISSED` all that were
    simulated; a pruned or merged folder has kept successes alone. Raises FolderError if the folder cannot be
    read, or has no scene yet.
    """
    with folder.journal() as journal:
        reader = GraspReader(folder, journal)
        return join_grasps([reader.at(np.zeros(0, np.int64)), *reader.blocks(least)])


class GraspReader:
    """Reads the nominal evaluations of a run from its open journal, some thousands at a time.

    Raises FolderError if the folder cannot be read, or has no scene yet.
    """

    def __init__(self, folder: RunFolder, journal: Journal, engines: Iterable[str] = ()) -> None:
        """Read with verdicts in `engines`, unknown without a table, and in those of its tables."""
        no_table = np.zeros(0, TABLE)
        self._tables = dict.fromkeys(engines, no_table) | other_tables(folder)
        self.approach: ReachabilityCheck | None = None
        """How hands are to come to the grasps that are read; None: it is not asked for."""
        self.scene = folder.scene()
        self.spec = folder.spec
        self._journal = journal
        self._sources = tuple(provenances(folder, journal))
        self._etas: dict[int, KnownEtas] = {}

    def blocks(self, least: Outcome = Outcome.DROPPED) -> Iterator[Grasps]:
        """Yield those that got as far as `least`, in journal order."""
        for origin, source in enumerate(self._sources):
            first = source.rows.start
            for block in self._journal.kept(first, source.rows.stop) if source.rows else ():
                here = np.flatnonzero((block["trial"] == 0) & (block["outcome"] >= least))
                yield self._grasps(np.full(len(here), origin), first + here, take_rows(block, here))
                first += len(block)

    def at(self, numbers: NDArray[np.int64]) -> Grasps:
        """Read those with these numbers (n,) in the journal, in this order."""
        order = np.argsort(numbers, kind="stable")
        wanted, parts = numbers[order], [self._journal.shape.empty(0)]
        first = int(wanted[0]) if len(wanted) else 0
        for block in self._journal.kept(first, int(wanted[-1]) + 1) if len(wanted) else ():
            low, high = np.searchsorted(wanted, (first, first + len(block)))
            parts.append(take_rows(block, wanted[low:high] - first))
            first += len(block)
        rows = take_rows(join_rows(parts), np.argsort(order))
        stops = [source.rows.stop for source in self._sources]
        return self._grasps(np.searchsorted(stops, numbers, side="right"), numbers, rows)

    def _grasps(self, origins: NDArray[np.int64], numbers: NDArray[np.int64], rows: Rows) -> Grasps:
        etas, trials = np.full(len(rows), np.nan), np.zeros(len(rows), np.int64)
        for origin in np.unique(origins).tolist():
            known, here = self._known_etas(origin), np.flatnonzero(origins == origin)
            if not len(known.eta):
                continue
            mine = genome_numbers(take_rows(rows, here))
            places = np.minimum(np.searchsorted(known.genomes, mine), len(known.eta) - 1)
            is_known = known.genomes[places] == mine
            etas[here[is_known]] = known.eta[places[is_known]]
            trials[here[is_known]] = known.trials[places[is_known]]
        elsewhere = {name: verdicts(table, numbers, rows["outcome"]) for name, table in self._tables.items()}
        return Grasps(
            self.scene,
            self.spec,
            self._sources,
            origins,
            numbers,
            rows,
            etas,
            trials,
            elsewhere,
            self.approach,
        )

    def _known_etas(self, origin: int) -> KnownEtas:
        if origin not in self._etas:
            source, plan = self._sources[origin], TrialPlan.of(self._sources[origin].spec)
            blocks = self._journal.kept(source.rows.start, source.rows.stop) if source.rows else ()
            empty = self._journal.shape.empty(0)
            found = [
                (genome_numbers(rows), plan.eta(rows["fitness"]), rows["trial"])
                for rows in (empty, *(scored_successes(blocks, plan) if plan.stages else ()))
            ]
            self._etas[origin] = KnownEtas(*map(np.concatenate, zip(*found, strict=True)))
        return self._etas[origin]


PART_ROWS = 8192  # Grasps that are in memory at a time, with all their columns
CHOSEN = np.dtype([("number", "<i8"), ("confidence", "<f8"), ("is_success", "?"), ("is_settled", "?")])
RANKED_BY = (
    "generation", "index", "outcome", "fitness", "base_to_object", "contacts", "penetration", "settled",
    "contact_links", "contact_points",
)  # fmt: skip
"""Columns that grasps are ranked and spread by."""
NO_APPROACH = (None, None, 0.0, None)
ALL_FAILURES = -1  # So many failures as there are


@dataclass(frozen=True)
class GraspChoice:
    """Flags that say which grasps of a run are taken; see `select_grasps`."""

    min_fitness: int | None = None
    """None: by the protocol of each run (`taken_mask`)."""
    min_quality: float = 0.0
    """Least confidence, 0 to 1."""
    top: int | None = None
    diverse: int | None = None
    limits: GraspLimits = NO_LIMITS
    holds_in: str | None = None
    approach_distance: float | None = None
    """Distance from which hands come to their poses, touching nothing [m]; None: as in the run."""
    resting_pose: int | str | None = None
    """How the object rests on a table that they come above, or "any"; None: as in the run."""

    def reachability(self, scene: Scene, spec: RunSpec) -> "ReachabilityCheck | None":
        """Return the check of how hands come to grasps; None: neither flags nor the run ask for it."""
        if (self.approach_distance, self.resting_pose, spec.approach, spec.table_pose) == NO_APPROACH:
            return None
        from qdgrasp_assets.grippers.reachability import ReachabilityCheck  # scipy takes its time

        return ReachabilityCheck.asked(scene, spec, self.approach_distance, self.resting_pose)


@dataclass(frozen=True, eq=False)
class ChosenGrasps:
    """Grasps that were chosen from a run, read part by part each time they are iterated."""

    reader: GraspReader
    index: NDArray[np.void]
    """(n,), of `CHOSEN`, in the order in which they are written."""
    failures: int
    """The last so many are failures."""
    min_fitness: int
    """The others have this fitness or more."""
    unknown: int = 0
    """Grasps that were left out as their verdict in the engine that is asked for is not known."""

    def __len__(self) -> int:
        return len(self.index)

    def __iter__(self) -> Iterator[Grasps]:
        return self.after(0)

    def after(self, count: int) -> Iterator[Grasps]:
        """Yield those behind the first so many, part by part."""
        for first in range(count, len(self), PART_ROWS):
            yield self.reader.at(self.index["number"][first : first + PART_ROWS])

    @property
    def whole(self) -> Grasps:
        """All of them in memory."""
        return self.reader.at(self.index["number"])

    @property
    def best(self) -> float | None:
        """The best confidence; None: there is no grasp."""
        grasps = self.index["confidence"][: len(self) - self.failures]  # failures stand behind them
        return float(grasps.max()) if len(grasps) else None

    @property
    def scene(self) -> Scene:
        """The scene of the run."""
        return self.reader.scene

    @property
    def spec(self) -> RunSpec:
        """The spec of the run's folder."""
        return self.reader.spec

    @property
    def approach(self) -> "ReachabilityCheck | None":
        """Check of the hands' ways to grasps; None: it was not asked for."""
        return self.reader.approach

    @property
    def is_success(self) -> NDArray[np.bool_]:
        """(n,): as of `Grasps`."""
        return np.asarray(self.index["is_success"])

    @property
    def is_settled(self) -> NDArray[np.bool_]:
        """(n,): as of `Grasps`."""
        return np.asarray(self.index["is_settled"])


def choose_grasps(reader: GraspReader, choice: GraspChoice, failures: int = 0) -> ChosenGrasps:
    """Choose grasps of a run as `select_grasps` does, without holding its rows in memory.

    Behind them stand failures, evaluations that were no grasps: at most so many, spread over the journal.
    """
    is_ranked = choice.top is not None or choice.diverse is not None
    unknown, least = 0, choice.min_fitness
    if least is None:
        least = reader.spec.disturbances if takes_held(reader.spec) else 1
    reader.approach = choice.reachability(reader.scene, reader.spec)
    good, bad, ranked = [np.zeros(0, CHOSEN)], [np.zeros(0, CHOSEN)], []
    for block in reader.blocks(Outcome.MISSED if failures else Outcome.DROPPED):
        found = select_grasps(
            block,
            choice.min_fitness,
            limits=choice.limits,
            holds_in=choice.holds_in,
            approach=reader.approach,
        )
        if choice.holds_in is not None:
            every = select_grasps(block, choice.min_fitness)
            unknown += int((every.verdicts_in(choice.holds_in) < 0).sum())
        found = found[found.confidence >= choice.min_quality]
        least = int(found.fitness.min(initial=least))  # a custom evaluator's grasps may hold with less
        if is_ranked:
            names = [name for name in RANKED_BY if name in (found.rows.dtype.names or ())]
            ranked.append(replace(found, rows=repack_fields(found.rows[names])))
        else:
            good.append(_index(found))
        if failures:
            bad.append(_index(block[~block.is_grasp]))
    if ranked:
        good.append(_index(select_grasps(join_grasps(ranked), 0, choice.top, choice.diverse)))
    chosen, others = np.concatenate(good), np.concatenate(bad)
    if failures and least < 1:
        others = others[~np.isin(others["number"], chosen["number"])]
    if failures != ALL_FAILURES and failures < len(others):
        others = others[np.linspace(0, len(others) - 1, failures).round().astype(np.int64)]
    return ChosenGrasps(reader, np.concatenate([chosen, others]), len(others), least, unknown)


def _index(grasps: Grasps) -> NDArray[np.void]:
    index = np.zeros(len(grasps), CHOSEN)
    for name in CHOSEN.names or ():
        index[name] = grasps.numbers if name == "number" else getattr(grasps, name)
    return index
