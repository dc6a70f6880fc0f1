"""Ends of a run besides its budget."""

import itertools
from dataclasses import replace

import msgspec
import numpy as np
import pytest
from tests.coordinator.recorded_runs import random_rows
from tests.coordinator.scheduler.search_plans import FEW_CELLS, Plan, asked, reference
from tests.coordinator.scheduler.test_pipeline import journal, rows_in
from tests.fakes.job import Job

from qdgrasp_coordinator.metrics.cells import orientations
from qdgrasp_coordinator.metrics.run_stats import RunCounter
from qdgrasp_coordinator.metrics.stop_criteria import NicheRate, StopCriteria
from qdgrasp_protocol.errors import ImpossibleValue
from qdgrasp_protocol.rows import Outcome, Rows
from qdgrasp_protocol.spec import GOAL_KEYS, RunSpec, differences, to_values

GOALS = (
    *(("successes", 1), ("successes", 9), ("grasps", 7)),
    *(("no_new_cell", 1), ("no_new_cell", 6), ("no_new_cell", 20), ("saturation", 0.9)),
)
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
        f"{plan.successes} successes are found",
        f"{plan.grasps} grasps are found",
        f"the last {plan.no_new_cell} evaluations found no new cell",
        "it is saturated: the last 20 simulated evaluations found little new",
    )


some_plans = pytest.mark.parametrize(
    "plan",
    [pytest.param(plan, marks=pytest.mark.slow if plan.population == 1 else ()) for plan in PLANS[::3]],
    ids=str,
)


@some_plans
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


@some_plans
def test_a_tally_of_the_journal_knows_that_the_run_is_over(plan: Plan) -> None:
    rows = rows_in(reference(plan))
    spec = spec_of(plan)
    total = counted(plan, rows, size=5)
    assert total.finished is not None
    total.check_budget(spec)
    assert counted(plan, rows[:-1], size=5).finished is None


def spec_of(plan: Plan) -> RunSpec:
    same = ("population", "evaluations", "overlaps", *GOAL_KEYS)
    return RunSpec(gripper="hand", object="thing", **{name: getattr(plan, name) for name in same})


def counted(plan: Plan, rows: Rows, size: int) -> RunCounter:
    total = RunCounter(plan.evaluations, plan.overlaps, plan.trials, plan.goals)
    for first in range(0, len(rows), size):
        total.count(rows[first : first + size])
    return total


VALUES = {
    "successes": range(1, 14),
    "grasps": range(1, 14),
    "no_new_cell": range(1, 14),
    "saturation": np.linspace(0.3, 0.95, 14).tolist(),
}


@pytest.mark.parametrize(("goal", "values"), VALUES.items())
def test_recorded_rows_allow_just_the_goals_whose_journals_begin_with_them(goal: str, values) -> None:
    plan = Plan(population=5, evaluations=60, seed=3, task=FEW_CELLS)
    asked_for = {n: replace(plan, **{goal: n}) for n in values}
    journals = {n: reference(one) for n, one in asked_for.items()}
    whole = rows_in(reference(plan))
    for n in range(len(whole) + 1):
        for number, one in asked_for.items():
            total = counted(one, whole[:n], size=7)
            if journals[number].startswith(whole[:n].tobytes()):
                total.check_budget(spec_of(one))
            else:
                words = f"^{goal} must be (at least|less than) .* recorded"
                with pytest.raises(ImpossibleValue, match=words):
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


def grasping_rows(n: int, seed: int = 0) -> Rows:
    """Nominal rows of all outcomes in few cells, with hands turned anyhow."""
    rows = random_rows(n, seed, reach=0.02)
    rows["base_to_object"][:, 3:] = np.random.default_rng(seed).normal(size=(n, 4))
    return rows


