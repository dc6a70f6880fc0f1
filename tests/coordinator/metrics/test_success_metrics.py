import math

import numpy as np
import pytest

from qdgrasp_coordinator.metrics.cells import MIDDLES
from qdgrasp_coordinator.metrics.niches import NicheArchive, SynergyReader
from qdgrasp_coordinator.metrics.scores import TrialPlan
from qdgrasp_coordinator.metrics.success_metrics import (
    SuccessMetrics,
    archive_growth,
    diversity,
)
from qdgrasp_protocol.rows import Gene, Layout, Outcome, Rows, RowShape

SHAPE = RowShape(genes=2, joints=1)


def rows(*outcomes: Outcome) -> Rows:
    made = SHAPE.empty(len(outcomes))
    made["outcome"] = outcomes
    made["fitness"] = np.maximum(np.array(outcomes, np.float32) - Outcome.DROPPED, 0)
    made["surface_point"] = 0.01
    return made


def counted(*blocks: Rows) -> SuccessMetrics:
    metrics = SuccessMetrics()
    for block in blocks:
        metrics.count(block)
    return metrics


def random_rows(n: int) -> Rows:
    random = np.random.default_rng(7)
    made = rows(*(Outcome(value) for value in random.integers(0, 8, n)))
    made["descriptor"] = random.uniform(-0.03, 0.03, (n, 3))
    made["nu"] = random.uniform(0, math.pi, n)
    return made


def test_the_qd_score_takes_the_best_fitness_of_each_cell_once() -> None:
    found = rows(Outcome.HELD, Outcome.SHAKEN, Outcome.SHAKEN, Outcome.DROPPED, Outcome.HELD)
    found["descriptor"][:, 0] = [0.1, 0.101, 0.2, 0.3, 0.099]
    assert counted(found).qd_score == 2 + 1 + 0
    assert counted(found, found[::-1]).qd_score == 3


def test_nu_from_0_to_pi_falls_into_18_bins_with_both_ends() -> None:
    found = rows(*[Outcome.DROPPED] * 4)
    found["nu"] = [0.0, math.pi, math.pi / 4 - 1e-3, math.pi / 4 + 1e-3]  # float32 pi is beyond pi
    lean = counted(found).nu
    assert (lean.bins[0], lean.bins[4], lean.bins[17], sum(lean.bins)) == (1, 2, 1, 4)
    assert lean.below_quarter_pi == 0.5


def test_successes_that_aim_at_no_surface_point_have_no_nu() -> None:
    found = rows(Outcome.HELD, Outcome.HELD)
    found["surface_point"][0] = 0
    found["nu"] = [0, 2]
    lean = counted(found).nu
    assert (sum(lean.bins), lean.below_quarter_pi) == (1, 0.0)


@pytest.mark.parametrize("size", [1, 7, 100])
def test_blocks_of_any_length_add_up_to_the_same(size: int) -> None:
    every = random_rows(400)
    whole, parts = counted(every), SuccessMetrics()
    passed = list(parts.counting(every[first : first + size] for first in range(0, 400, size)))
    assert np.concatenate(passed).tobytes() == every.tobytes()
    assert (parts.qd_score, parts.mean_fitness, parts.nu) == (whole.qd_score, whole.mean_fitness, whole.nu)
    assert whole.qd_score > 50


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
    metrics = SuccessMetrics(TrialPlan(10))
    metrics.count(with_trials(0, 7, 20, 13))
    assert metrics.qd_score == 7 + 20
    assert metrics.mean_fitness == 10
    assert metrics.eta is not None
    assert (metrics.eta.successes, metrics.eta.mean, metrics.eta.best) == (4, 0.5, 1.0)
    assert metrics.eta.at_least_half == 0.5


def test_a_success_counts_once_its_trials_are_recorded() -> None:
    metrics = SuccessMetrics(TrialPlan(10))
    journal = with_trials(4, 16)
    metrics.count(journal[:15])
    assert (metrics.successes, metrics.mean_fitness, metrics.qd_score) == (2, 4, 4)
    metrics.count(journal[15:])
    assert (metrics.successes, metrics.mean_fitness, metrics.qd_score) == (2, 10, 16)


NARROW_SHAPE = RowShape(genes=1, joints=1)
TWO = SynergyReader(Layout("contact", (Gene("synergy", 0.0, 1.0),)))


def closed_rows(*cells: int) -> Rows:
    made = NARROW_SHAPE.empty(len(cells))
    made["outcome"], made["base_to_object"][:, 3:] = Outcome.DROPPED, MIDDLES[0]
    made["descriptor"][:, 0] = np.array(cells) / 100
    return made


def archive(found: Rows, synergies: SynergyReader = TWO) -> NicheArchive:
    made = NicheArchive(synergies)
    made.insert(found)
    return made


def test_orientations_and_synergies_are_counted_in_the_cells_with_a_success() -> None:
    found = closed_rows(0, 0, 0, 0, 1)
    found["base_to_object"][1:3, 3:] = MIDDLES[[4, 5]]
    found["genome"][2:4, 0] = 1.0
    said = diversity(archive(found))
    assert said.niches == 5
    assert said.orientations == (3 + 1) / 2
    assert said.synergies == (2 + 1) / 2


def test_successes_and_their_cells_are_counted_along_the_nominal_rows() -> None:
    rows = RowShape(7, 2).empty(6)
    rows["outcome"] = Outcome.HELD
    rows["outcome"][[0, 2, 4]] = Outcome.MISSED, Outcome.DROPPED, Outcome.OVERLAP
    rows["descriptor"][:, 0] = [0.05, 0.01, 0.012, 0.03, 0.07, 0.09]
    rows["trial"] = [0, 0, 0, 0, 0, 1]
    found = archive_growth(rows)
    assert found.evaluations.tolist() == [0, 1, 2, 3, 4, 5, 5]
    assert found.successes.tolist() == [0, 0, 1, 2, 3, 3, 3]
    assert found.cells.tolist() == [0, 0, 1, 1, 2, 2, 2]
