"""Whatever the bus, the workers and the machines do, a run ends with the journal of its spec."""

from dataclasses import replace
from random import Random

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from tests.coordinator import make_believe
from tests.coordinator.plans import SHAPE, Plan, Task, evaluate, reference
from tests.coordinator.simulated import World
from tests.coordinator.spaces import plain

from qdgrasp_coordinator import outbox
from qdgrasp_coordinator.search import AIMED, PAPER, Method, Search
from qdgrasp_coordinator.searches.aimed import START
from qdgrasp_protocol.rows import Rows
from qdgrasp_protocol.spec import Overlaps, RunSpec

TROUBLE: dict[str, dict[str, float]] = {
    "nothing": {},
    "lost messages": {"loss": 0.1},
    "repeated messages": {"repeat": 0.3},
    "reordered messages": {"delay": 0.5},
    "messages that come much too late": {"stall": 0.05},
    "a simulator that fails now and then": {"hiccup": 0.2},
    "workers whose links break": {"flap": 0.5},
    "workers that die": {"kill": 0.5},
    "workers that go silent": {"zombie": 0.2},
    "a coordinator whose link breaks": {"link": 0.1},
    "a coordinator that dies": {"crash": 0.5},
    "a recorder that dies": {"recorder_crash": 0.3},
    "a recorder with an older disk": {"restore": 0.3},
}


@pytest.fixture(autouse=True)
def small_outbox(monkeypatch: pytest.MonkeyPatch) -> None:
    """Bounds that small histories reach."""
    monkeypatch.setattr(outbox, "SLICE", 4)
    monkeypatch.setattr(outbox, "BOUND", 8)


def varied(seed: int) -> Plan:
    """A run of one of many shapes."""
    chance = Random(seed)  # noqa: S311 - dice, not secrets
    return Plan(
        seed=seed,
        population=chance.choice([1, 3, 6, 9]),
        evaluations=chance.choice([1, 7, 20, 33]),
        overlaps=chance.choice(["count", "redraw"]),
        in_flight=chance.choice([1, 1, 2, 3]),
        trials=chance.choice([0, 0, 1, 4]),
        batch_size=chance.choice([None, 1, 2, 5]),
        workers=chance.choice([1, 2, 4]),
        credit=chance.choice([1, 2, 3]),
    )


@pytest.mark.parametrize("trouble", TROUBLE.values(), ids=TROUBLE)
def test_the_journal_is_that_of_the_undisturbed_run_with(trouble: dict[str, float]) -> None:
    for seed in range(50):
        plan = replace(varied(seed), **trouble)
        assert World(plan).run() == reference(plan), plan


def sometimes(rate: float) -> st.SearchStrategy[float]:
    return st.sampled_from([0.0, rate / 4, rate])


ANY_PLAN = st.builds(
    Plan,
    seed=st.integers(0, 2**32),
    population=st.integers(1, 9),
    evaluations=st.integers(1, 33),
    overlaps=st.sampled_from(["count", "redraw"]),
    in_flight=st.integers(1, 3),
    trials=st.sampled_from([0, 3, 7]),
    batch_size=st.sampled_from([2, None, 1, 5]),
    workers=st.integers(1, 4),
    credit=st.integers(1, 3),
    loss=sometimes(0.1),
    repeat=sometimes(0.3),
    stall=sometimes(0.05),
    hiccup=sometimes(0.2),
    flap=sometimes(0.3),
    kill=sometimes(0.3),
    zombie=sometimes(0.2),
    link=sometimes(0.1),
    crash=sometimes(0.3),
    recorder_crash=sometimes(0.3),
    restore=sometimes(0.2),
)


def many(histories: int) -> settings:
    """The same histories in each test run."""
    return settings(
        max_examples=histories,
        deadline=None,
        derandomize=True,
        database=None,
        suppress_health_check=[HealthCheck.function_scoped_fixture],
    )


@many(200)
@given(ANY_PLAN)
def test_the_journal_is_that_of_the_undisturbed_run_with_all_of_it_together(plan: Plan) -> None:
    assert World(plan).run() == reference(plan)


@pytest.mark.slow
@many(3000)
@given(ANY_PLAN)
def test_the_journal_is_that_of_the_undisturbed_run_in_thousands_of_histories(plan: Plan) -> None:
    assert World(plan).run() == reference(plan)


@pytest.mark.parametrize("seed", range(20))
def test_without_trouble_every_batch_is_evaluated_once(seed: int) -> None:
    world = World(replace(varied(seed), overlaps="count"))
    world.run()
    assert set(world.evaluated.values()) == {1}
    counters = world.coordinator.dispatch.counters
    assert [counters[name] for name in ("duplicate", "late", "unknown", "foreign", "requeued")] == [0] * 5


def plain_task(entry: Method) -> Task:
    """A method whose genomes stand for themselves."""

    def build(population: int, seed: int) -> Search:
        spec = RunSpec(gripper="hand", object="thing", population=population, seed=seed)
        return entry.build(spec, plain(SHAPE.genes))

    return Task(build, evaluate, SHAPE)


def aimed_task(overlaps: Overlaps) -> Task:
    """The search that aims, with a hand of synergies and a spread, on a make-believe object."""
    where = make_believe.space(AIMED.prior, ("synergy", "spread"))

    def build(population: int, seed: int) -> Search:
        asked = {"population": population, "seed": seed, "overlaps": overlaps}
        return AIMED.build(RunSpec(gripper="hand", object="thing", **asked), where)

    def evaluated(rows: Rows) -> Rows:
        if not len(rows):
            return rows
        found = make_believe.evaluate(where, 0, rows["genome"])
        for key in ("generation", "index", "trial"):
            found[key] = rows[key]
        return found

    return Task(build, evaluated, make_believe.shape(where))


SEARCHES = {entry.build: entry for entry in PAPER}.values()
"""One method of each search: what tells the others apart, the prior, is not in these histories."""
ALL_OF_IT = TROUBLE["lost messages"] | TROUBLE["workers that die"] | TROUBLE["a coordinator that dies"]


@pytest.mark.parametrize("entry", SEARCHES, ids=lambda entry: entry.name)
def test_the_methods_end_with_the_same_journal_through_all_of_it(entry: Method) -> None:
    for seed in range(3):
        plan = Plan(seed=seed, population=30, evaluations=100, workers=3, task=plain_task(entry), **ALL_OF_IT)
        assert World(plan).run() == reference(plan)


@pytest.mark.parametrize("overlaps", ["redraw", "count"])
@pytest.mark.parametrize("in_flight", [1, 2])
def test_the_search_that_aims_ends_with_the_same_journal_through_all_of_it(
    in_flight: int, overlaps: Overlaps
) -> None:
    plan = Plan(
        population=25,
        evaluations=300,
        overlaps=overlaps,
        in_flight=in_flight,
        batch_size=None,
        workers=3,
        task=aimed_task(overlaps),
        **ALL_OF_IT,
    )
    journals = [World(replace(plan, seed=7, batch_size=size)).run() for size in (None, 3)]
    assert set(journals) == {reference(replace(plan, seed=7))}
    rows = np.frombuffer(journals[0], plan.task.shape.dtype)
    assert make_believe.covered(rows[rows["generation"] > START // 25]) > 20
