"""Every invariant holds under faults of machines, links and disks; mutations are noticed."""

from contextlib import ExitStack
from dataclasses import replace

import numpy as np
import pytest
from tests.coordinator.scheduler.leases import with_work
from tests.coordinator.scheduler.search_plans import SHAPE, Plan, Task, evaluate, reference
from tests.coordinator.search import synthetic_scene
from tests.coordinator.search.synthetic_scene import plain
from tests.fakes.messages import ANN, join_message
from tests.simulation.invariants import INVARIANTS
from tests.simulation.mutations import MUTATIONS, Mutation, noticed
from tests.simulation.network import LinkQuality
from tests.simulation.plan import FAULTS, History, some_history
from tests.simulation.play import Verdict, play

from qdgrasp_coordinator.scheduler.worker_registry import TOKEN_DELAY
from qdgrasp_coordinator.search.base import SearchAlgorithm
from qdgrasp_coordinator.search.registry import PAPER, PORTFOLIO, Method
from qdgrasp_protocol.messages import Joined
from qdgrasp_protocol.rows import Rows
from qdgrasp_protocol.spec import Overlaps, RunSpec
from qdgrasp_worker.runtime.job_registry import RETRY_FIRST, JobSession


def test_a_worker_whose_token_comes_seconds_after_its_question_is_not_forgotten() -> None:
    dispatch = with_work(workers=())
    dispatch.join(join_message(ANN), 0.0)
    assert dispatch.give_up(5.0) == []
    assert dispatch.leases(5.0) == []
    dispatch.workers.on_token(ANN, True, 5.0)
    assert len(dispatch.leases(5.0)) == 1


def test_a_worker_whose_last_question_comes_after_its_token_has_gone_is_forgotten() -> None:
    """History 4758: it may also be back, with a token that comes later than its question."""
    dispatch = with_work()
    dispatch.workers.on_token(ANN, False, 5.0)
    dispatch.join(join_message(ANN, 2, 0), 5.1)
    assert dispatch.give_up(5.0 + TOKEN_DELAY) == []
    assert [lost.worker.gone_at is None for lost in dispatch.give_up(5.2 + TOKEN_DELAY)] == [False]
    assert list(dispatch.workers) == []


def test_a_worker_asks_the_coordinator_that_is_left_where_an_answer_outlives_its_sender() -> None:
    """History 6404: the answer came after its coordinator's token had gone, and no other was asked."""
    session = JobSession("job")
    session.on_coordinator(2, True, 0.0)
    session.on_coordinator(3, True, 0.0)
    session.ask(2)
    session.on_coordinator(2, False, 1.0)
    assert session.on_answer(Joined(epoch=2, drop=[]), 1.5, 1.0)
    assert session.join_at == 1.5 + RETRY_FIRST


def test_a_worker_whose_question_an_older_coordinator_answers_asks_again() -> None:
    """The one that it serves knows of the join before only; what it leases would be passed over for ever."""
    session = JobSession("job")
    session.on_coordinator(8, True, 0.0)
    session.ask(2)
    session.on_answer(Joined(epoch=8, drop=[]), 1.0, 1.0)
    session.join_soon(2.0)
    session.ask(2)
    assert not session.on_answer(Joined(epoch=7, drop=[]), 3.0, 1.0)
    assert session.join_at == 3.0 + RETRY_FIRST


