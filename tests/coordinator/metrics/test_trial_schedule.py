"""Successes that are promoted to more trials, and scores of few trials."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from tests.coordinator.scheduler.search_plans import Plan, reference
from tests.coordinator.scheduler.test_pipeline import PLANS, rows_in

from qdgrasp_coordinator.metrics.run_stats import RunCounter
from qdgrasp_coordinator.metrics.trial_schedule import TrialPlan, TrialSchedule, eta_bounds, eta_error
from qdgrasp_protocol.rows import Outcome, Rows, RowShape

SHAPE = RowShape(genes=1, joints=1)
STAGES = (10, 30, 100)


def generation(*cells: int, number: int = 0) -> Rows:
    """Nominal rows of successes in these cells."""
    rows = SHAPE.empty(len(cells))
    rows["generation"], rows["index"], rows["outcome"] = number, np.arange(len(cells)), Outcome.HELD
    rows["descriptor"][:, 0] = np.array(cells) / 100
    return rows


def trials(first: int, last: int, **shares: float) -> Rows:
    """Trials first to last of the rows of these indices, a share of whose two shakes is survived."""
    parts = []
    for index, share in shares.items():
        rows = SHAPE.empty(last - first + 1)
        rows["index"], rows["trial"], rows["fitness"] = int(index[1:]), np.arange(first, last + 1), 2 * share
        parts.append(rows)
    return np.concatenate(parts)


def promoted(*blocks: Rows, finalists: int | None = None) -> list[int]:
    schedule = TrialSchedule(TrialPlan(STAGES, finalists=finalists))
    for block in blocks:
        schedule.count(block)
    return schedule.promoted.tolist()


def test_a_success_that_is_alone_in_its_cell_has_the_first_trials_only() -> None:
    assert promoted(generation(1, 2, 3), trials(1, 10, _0=1.0, _1=0.5, _2=0.0)) == []


def test_of_two_in_a_cell_those_have_more_trials_that_may_be_the_better_one() -> None:
    found, first = generation(1, 1, 2), trials(1, 10, _0=0.9, _1=0.8, _2=0.9)
    assert promoted(found, first) == [0, 1]
    assert promoted(found, trials(1, 10, _0=0.9, _1=0.2, _2=0.9)) == [0]
    assert promoted(found, first, trials(11, 30, _0=0.95, _1=0.4)) == [0]
    assert promoted(found, first, trials(11, 30, _0=0.9, _1=0.9)) == [0, 1]
    assert promoted(found, first, trials(11, 30, _0=0.9, _1=0.9), trials(31, 100, _0=1, _1=0)) == []


@pytest.mark.parametrize("share", [0.0, 0.4, 0.5, 1.0])
def test_equals_are_promoted_together(share: float) -> None:
    found, first = generation(1, 1, 1), trials(1, 10, _0=share, _1=share, _2=share)
    assert promoted(found, first) == promoted(found, first, finalists=1) == [0, 1, 2]


@pytest.mark.parametrize(("elder", "expected"), [(0.5, [0]), (1.0, [])])
def test_a_later_success_competes_with_the_best_one_of_its_cell_so_far(elder: float, expected) -> None:
    before = generation(1, 2), trials(1, 10, _0=elder, _1=1.0)
    assert promoted(*before, generation(1, 3, number=1), trials(1, 10, _0=0.5, _1=0.5)) == expected


def test_of_finalists_as_many_are_sought_as_are_wanted_whatever_their_cells() -> None:
    found, first = generation(1, 2, 3, 4), trials(1, 10, _0=0.9, _1=0.1, _2=0.8, _3=0.2)
    assert promoted(found, first, finalists=2) == [0, 2]
    assert promoted(found, first, finalists=4) == promoted(found, first, finalists=5) == [0, 1, 2, 3]
    later = generation(5, 6, number=1), trials(1, 10, _0=0.3, _1=0.8)
    assert promoted(found, trials(1, 10, _0=0.9, _1=0.0, _2=0.9, _3=0.0), finalists=1) == [0, 2]
    some = trials(11, 30, _0=0.9, _2=0.8), trials(31, 100, _0=0.9, _2=0.8)
    assert promoted(found, first, *some, *later, finalists=2) == [1]


@pytest.mark.parametrize("plan", [plan for plan in PLANS if plan.few], ids=str)
@pytest.mark.parametrize("size", [1, 7, 1000])
def test_a_journal_is_complete_with_its_last_row_in_blocks_of_any_length(plan: Plan, size: int) -> None:
    rows = rows_in(reference(plan))
    counter = RunCounter(plan.evaluations, plan.overlaps, plan.trial_plan)
    for first in range(0, len(rows), size):
        assert counter.finished is None
        counter.count(rows[first : first + size])
    assert counter.finished == f"the budget of {plan.evaluations} evaluations is spent"
    assert len(counter.promoted) == 0


def test_a_nominal_success_that_ends_a_run_is_followed_by_its_trials() -> None:
    schedule = TrialSchedule(TrialPlan(STAGES))
    schedule.count(generation(1))
    assert not schedule.is_complete
    schedule.count(trials(1, 9, _0=1.0))
    assert not schedule.is_complete
    schedule.count(trials(10, 10, _0=1.0))
    assert schedule.is_complete


@given(st.lists(st.floats(0, 1), min_size=1), st.sampled_from(STAGES))
def test_bounds_hold_the_estimate_and_close_up_with_more_trials(values: list[float], n: int) -> None:
    etas, counts = np.array(values), np.full(len(values), n)
    low, high = eta_bounds(etas, counts)
    assert (low <= etas).all()
    assert (etas <= high).all()
    closer = eta_bounds(etas, 10 * counts)
    assert (closer[1] - closer[0] < high - low).all()


def test_the_error_of_eta_is_that_of_drawn_shares_at_most() -> None:
    shares = np.random.default_rng(0).binomial(1, 0.3, (4000, 10)) / 1.0
    assert np.std(shares.mean(axis=1)) == pytest.approx(
        np.sqrt((eta_error(shares.mean(axis=1), np.full(4000, 10)) ** 2).mean()), rel=0.05
    )
    assert np.isnan(eta_error(np.array([0.5, 0.5]), np.array([0, 1]))).all()


def test_scores_of_few_trials_are_on_the_scale_of_all() -> None:
    plan = TrialPlan(STAGES, disturbances=6)
    scores = plan.scores(np.array([54, 162, 540, 0]), np.array([10, 30, 100, 0]))
    assert scores.tolist() == [540, 540, 540, 0]
    assert plan.eta(scores).tolist() == [0.9, 0.9, 0.9, 0]
