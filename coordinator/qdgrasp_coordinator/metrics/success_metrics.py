"""Figures of successes: fitness, growth, nu, eta, QD score and diversity, from rows.

Diversity counts different grasps, told apart by position, orientation and synergy. A series or history says
after how many counted evaluations each success was found.
"""

import math
from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Self

import numpy as np
from msgspec import Struct
from numpy.typing import ArrayLike, NDArray

from qdgrasp_coordinator.metrics import niches
from qdgrasp_coordinator.metrics.cells import cell_keys, cells
from qdgrasp_coordinator.metrics.niches import NicheArchive, NicheKeys
from qdgrasp_coordinator.metrics.reference_coverage import ReferenceSet, ReleasedArchive
from qdgrasp_coordinator.metrics.run_stats import evaluation_mask, success_mask, successes
from qdgrasp_coordinator.metrics.scores import NO_TRIALS, TrialPlan, TrialSums, eta_error
from qdgrasp_protocol.rows import Outcome, Rows
from qdgrasp_protocol.spec import Overlaps

FITNESS_COLOURS = ("#bdb7ad", "#f2a431", "#2a73b9")
"""Of survival 0, 1 and 2; told apart with any colour vision, and by their lightness alone."""
FITNESS_WORDS = ("no disturbance survived", "some survived", "all survived")  # Of survival 0, 1, 2


@dataclass(frozen=True)
class StepSeries:
    """A number that changes at some of a run's evaluations; 0 at its beginning."""

    evaluations: NDArray[np.int64]
    """(n,), ascending: counted evaluations at which it changes."""
    totals: NDArray[np.int64]
    """(n,): what it is from there on."""

    def after(self, evaluations: ArrayLike) -> NDArray[np.int64]:
        """Return its values after so many counted evaluations."""
        place = np.searchsorted(self.evaluations, evaluations, side="right")
        return np.append(0, self.totals)[place]

    @property
    def end(self) -> int:
        """The last value."""
        return int(self.totals[-1]) if len(self.totals) else 0


def step_series(
    evaluations: NDArray[np.int64], changes: NDArray[np.integer] | NDArray[np.bool_]
) -> StepSeries:
    """Add `changes` (n,) up, each of which came with the counted evaluation of that number (n,)."""
    some = np.flatnonzero(changes)
    return StepSeries(evaluations[some], np.cumsum(changes[some], dtype=np.int64))


@dataclass(frozen=True)
class ArchiveGrowth:
    """Sums over the rows of a journal, before its first row and after each: (n + 1,)."""

    evaluations: NDArray[np.int64]
    """Counted evaluations."""
    successes: NDArray[np.int64]
    cells: NDArray[np.int64]
    """Distinct 1 cm cells with a success."""


def archive_growth(rows: Rows, overlaps: Overlaps = "count") -> ArchiveGrowth:
    """Sum along rows in journal order; trials above 0 add nothing."""
    success = success_mask(rows)
    places = np.flatnonzero(success)
    new = np.zeros(len(rows), dtype=bool)
    new[places] = first_occurrences(cell_keys(cells(rows["descriptor"][places, :3])))
    return ArchiveGrowth(
        *(np.cumsum(np.r_[0, steps]) for steps in (evaluation_mask(rows, overlaps), success, new))
    )