def shares_by_hand(rows: Rows, window: int, *, by_orientation: bool) -> list[float]:
    """The rate of new niches lately, over that of all, at each row; counted anew for each."""
    found = []
    for n in range(1, len(rows) + 1):
        simulated = rows[:n][rows["outcome"][:n] >= Outcome.MISSED]
        niches: list[tuple[int, ...] | None] = []
        for row in simulated:
            cell = np.rint(np.float64(row["descriptor"]) * 100).astype(int)
            kind = orientations(row["base_to_object"][None, 3:]) if by_orientation else [0]
            niche = (*cell.tolist(), int(kind[0])) if row["outcome"] >= Outcome.SHAKEN else None
            niches.append(None if niche in niches else niche)
        new = np.array([niche is not None for niche in niches])
        long_enough = len(new) >= window
        mean = new.sum() / len(new) if long_enough else 0.0
        found.append((new[-window:].sum() + 1) / window / (mean or 1 / len(new)) if long_enough else np.inf)
    return found


@pytest.mark.parametrize("by_orientation", [False, True])
@pytest.mark.parametrize("size", [1, 7, 20, 150])
def test_the_rate_of_niches_is_that_of_a_count_by_hand_in_blocks_of_any_size(size, by_orientation) -> None:
    rows = grasping_rows(150)
    counted_so_far = NicheRate(20, by_orientation=by_orientation)
    found: list[float] = []
    for first in range(0, len(rows), size):
        block = rows[first : first + size]
        found += counted_so_far.shares(block).tolist()
        counted_so_far.count(block)
        assert counted_so_far.share == found[-1]
        assert counted_so_far.least == min([np.inf, *found[:-1]])
    np.testing.assert_allclose(found, shares_by_hand(rows, 20, by_orientation=by_orientation))


def test_orientations_in_a_cell_are_niches_where_the_search_looks_for_them() -> None:
    spec = RunSpec(gripper="hand", object="thing", saturation=0.1)
    told_apart = {
        kind: StopCriteria.of(msgspec.structs.replace(spec, diversity=kind)).by_orientation
        for kind in (None, "position", "orientation", "posture")
    }
    assert told_apart == {None: False, "position": False, "orientation": True, "posture": True}
    assert StopCriteria.of(msgspec.structs.replace(spec, saturation=0.0)) == StopCriteria()


def rows_that_find(new: list[bool]) -> Rows:
    """Simulated rows, each of which finds a cell of its own with a grasp, or misses."""
    rows = random_rows(len(new))
    rows["outcome"] = np.where(new, Outcome.HELD, Outcome.MISSED)
    rows["descriptor"][:, 0] = np.arange(len(new)) / 100
    return rows


def evaluations_until_stop(new: list[bool]) -> int | None:
    """Number of these rows in a run that ends at a saturation of 0.1; None: all."""
    counter = RunCounter(10**6, "redraw", goals=StopCriteria(saturation=0.1))
    rows = rows_that_find(new)
    until = counter.rows_until_stop(rows)
    counter.count(rows[:until])
    return until if counter.finished else None


def test_an_object_is_saturated_when_the_last_thousand_evaluations_found_next_to_nothing() -> None:
    # the first at which (50 + 1) / 1000 is at most 0.1 x 1000 / 1950
    assert evaluations_until_stop([True] * 1000 + [False] * 5000) == 1950
    assert evaluations_until_stop([True] * 1000 + [False, False, True] * 5000) is None


def test_an_object_with_few_grasps_goes_on_to_its_budget() -> None:
    assert evaluations_until_stop([False] * 20_000) is None
    assert evaluations_until_stop(([True] + [False] * 1500) * 12) is None


def test_a_run_without_goals_is_written_as_it_always_was() -> None:
    spec = RunSpec(gripper="hand", object="thing")
    assert not set(GOAL_KEYS) & set(to_values(spec))
    goals = {"successes": 5, "grasps": 5, "no_new_cell": 5, "saturation": 0.5}
    assert differences(spec, msgspec.structs.replace(spec, **goals)) == []
    assert differences(spec, msgspec.structs.replace(spec, seed=5)) == ["seed"]
