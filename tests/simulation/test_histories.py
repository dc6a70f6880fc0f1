"""Whatever happens to machines, links and disks: every invariant holds, and the journal is the spec's."""

from dataclasses import replace

import numpy as np
import pytest
from tests.coordinator.runs.plans import SHAPE, Plan, Task, evaluate, reference
from tests.coordinator.searches import make_believe
from tests.coordinator.searches.spaces import plain
from tests.simulation.network import Terms
from tests.simulation.plan import FAULTS, History, draw
from tests.simulation.play import Verdict, play

from qdgrasp_coordinator.searches.aimed import START
from qdgrasp_coordinator.searches.search import AIMED, PAPER, Method, Search
from qdgrasp_protocol.rows import Rows
from qdgrasp_protocol.spec import Overlaps, RunSpec

QUIET = History(
    number=0,
    runs=(Plan(population=9, evaluations=30, in_flight=2),),
    workers=3,
    batch_size=2,
    row_seconds=0.2,
    spread=2,
    terms=Terms(),
    latency=0.01,
    hiccup=0.0,
    is_embedded=False,
)
TROUBLE = {
    "messages that are lost": {"terms": Terms(loss=0.05)},
    "messages that are repeated": {"terms": Terms(repeat=0.3)},
    "messages that overtake each other": {"terms": Terms(delay=0.3, in_order=False)},
    "messages that come much too late": {"terms": Terms(stall=0.02, in_order=False)},
    "simulators that end now and then": {"hiccup": 0.2},
    "slow disks": {"latency": 2.0},
    "workers of which some are slow": {"spread": 30.0, "workers": 6},
    "three runs at once": {"runs": tuple(Plan(seed=seed, population=6, evaluations=20) for seed in range(3))},
    **{fault: {"faults": {fault: 10 * rate}} for fault, rate in FAULTS.items()},
}


def check(history: History) -> Verdict:
    """Play a history, to whose end every invariant must hold."""
    verdict = play(history)
    if verdict.violated is not None:
        raise verdict.violated
    return verdict


@pytest.mark.parametrize("trouble", TROUBLE.values(), ids=TROUBLE)
def test_every_invariant_holds_with(trouble: dict[str, object]) -> None:
    for number in range(4):
        check(replace(QUIET, number=number, **trouble))


@pytest.mark.parametrize("first", range(0, 150, 30))
def test_every_invariant_holds_with_all_of_it_together(first: int) -> None:
    for number in range(first, first + 30):
        check(draw(number))


@pytest.mark.slow
@pytest.mark.parametrize("first", range(0, 5000, 500))
def test_every_invariant_holds_in_thousands_of_histories(first: int) -> None:
    for number in range(first, first + 500):
        check(draw(number))


def test_a_history_is_a_function_of_its_number() -> None:
    one, other = (play(31, trace=True) for _ in range(2))
    assert len(one.trace) > 50
    assert one.trace == other.trace
    assert one.events == other.events


@pytest.mark.parametrize("number", range(5))
def test_without_trouble_every_batch_is_evaluated_once(number: int) -> None:
    counters = check(replace(QUIET, number=number)).counters
    unwanted = ("duplicate", "late", "unknown", "foreign", "requeued")
    assert {name: counters[name] for name in unwanted} == dict.fromkeys(unwanted, 0)
    assert counters["fresh"] == counters["leased"] > 0


# The methods, through all of it.

ALL_OF_IT = {
    fault: 3 * FAULTS[fault]
    for fault in ("a worker is killed", "a link is cut", "a worker is frozen", "the coordinator is killed")
}


def journal_of(plan: Plan, number: int) -> bytes:
    """The journal that a run ends with when much goes wrong."""
    history = replace(QUIET, number=number, runs=(plan,), faults=ALL_OF_IT, row_seconds=0.05, batch_size=None)
    return check(history).journals["run"]


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


@pytest.mark.parametrize("entry", SEARCHES, ids=lambda entry: entry.name)
def test_the_methods_end_with_the_same_journal_through_all_of_it(entry: Method) -> None:
    for seed in range(3):
        plan = Plan(seed=seed, population=30, evaluations=100, task=plain_task(entry))
        assert journal_of(plan, seed) == reference(plan)


@pytest.mark.parametrize("overlaps", ["redraw", "count"])
@pytest.mark.parametrize("in_flight", [1, 2])
def test_the_search_that_aims_ends_with_the_same_journal_through_all_of_it(
    in_flight: int, overlaps: Overlaps
) -> None:
    plan = Plan(
        seed=7,
        population=25,
        evaluations=300,
        overlaps=overlaps,
        in_flight=in_flight,
        task=aimed_task(overlaps),
    )
    journals = {journal_of(plan, number) for number in (1, 2)}
    assert journals == {reference(plan)}
    rows = np.frombuffer(journals.pop(), plan.task.shape.dtype)
    assert make_believe.covered(rows[rows["generation"] > START // 25]) > 20
