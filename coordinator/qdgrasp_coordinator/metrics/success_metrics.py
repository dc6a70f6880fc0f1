"""Figures of successes: fitness, growth, nu, eta, QD score and diversity, from rows.

Diversity counts different grasps, told apart by position, orientation and synergy. A series says
after how many counted evaluations each success was found.
"""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from msgspec import Struct
from numpy.typing import ArrayLike, NDArray

from qdgrasp_coordinator.metrics.cells import (
    NicheKeys,
    cell_keys,
    cell_of,
    cells,
    first_occurrences,
    without_orientation,
    without_synergy,
)
from qdgrasp_coordinator.metrics.reference_coverage import ReferenceSet
from qdgrasp_coordinator.metrics.successes import NO_TRIALS, Successes, TrialPlan, eta_error
from qdgrasp_protocol.rows import Outcome, Rows

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


ROUNDING = 1e-6  # Taken from every nu [rad]: where a prior ends at pi / 4, float32 goes beyond


def nu_angles(rows: Rows) -> NDArray[np.float64]:
    """Return nu of the rows that aim at a surface point, less `ROUNDING`: (m,) [rad], 0 to pi."""
    aimed = rows["nu"][rows["surface_point"].any(axis=1)].astype(np.float64)
    return np.clip(aimed - ROUNDING, 0.0, math.pi)


def cell_growth(found: Successes, least: Outcome = Outcome.DROPPED) -> StepSeries:
    """Distinct 1 cm cells with a success of at least this outcome."""
    chosen = found.rows["outcome"] >= least
    reached = cell_keys(cells(found.rows["descriptor"][chosen][:, :3]))
    return step_series(found.evaluations[chosen], first_occurrences(reached))


def reference_growth(
    found: Successes, reference: ReferenceSet, least: Outcome = Outcome.DROPPED
) -> StepSeries:
    """Distinct entries of a set that were found with at least this outcome."""
    chosen = found.rows["outcome"] >= least
    reached = cell_keys(cells(found.rows["base_to_object"][chosen][:, :3]))
    new = first_occurrences(reached) & np.isin(reached, cell_keys(reference.cells))
    return step_series(found.evaluations[chosen], new)


NU_BINS = 24  # Bins of nu from 0 to pi, 7.5 degrees each: six of them reach to pi / 4


class NuSummary(Struct, frozen=True, kw_only=True):
    """Lean of successes from the surface normal: their nu (Huber et al. 2024, eq. 1)."""

    bins: tuple[int, ...]
    """Successes in each of 24 equal bins from 0 to pi; the last one includes pi."""
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


class SuccessMetrics:
    """Sums over the successes of a journal, which are added some at a time."""

    def __init__(self, plan: TrialPlan = NO_TRIALS) -> None:
        self._plan = plan
        self._scored = [(np.zeros(0, np.int64), np.zeros(0), np.zeros(0, np.int64))]
        self._nu = np.zeros(NU_BINS, dtype=np.int64)

    def add(self, found: Successes) -> None:
        """Add successes; only those that have all of their trials have a score that counts."""
        self._nu += np.histogram(nu_angles(found.rows), bins=NU_BINS, range=(0.0, math.pi))[0]
        scored = found[~np.isnan(found.scores)]
        reached = cell_keys(cells(scored.rows["descriptor"][:, :3]))
        self._scored.append((reached, scored.scores, scored.trials))

    @property
    def qd_score(self) -> float:
        """QD score: over all cells with a success, the sum of the best fitness found in each."""
        reached, scores, _ = map(np.concatenate, zip(*self._scored, strict=True))
        order = np.lexsort((-scores, reached))
        return float(scores[order[np.unique(reached[order], return_index=True)[1]]].clip(min=0.0).sum())

    @property
    def mean_fitness(self) -> float | None:
        """Mean fitness of all successes that count; None without one."""
        return _mean(np.concatenate([scores for _, scores, _ in self._scored]))

    @property
    def eta(self) -> EtaSummary | None:
        """Eta of the successes; None for a protocol without trials."""
        if not self._plan.trials:
            return None
        _, scores, trials = map(np.concatenate, zip(*self._scored, strict=True))
        etas = self._plan.eta(scores)
        variance = _mean(eta_error(etas, trials) ** 2)
        return EtaSummary(
            successes=len(etas),
            mean=_mean(etas),
            best=float(etas.max()) if len(etas) else None,
            at_least_half=_mean(etas >= 0.5),
            error=None if variance is None else math.sqrt(variance / len(etas)),
            trials=_mean(trials),
        )

    @property
    def nu(self) -> NuSummary:
        """Nu of the successes that aim at a surface point."""
        aimed, near = int(self._nu.sum()), int(self._nu[: NU_BINS // 4].sum())
        return NuSummary(bins=tuple(self._nu.tolist()), below_quarter_pi=near / aimed if aimed else None)


def _mean(values: NDArray[Any]) -> float | None:
    return float(values.mean()) if len(values) else None


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


def diversity(keys: NicheKeys, outcomes: NDArray[np.integer]) -> Diversity:
    """Count the niches of successes (n,), which have such outcomes (n,)."""
    found = np.unique(keys)
    n = len(np.unique(cell_of(found)))
    return Diversity(
        niches=len(found),
        grasp_niches=len(np.unique(keys[outcomes >= Outcome.SHAKEN])),
        robust_niches=len(np.unique(keys[outcomes >= Outcome.HELD])),
        orientations=len(np.unique(without_synergy(found))) / n if n else None,
        synergies=len(np.unique(without_orientation(found))) / n if n else None,
    )
