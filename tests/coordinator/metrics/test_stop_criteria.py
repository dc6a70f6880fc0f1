"""Ends of a run besides its budget."""

import itertools
from dataclasses import replace

import msgspec
import numpy as np
import pytest
from tests.coordinator.scheduler.search_plans import FEW_CELLS, Plan, asked, reference
from tests.coordinator.scheduler.test_pipeline import journal, rows_in
from tests.fakes.job import Job

from qdgrasp_coordinator.metrics.run_stats import RunCounter, count_rows
from qdgrasp_coordinator.metrics.stop_criteria import StopCriteria
from qdgrasp_protocol.errors import ImpossibleValue
from qdgrasp_protocol.rows import Outcome, Rows
from qdgrasp_protocol.spec import RunSpec, differences, to_values

GOALS = (("successes", 1), ("successes", 9), ("no_new_cell", 1), ("no_new_cell", 6), ("no_new_cell", 20))
KINDS = {"population": (1, 7), "overlaps": ("count", "redraw"), "in_flight": (1, 2), "trials": (0, 2)}
PLANS = [
    Plan(evaluations=150, seed=seed, task=FEW_CELLS, **dict([*zip(KINDS, kind, strict=True), goal]))
    for seed, (*kind, goal) in enumerate(itertools.product(*KINDS.values(), GOALS))
]


@pytest.mark.parametrize("plan", PLANS, ids=str)
def test_a_run_ends_with_the_same_row_whatever_the_order_of_arrival(plan: Plan) -> None:
    expected = reference(plan)
    ended = plan.pipeline()
    assert journal(ended, 0, FEW_CELLS) == journal(plan.pipeline(), 1, FEW_CELLS) == expected
    assert ended.tally.evaluations < plan.evaluations
    assert ended.finished in (
        f"{plan.successes} successes are found",
        f"the last {plan.no_new_cell} evaluations found no new cell",
    )


@pytest.mark.parametrize(
    "plan",
    [pytest.param(plan, marks=pytest.mark.slow if plan.population == 1 else ()) for plan in PLANS[::3]],
    ids=str,
)
def test_any_recorded_beginning_goes_on_to_the_same_end(plan: Plan) -> None:
    expected = rows_in(reference(plan))
    for n in range(len(expected) + 1):
        pipeline = plan.pipeline()
        pipeline.replay(expected[: n // 2])
        pipeline.replay(expected[n // 2 : n])
        rest = []
        while len(rows := asked(pipeline, FEW_CELLS)):
            rest.append(pipeline.settle(rows[::-1]).rows.tobytes())
        assert b"".join(rest) == expected[n:].tobytes()


@pytest.mark.parametrize(
    "plan",
    [pytest.param(plan, marks=pytest.mark.slow if plan.population == 1 else ()) for plan in PLANS[::3]],
    ids=str,
)
def test_a_tally_of_the_journal_knows_that_the_run_is_over(plan: Plan) -> None:
    rows = rows_in(reference(plan))
    spec = spec_of(plan)
    total = counted(plan, rows, size=5)
    assert total.finished is not None
    total.check_budget(spec)
    assert counted(plan, rows[:-1], size=5).finished is None


def spec_of(plan: Plan) -> RunSpec:
    same = ("population", "evaluations", "overlaps", "successes", "no_new_cell")
    return RunSpec(gripper="hand", object="thing", **{name: getattr(plan, name) for name in same})


def counted(plan: Plan, rows: Rows, size: int) -> RunCounter:
    goals = StopCriteria(plan.successes, plan.no_new_cell)
    total = RunCounter(plan.evaluations, plan.overlaps, plan.trial_plan, goals)
    for first in range(0, len(rows), size):
        total.count(rows[first : first + size])
    return total


@pytest.mark.parametrize("goal", ["successes", "no_new_cell"])
def test_recorded_rows_allow_just_the_goals_whose_journals_begin_with_them(goal: str) -> None:
    plan = Plan(population=5, evaluations=60, seed=3, task=FEW_CELLS)
    asked_for = {n: replace(plan, **{goal: n}) for n in range(1, 14)}
    journals = {n: reference(one) for n, one in asked_for.items()}
    whole = rows_in(reference(plan))
    for n in range(len(whole) + 1):
        for number, one in asked_for.items():
            total = count_rows(spec_of(one), [whole[:n]])
            if journals[number].startswith(whole[:n].tobytes()):
                total.check_budget(spec_of(one))
            else:
                with pytest.raises(ImpossibleValue, match=f"^{goal} must be at least .* recorded"):
                    total.check_budget(spec_of(one))


def test_a_generation_that_trials_end_early_for_a_goal_is_not_extended() -> None:
    plan = Plan(population=7, evaluations=150, trials=2, successes=3, task=FEW_CELLS)
    rows = rows_in(reference(plan))
    assert rows["index"][rows["trial"] == 0][-1] < 6
    counted(plan, rows, 5).check_budget(spec_of(plan))
    longer = replace(plan, successes=30)
    with pytest.raises(ImpossibleValue, match="only whole generations can be extended"):
        counted(longer, rows, 5).check_budget(spec_of(longer))


@pytest.mark.parametrize("workers", [1, 2, 3])
def test_a_run_ends_with_the_same_row_with_any_number_of_workers(workers: int) -> None:
    plans = {
        "some": Plan(seed=1, population=9, evaluations=400, successes=20),
        "barren": Plan(seed=2, population=30, evaluations=400, no_new_cell=9, in_flight=2),
    }
    job = Job(dict(plans))
    job.carry_out(workers)
    assert job.journals() == {name: reference(plan) for name, plan in plans.items()}
    some = job.records["some"].rows
    assert np.count_nonzero(some["outcome"] >= Outcome.DROPPED) == 20
    assert some["outcome"][-1] >= Outcome.DROPPED


def test_a_run_without_goals_is_written_as_it_always_was() -> None:
    spec = RunSpec(gripper="hand", object="thing")
    assert not {"successes", "no_new_cell"} & set(to_values(spec))
    assert differences(spec, msgspec.structs.replace(spec, successes=5, no_new_cell=5)) == []
    assert differences(spec, msgspec.structs.replace(spec, seed=5)) == ["seed"]
