"""Ends of a run besides its budget."""

import itertools
from contextlib import nullcontext
from dataclasses import replace

import numpy as np
import pytest
from tests.coordinator.recorded_runs import random_rows
from tests.coordinator.scheduler.search_plans import FEW_CELLS, Plan, asked, brief_spec, reference
from tests.coordinator.scheduler.test_pipeline import journal, rows_in

from qdgrasp_coordinator.metrics.run_stats import RunCounter
from qdgrasp_protocol.errors import ReplayError
from qdgrasp_protocol.rows import Outcome, Rows

GOALS = (("grasps", 1), ("grasps", 7), ("saturation", 0.9), ("saturation", 0.7))
KINDS = {"population": (1, 7), "overlaps": ("count", "redraw"), "in_flight": (1, 2), "trials": (0, 2)}
PLANS = [
    Plan(evaluations=300, seed=seed, task=FEW_CELLS, **dict([*zip(KINDS, kind, strict=True), goal]))
    for seed, (*kind, goal) in enumerate(itertools.product(*KINDS.values(), GOALS))
]


@pytest.mark.parametrize("plan", PLANS, ids=str)
def test_a_run_ends_with_the_same_row_whatever_the_order_of_arrival(plan: Plan) -> None:
    expected = reference(plan)
    ended = plan.pipeline()
    assert journal(ended, 0, FEW_CELLS) == journal(plan.pipeline(), 1, FEW_CELLS) == expected
    assert ended.tally.evaluations < plan.evaluations
    assert ended.finished in (
        f"{plan.grasps} grasps are found",
        "it is saturated: the last 20 simulated evaluations found little new",
    )


@pytest.mark.parametrize("plan", [plan for plan in PLANS if plan.grasps], ids=str)
def test_a_run_ends_with_the_very_row_that_reaches_its_goal(plan: Plan) -> None:
    rows = rows_in(reference(plan))
    rows = rows[rows["trial"] == 0]
    assert np.count_nonzero(rows["outcome"] >= Outcome.SHAKEN) == plan.grasps
    assert rows["outcome"][-1] >= Outcome.SHAKEN


some_plans = pytest.mark.parametrize(
    "plan",
    [pytest.param(plan, marks=pytest.mark.slow if plan.population == 1 else ()) for plan in PLANS[::3]],
    ids=str,
)


@some_plans
def test_any_recorded_beginning_goes_on_to_the_same_end(plan: Plan) -> None:
    expected = rows_in(reference(plan))
    for n in range(0, len(expected) + 1, 9):
        pipeline = plan.pipeline()
        pipeline.replay(expected[: n // 2])
        pipeline.replay(expected[n // 2 : n])
        rest = []
        while len(rows := asked(pipeline, FEW_CELLS)):
            rest.append(pipeline.settle(rows[::-1]).rows.tobytes())
        assert b"".join(rest) == expected[n:].tobytes()


VALUES = {
    "grasps": range(1, 14),
    "saturation": np.linspace(0.3, 0.95, 14).tolist(),
}


@pytest.mark.parametrize(("goal", "values"), VALUES.items())
def test_recorded_rows_replay_just_to_the_goals_whose_journals_begin_with_them(goal: str, values) -> None:
    plan = Plan(population=5, evaluations=60, seed=3, task=FEW_CELLS)
    asked_for = {n: replace(plan, **{goal: n}) for n in values}
    journals = {n: reference(one) for n, one in asked_for.items()}
    whole = rows_in(reference(plan))
    for n in range(0, len(whole) + 1, 4):
        for number, one in asked_for.items():
            fits = journals[number].startswith(whole[:n].tobytes())
            with nullcontext() if fits else pytest.raises(ReplayError, match="goes on after its row"):
                one.pipeline().replay(whole[:n])


def rows_that_find(new: list[bool]) -> Rows:
    """Simulated rows, each of which finds a cell of its own with a grasp, or misses."""
    rows = random_rows(len(new))
    rows["outcome"] = np.where(new, Outcome.HELD, Outcome.MISSED)
    rows["descriptor"][:, 0] = np.arange(len(new)) / 100
    return rows


def evaluations_until_stop(new: list[bool]) -> int | None:
    """Number of these rows in a run that ends at a saturation of 0.1; None: all."""
    counter = RunCounter(brief_spec(evaluations=10**6, overlaps="redraw", saturation=0.1))
    rows = rows_that_find(new)
    until = counter.rows_until_stop(rows)
    counter.count(rows[:until])
    return until if counter.finished else None


def test_an_object_is_saturated_when_the_last_thousand_evaluations_found_next_to_nothing() -> None:
    # the first at which (50 + 1) / 1000 is at most 0.1 x 1000 / 1950
    assert evaluations_until_stop([True] * 1000 + [False] * 5000) == 1950
    assert evaluations_until_stop([True] * 1000 + [False, False, True] * 5000) is None
