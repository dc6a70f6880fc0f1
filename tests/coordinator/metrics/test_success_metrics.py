import math

import numpy as np

from qdgrasp_coordinator.metrics.cells import MIDDLES, GenomeReader, niches
from qdgrasp_coordinator.metrics.success_metrics import SuccessMetrics, cell_growth, diversity
from qdgrasp_coordinator.metrics.successes import TrialPlan, all_successes, find_successes
from qdgrasp_protocol.rows import Gene, Layout, Outcome, Rows, RowShape

SHAPE = RowShape(genes=2, joints=1)


def rows(*outcomes: Outcome) -> Rows:
    made = SHAPE.empty(len(outcomes))
    made["outcome"] = outcomes
    made["fitness"] = np.maximum(np.array(outcomes, np.float32) - Outcome.DROPPED, 0)
    made["surface_point"] = 0.01
    return made


def counted(*blocks: Rows) -> SuccessMetrics:
    return counted_with(TrialPlan(), *blocks)


def counted_with(plan: TrialPlan, *blocks: Rows) -> SuccessMetrics:
    metrics = SuccessMetrics(plan)
    for part in find_successes(blocks, plan):
        metrics.add(part)
    return metrics


def test_the_qd_score_takes_the_best_fitness_of_each_cell_once() -> None:
    found = rows(Outcome.HELD, Outcome.SHAKEN, Outcome.SHAKEN, Outcome.DROPPED, Outcome.HELD)
    found["descriptor"][:, 0] = [0.1, 0.101, 0.2, 0.3, 0.099]
    assert counted(found).qd_score == 2 + 1 + 0
    assert counted(found, found[::-1]).qd_score == 3


def test_nu_from_0_to_pi_falls_into_24_bins_with_both_ends() -> None:
    found = rows(*[Outcome.DROPPED] * 4)
    found["nu"] = [0.0, math.pi, math.pi / 4 - 1e-3, math.pi / 4 + 1e-3]  # float32 pi is beyond pi
    lean = counted(found).nu
    assert (lean.bins[0], lean.bins[5], lean.bins[6], lean.bins[23], sum(lean.bins)) == (1, 1, 1, 1, 4)
    assert lean.below_quarter_pi == 0.5


def with_trials(*sums: int, trials: int = 10) -> Rows:
    """A generation of successes whose trials survive so many shakes in sum."""
    nominal = rows(*[Outcome.HELD] * len(sums))
    nominal["index"] = np.arange(len(sums))
    nominal["descriptor"][:, 0] = np.arange(len(sums)) // 2 / 100  # two to a cell
    again = np.repeat(nominal, trials)
    again["trial"] = np.tile(np.arange(1, trials + 1), len(sums))
    again["fitness"] = [min(2, max(0, total - 2 * k)) for total in sums for k in range(trials)]
    return np.concatenate([nominal, again])


def test_with_trials_fitness_is_the_sum_over_them() -> None:
    metrics = counted_with(TrialPlan(10), with_trials(0, 7, 20, 13))
    assert metrics.qd_score == 7 + 20
    assert metrics.mean_fitness == 10
    assert metrics.eta is not None
    assert (metrics.eta.successes, metrics.eta.mean, metrics.eta.best) == (4, 0.5, 1.0)
    assert metrics.eta.at_least_half == 0.5


def test_a_success_counts_once_its_trials_are_recorded() -> None:
    journal = with_trials(4, 16)
    for known, fitness, score in ((15, 4, 4), (22, 10, 16)):
        metrics = counted_with(TrialPlan(10), journal[:known])
        assert (metrics.mean_fitness, metrics.qd_score) == (fitness, score)


NARROW_SHAPE = RowShape(genes=1, joints=1)
TWO = GenomeReader(Layout("contact", (Gene("synergy", 0.0, 1.0),)))


def closed_rows(*cells: int) -> Rows:
    made = NARROW_SHAPE.empty(len(cells))
    made["outcome"], made["base_to_object"][:, 3:] = Outcome.DROPPED, MIDDLES[0]
    made["descriptor"][:, 0] = np.array(cells) / 100
    return made


def test_orientations_and_synergies_are_counted_in_the_cells_with_a_success() -> None:
    found = closed_rows(0, 0, 0, 0, 1)
    found["base_to_object"][1:3, 3:] = MIDDLES[[4, 5]]
    found["genome"][2:4, 0] = 1.0
    said = diversity(niches(found, TWO), found["outcome"])
    assert said.niches == 5
    assert said.orientations == (3 + 1) / 2
    assert said.synergies == (2 + 1) / 2


def test_successes_and_their_cells_are_counted_along_the_nominal_rows() -> None:
    rows = RowShape(7, 2).empty(6)
    rows["outcome"] = Outcome.HELD
    rows["outcome"][[0, 2, 4]] = Outcome.MISSED, Outcome.DROPPED, Outcome.OVERLAP
    rows["descriptor"][:, 0] = [0.05, 0.01, 0.012, 0.03, 0.07, 0.09]
    rows["trial"] = [0, 0, 0, 0, 0, 1]
    found = all_successes(rows)
    assert found.numbers.tolist() == [1, 2, 3]
    assert found.evaluations.tolist() == [2, 3, 4]
    grown = cell_growth(found)
    assert (grown.evaluations.tolist(), grown.totals.tolist()) == ([2, 4], [1, 2])