QUIET = History(
    number=0,
    runs=(Plan(population=9, evaluations=30, in_flight=2),),
    workers=3,
    batch_size=2,
    row_seconds=0.2,
    spread=2,
    quality=LinkQuality(),
    latency=0.01,
    failure_rate=0.0,
    is_embedded=False,
)
TROUBLE = {
    "messages that are lost": {"quality": LinkQuality(loss=0.05)},
    "messages that are repeated": {"quality": LinkQuality(repeat=0.3)},
    "messages that overtake each other": {"quality": LinkQuality(delay=0.3, in_order=False)},
    "messages that come much too late": {"quality": LinkQuality(stall=0.02, in_order=False)},
    "simulators that end now and then": {"failure_rate": 0.2},
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
    for number in range(2):
        check(replace(QUIET, number=number, **trouble))


LONG = replace(
    QUIET,
    runs=(Plan(population=50, evaluations=600, in_flight=2),),
    row_seconds=0.05,
    batch_size=None,
    spread=1,
)


@pytest.mark.parametrize("is_bad_first", [False, True], ids=["later", "first"])
@pytest.mark.parametrize(
    "bad", [("slow",), ("silent",), ("silent",) * 60], ids=["slow", "silent", "60 silent"]
)
def test_the_healthy_do_not_wait_for_slow_or_silent_workers(bad: tuple[str, ...], is_bad_first: bool) -> None:
    alone = check(LONG).seconds
    assert check(replace(LONG, bad=bad, bad_first=is_bad_first)).seconds < 1.2 * alone


@pytest.mark.parametrize("number", range(3))
def test_a_fault_that_all_simulators_share_makes_no_row_an_error(number: int) -> None:
    faults = {"every simulator fails for a while": 0.2}
    check(replace(LONG, number=number, faults=faults, calm_after=15.0))


def test_every_invariant_holds_with_all_of_it_together() -> None:
    for number in range(6):
        check(some_history(number))


@pytest.mark.slow
@pytest.mark.timeout(1800)
@pytest.mark.parametrize("first", range(0, 5000, 500))
def test_every_invariant_holds_in_thousands_of_histories(first: int) -> None:
    for number in range(first, first + 500):
        check(some_history(number))


def test_a_history_is_a_function_of_its_number() -> None:
    history = replace(QUIET, number=31, faults=FAULTS, quality=LinkQuality(loss=0.05, repeat=0.3))
    one, other = (play(history, trace=True) for _ in range(2))
    assert len(one.trace) > 50
    assert one.trace == other.trace
    assert one.events == other.events


@pytest.mark.parametrize("number", range(2))
def test_without_trouble_every_batch_is_evaluated_once(number: int) -> None:
    counters = check(replace(QUIET, number=number)).counters
    unwanted = ("late", "foreign", "requeued")
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

    def build(population: int, seed: int) -> SearchAlgorithm:
        spec = RunSpec(gripper="hand", object="thing", population=population, seed=seed)
        return entry.build(spec, plain(SHAPE.genes))

    return Task(build, evaluate, SHAPE)


def portfolio_task(overlaps: Overlaps) -> Task:
    """The default search, with a hand of synergies and a spread."""
    where = synthetic_scene.space("barrett")

    def build(population: int, seed: int) -> SearchAlgorithm:
        asked = {"population": population, "seed": seed, "overlaps": overlaps, "aim_for": PORTFOLIO.aim_for}
        return PORTFOLIO.build(RunSpec(gripper="hand", object="thing", **asked), where)

    def evaluated(rows: Rows) -> Rows:
        if not len(rows):
            return rows
        found = synthetic_scene.evaluate(where, 0, rows["genome"])
        for key in ("generation", "index", "trial"):
            found[key] = rows[key]
        return found

    return Task(build, evaluated, synthetic_scene.shape(where))


SEARCHES = {entry.build: entry for entry in PAPER}.values()
"""One method of each search: the prior, which tells the others apart, is not simulated."""


@pytest.mark.parametrize("entry", SEARCHES, ids=lambda entry: entry.name)
def test_the_methods_end_with_the_same_journal_through_all_of_it(entry: Method) -> None:
    plan = Plan(population=30, evaluations=70, task=plain_task(entry))
    assert journal_of(plan, 0) == reference(plan)


@pytest.mark.parametrize(("in_flight", "most", "overlaps"), [(2, 0, "count"), (1, 3, "redraw")])
def test_the_portfolio_ends_with_the_same_journal_through_all_of_it(in_flight, most, overlaps) -> None:
    plan = Plan(
        seed=7,
        population=25,
        evaluations=300,
        overlaps=overlaps,
        in_flight=in_flight,
        most_in_flight=most,
        task=portfolio_task(overlaps),
    )
    journals = {journal_of(plan, 1)}
    assert journals == {reference(plan)}
    rows = np.frombuffer(journals.pop(), plan.task.shape.dtype)
    assert synthetic_scene.covered(rows) > 20


QUICK = (
    *("drop the join fence", "settle twice", "acknowledge before durable", "take rows past a gap"),
    *("tell out of order", "a join queues nothing again", "give up while cut off", "ignore credit"),
)
"""Mutations that are tried in each test: `make simulate` tries all of them."""


@pytest.mark.parametrize(
    "mutation",
    [pytest.param(one, marks=() if one.name in QUICK else pytest.mark.slow) for one in MUTATIONS],
    ids=lambda mutation: mutation.name,
)
def test_it_is_noticed_within_some_histories_to(mutation: Mutation) -> None:
    assert noticed(mutation) is not None


def test_every_mutation_replaces_what_is_there() -> None:
    for mutation in MUTATIONS:
        with ExitStack() as stack:
            for one in mutation.patches:
                stack.enter_context(one)


def test_every_invariant_is_to_notice_something() -> None:
    assert {mutation.invariant for mutation in MUTATIONS} == set(INVARIANTS)