def first_occurrences(keys: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Flag the first occurrence of each number (n,): (n,)."""
    first = np.zeros(len(keys), dtype=bool)
    first[np.unique(keys, return_index=True)[1]] = True
    return first


ROUNDING = 1e-6  # Taken from every nu [rad]: where a prior ends at pi / 4, float32 goes beyond


def nu_angles(rows: Rows) -> NDArray[np.float64]:
    """Return nu of the rows that aim at a surface point, less `ROUNDING`: (m,) [rad], 0 to pi."""
    aimed = rows["nu"][rows["surface_point"].any(axis=1)].astype(np.float64)
    return np.clip(aimed - ROUNDING, 0.0, math.pi)


@dataclass(frozen=True)
class SuccessHistory:
    """The nominal successes of a run in journal order."""

    rows: Rows
    """(n,)."""
    evaluations: NDArray[np.int64]
    """(n,): counted evaluations so far, itself included."""

    @classmethod
    def among(cls, rows: Rows, overlaps: Overlaps, before: int = 0) -> Self:
        """The successes among rows in journal order, after so many counted evaluations."""
        evaluations = before + np.cumsum(evaluation_mask(rows, overlaps))
        success = success_mask(rows)
        return cls(rows[success], evaluations[success])

    @property
    def nu(self) -> NDArray[np.float64]:
        """(m,) [rad], 0 to pi: of those that aim at a surface point."""
        return nu_angles(self.rows)

    def cells(self, least: Outcome = Outcome.DROPPED) -> StepSeries:
        """Distinct 1 cm cells with a success of at least this outcome."""
        chosen = self.rows["outcome"] >= least
        descriptors = self.rows["descriptor"][chosen][:, :3]
        return step_series(self.evaluations[chosen], first_occurrences(cell_keys(cells(descriptors))))

    def found(self, reference: ReferenceSet, least: Outcome = Outcome.DROPPED) -> StepSeries:
        """Distinct entries of a set that were found with at least this outcome."""
        chosen = self.rows["outcome"] >= least
        reached = cell_keys(cells(self.rows["base_to_object"][chosen][:, :3]))
        new = first_occurrences(reached) & np.isin(reached, cell_keys(reference.cells))
        return step_series(self.evaluations[chosen], new)

    def published(self, reference: ReferenceSet, archive: ReleasedArchive) -> StepSeries:
        """Elites of the released code's archive in a set: each counts, and may be displaced."""
        positions = self.rows["base_to_object"][:, :3]
        shared = np.isin(cell_keys(cells(positions)), cell_keys(reference.cells))
        gains = _gains(archive.keys(positions), self.rows["fitness"], shared.astype(np.int64))
        return step_series(self.evaluations, gains)


def join_histories(found: Iterable[SuccessHistory], none: Rows) -> SuccessHistory:
    """The finds of several blocks in one."""
    parts = [SuccessHistory(none, np.zeros(0, np.int64)), *found]
    return SuccessHistory(
        np.concatenate([part.rows for part in parts]), np.concatenate([part.evaluations for part in parts])
    )


def _gains(
    cell: NDArray[np.int64], fitness: NDArray[np.number], worth: NDArray[np.int64]
) -> NDArray[np.int64]:
    """Return what each success (n,) adds to the worth of all elites: (n,).

    Its own worth, less that of the elite that it displaces; 0 if it does not become an elite.
    """
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


NU_SUMMARY_BINS = 18  # Bins of the nu histogram from 0 to pi: 10 degrees each
NEAR_NU = math.pi / 4  # The approach prior's nu_a (Huber et al. 2024, section III-A) [rad].


class NuSummary(Struct, frozen=True, kw_only=True):
    """Lean of successes from the surface normal: their nu (Huber et al. 2024, eq. 1)."""

    bins: tuple[int, ...]
    """Successes in each of 18 equal bins from 0 to pi; the last one includes pi."""
    below_quarter_pi: float | None
    """The share of successes with nu below pi / 4, 0 to 1; None without a success that has a nu."""

    @property
    def words(self) -> str:
        """The share for a person."""
        return "none" if self.below_quarter_pi is None else f"{self.below_quarter_pi:.1%} below pi/4"


class EtaSummary(Struct, frozen=True, kw_only=True):
    """Estimated probability, 0 to 1, that successes transfer (Huber et al. 2024, appendix B)."""

    successes: int
    """Successes with as many trials as every one has; the other figures are of these, else None."""
    mean: float | None
    best: float | None
    """Eta of the success whose lower bound is the greatest."""
    at_least_half: float | None
    """The share of them with an eta of at least 0.5, 0 to 1."""
    error: float | None = None
    """Standard error of the mean, for the number of trials alone."""
    trials: float | None = None
    """Mean number of trials of a success."""

    @property
    def words(self) -> str:
        """The figures for a person."""
        if self.mean is None or self.best is None or self.at_least_half is None:
            return "none"
        error = "" if self.error is None else f" +- {self.error:.3f}"
        trials = "" if self.trials is None else f"; {self.trials:.1f} trials each"
        half = f"{self.at_least_half:.1%} at least 0.5"
        return f"mean {self.mean:.3f}{error}, best {self.best:.3f}, {half}{trials}"


class ScoreCounts:
    """Numbers of successes by score and trials, and the best score of each cell."""

    def __init__(self) -> None:
        self.counts: Counter[tuple[float, int]] = Counter()
        self.best: dict[int, float] = {}

    def add(self, scored: Rows) -> None:
        """Add scored successes; see `TrialSums.take`."""
        scores = scored["fitness"].tolist()
        self.counts.update(zip(scores, scored["trial"].tolist(), strict=True))
        reached = cell_keys(cells(scored["descriptor"][:, :3])).tolist()
        for cell, score in zip(reached, scores, strict=True):
            self.best[cell] = max(score, self.best.get(cell, 0.0))

    def mean(self, values: Iterable[float]) -> float | None:
        """Return the mean over all successes of a value for each entry of `counts`.

        None without a success.
        """
        total = self.counts.total()
        pairs = zip(values, self.counts.values(), strict=True)
        return math.fsum(value * n for value, n in pairs) / total if total else None


class SuccessMetrics:
    """Sums over the successes of a journal, in any order; with trials, in its order."""

    successes: int = 0

    def __init__(self, plan: TrialPlan = NO_TRIALS) -> None:
        self._plan = plan
        self._trials = TrialSums(plan)
        self._scores = ScoreCounts()  # Of successes that have all of their trials
        self._bins = np.zeros(NU_SUMMARY_BINS, dtype=np.int64)
        self._near = 0

    def count(self, rows: Rows) -> None:
        """Count the next rows."""
        found = successes(rows)
        self.successes += len(found)
        angles = nu_angles(found)
        self._bins += np.histogram(angles, bins=NU_SUMMARY_BINS, range=(0.0, math.pi))[0]
        self._near += int(np.count_nonzero(angles < NEAR_NU))
        self._scores.add(self._trials.take(rows))

    def counting(self, blocks: Iterable[Rows]) -> Iterator[Rows]:
        """The same blocks, each counted as it passes."""
        for block in blocks:
            self.count(block)
            yield block

    @property
    def qd_score(self) -> float:
        """QD score: over all cells with a success, the sum of the best fitness found in each."""
        return math.fsum(self._scores.best.values())

    @property
    def mean_fitness(self) -> float | None:
        """Mean fitness of all successes that count; None without one."""
        found = self._scores
        return found.mean(score for score, _ in found.counts)

    @property
    def eta(self) -> EtaSummary | None:
        """Eta of the successes; None for a protocol without trials."""
        if not self._plan.trials:
            return None
        found = self._scores
        scores = np.array([score for score, _ in found.counts])
        trials = np.array([n for _, n in found.counts], np.int64)
        etas, total = self._plan.eta(scores), found.counts.total()
        variance = found.mean((eta_error(etas, trials) ** 2).tolist())
        return EtaSummary(
            successes=total,
            mean=found.mean(etas.tolist()),
            best=float(etas.max()) if total else None,
            at_least_half=found.mean((etas >= 0.5).astype(np.float64).tolist()),
            error=None if variance is None else math.sqrt(variance / total),
            trials=found.mean(trials.tolist()),
        )

    @property
    def nu(self) -> NuSummary:
        """Nu of the successes that aim at a surface point."""
        aimed = int(self._bins.sum())
        return NuSummary(
            bins=tuple(self._bins.tolist()), below_quarter_pi=self._near / aimed if aimed else None
        )


class Diversity(Struct, frozen=True, kw_only=True):
    """Occupied niches, and their number in a cell; None for a mean without a success."""

    niches: int
    """Niches with a success."""
    grasp_niches: int
    """Niches with a grasp, which survived some disturbance."""
    robust_niches: int
    """Niches with a robust grasp, which survived every disturbance."""
    orientations: float | None
    """Mean number of orientation bins with a success in a cell with one, 1 to 60."""
    synergies: float | None
    """Mean number of synergies with a success in a cell with one."""

    @property
    def words(self) -> str:
        """The figures for a person."""
        if self.orientations is None or self.synergies is None:
            return "none"
        return (
            f"{self.niches} niches, {self.grasp_niches} with a grasp, {self.robust_niches} robust; "
            f"{self.orientations:.2f} orientations and {self.synergies:.2f} synergies in a cell"
        )


def diversity(archive: NicheArchive) -> Diversity:
    """Count the niches of an archive."""
    elites = archive.elites
    keys: NicheKeys = elites["niche"]
    cells = len(np.unique(niches.cell_of(keys)))
    return Diversity(
        niches=len(keys),
        grasp_niches=int(np.count_nonzero(elites["outcome"] >= Outcome.SHAKEN)),
        robust_niches=int(np.count_nonzero(elites["outcome"] >= Outcome.HELD)),
        orientations=len(np.unique(niches.without_synergy(keys))) / cells if cells else None,
        synergies=len(np.unique(niches.without_orientation(keys))) / cells if cells else None,
    )
