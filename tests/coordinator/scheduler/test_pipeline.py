"""The order of asks and tells, the budget, and replay."""

import itertools
import random
from dataclasses import replace

import numpy as np
import pytest
from tests.coordinator.scheduler.search_plans import (
    CHAIN,
    SHAPE,
    Plan,
    Spy,
    Task,
    asked,
    brief_spec,
    reference,
)

from qdgrasp_coordinator.metrics.run_stats import BARREN, BARREN_GENOMES, RunCounter
from qdgrasp_coordinator.scheduler.pipeline import Pipeline, most_in_flight
from qdgrasp_protocol.errors import ImpossibleValue, ReplayError
from qdgrasp_protocol.messages import Failure
from qdgrasp_protocol.rows import Genomes, Outcome, Rows

PLANS = [
    Plan(population=p, evaluations=budget, overlaps=overlaps, in_flight=in_flight, trials=trials, seed=seed)
    for seed, (p, budget, overlaps, in_flight, trials) in enumerate(
        (
            *itertools.product((1, 5, 7), (1, 14, 15, 23), ("count", "redraw"), (1, 2, 3), (0,)),
            *itertools.product((1, 7), (1, 14, 23), ("count", "redraw"), (1, 3), (3,)),
        )
    )
]
PLANS += [
    Plan(population=p, evaluations=24, overlaps=overlaps, in_flight=first, most_in_flight=5, trials=trials)
    for p, overlaps, first, trials in itertools.product((1, 2), ("count", "redraw"), (1, 2), (0, 3))
]


def journal(pipeline: Pipeline, seed: int, task: Task = CHAIN) -> bytes:
    """Run to the end with rows that arrive in random order and portions."""
    chance = random.Random(seed)  # noqa: S311 - dice, not secrets
    waiting = list(asked(pipeline, task))
    found = []
    while pipeline.finished is None:
        assert waiting, "nothing to evaluate, and no end"
        chance.shuffle(waiting)
        portion = [waiting.pop() for _ in range(min(len(waiting), chance.randint(1, 4)))]
        found.append(pipeline.settle(np.array(portion)))
        if chance.random() < 0.7 or not waiting:
            waiting += list(asked(pipeline, task))
    assert [part.first for part in found if len(part)] == _firsts(found)
    return b"".join(part.rows.tobytes() for part in found)


def _firsts(found: list) -> list[int]:
    sizes = [len(part) for part in found if len(part)]
    return [0, *itertools.accumulate(sizes)][: len(sizes)]


def rows_in(blob: bytes) -> Rows:
    return np.frombuffer(blob, dtype=SHAPE.dtype)


@pytest.mark.parametrize("plan", PLANS, ids=str)
def test_the_journal_is_the_same_whatever_the_order_of_arrival(plan: Plan) -> None:
    expected = reference(plan)
    for seed in range(3):
        pipeline = plan.pipeline()
        assert journal(pipeline, seed, plan.task) == expected
        assert pipeline.tally.evaluations == plan.evaluations


@pytest.mark.parametrize("plan", PLANS, ids=str)
def test_any_recorded_beginning_goes_on_to_the_same_journal(plan: Plan) -> None:
    """Also where it was recorded with a smaller budget: that journal is a beginning of this one."""
    expected = rows_in(reference(plan))
    for n in range(plan.seed % 3, len(expected) + 1, 3):
        pipeline = plan.pipeline()
        pipeline.replay(expected[: n // 2])
        pipeline.replay(expected[n // 2 : n])
        assert pipeline.tally.rows == n
        rest = []
        while len(rows := asked(pipeline, plan.task)):
            rest.append(pipeline.settle(rows[::-1]).rows.tobytes())
        assert b"".join(rest) == expected[n:].tobytes()
        assert pipeline.finished is not None


@pytest.mark.parametrize("trials", [0, 2])
@pytest.mark.parametrize("overlaps", ["count", "redraw"])
def test_recorded_rows_allow_just_the_budgets_whose_journals_begin_with_them(overlaps, trials: int) -> None:
    plan = Plan(population=5, evaluations=13, overlaps=overlaps, trials=trials, seed=3)
    journals = {budget: reference(replace(plan, evaluations=budget)) for budget in range(1, 16)}
    whole = rows_in(journals[13])
    for n in range(len(whole) + 1):
        for budget, expected in journals.items():
            tally = RunCounter(replace(plan, evaluations=budget).spec)
            tally.count(whole[:n])
            if expected.startswith(whole[:n].tobytes()):
                tally.check_budget()
            else:
                with pytest.raises(ImpossibleValue):
                    tally.check_budget()


def test_generations_in_flight_become_more_with_every_eighth_that_is_told_up_to_the_most() -> None:
    spec = brief_spec(population=4, evaluations=10_000, generations_in_flight=2, in_flight=16)
    told = {0: 2, 7: 2, 8: 3, 15: 3, 16: 4, 23: 4, 24: 4, 1000: 4}
    assert {number: most_in_flight(spec, number) for number in told} == told


class Barren(Spy):
    """Asks genomes that overlap, except for those of one generation."""

    def __init__(self, fertile: int) -> None:
        super().__init__(BARREN_GENOMES // BARREN, 0)
        self._fertile = fertile

    def ask(self, generation: int) -> Genomes:
        genomes = super().ask(generation)
        genomes[:, 0] = 0.2 if generation == self._fertile else -0.5
        return genomes


@pytest.mark.parametrize("fertile", [0, 5, BARREN - 1, BARREN])
def test_a_run_ends_when_its_last_twenty_generations_counted_nothing(fertile: int) -> None:
    pipeline = Plan(evaluations=100, overlaps="redraw", in_flight=2).pipeline_of(Barren(fertile))
    found = rows_in(journal(pipeline, fertile))
    assert pipeline.finished == "the last 1000 genomes, 20 generations, counted no evaluation"
    last = BARREN - 1 if fertile >= BARREN else fertile + BARREN
    assert found["generation"][-1] == last
    again = Plan(evaluations=200, overlaps="redraw", in_flight=2).pipeline_of(Barren(fertile))
    again.replay(found)
    assert (again.finished, again.ask()) == (pipeline.finished, None)


def test_rows_that_come_again_are_ignored() -> None:
    pipeline = Plan(population=6, evaluations=100).pipeline()
    rows = asked(pipeline)
    changed = rows.copy()
    changed["nu"] += 1
    assert len(pipeline.settle(rows[3:])) == 0
    assert len(pipeline.settle(np.concatenate([changed[3:], rows[:1], changed[:1]]))) == 1
    assert pipeline.settle(rows[:3]).rows.tobytes() == rows[1:].tobytes()
    assert len(pipeline.settle(changed)) == 0


def test_what_rows_cost_goes_with_the_next_that_become_final() -> None:
    pipeline = Plan(population=6, evaluations=100).pipeline()
    rows = asked(pipeline)
    assert pipeline.settle(rows[4:], cpu_seconds=1.0).cpu_seconds == 0
    assert pipeline.settle(rows[:2], cpu_seconds=0.5).cpu_seconds == 1.5
    assert pipeline.settle(rows[2:4], cpu_seconds=0.25).cpu_seconds == 0.25


def test_the_reason_of_an_error_comes_out_with_its_row() -> None:
    pipeline = Plan(population=6, evaluations=100).pipeline()
    rows = asked(pipeline)
    rows[4]["outcome"] = Outcome.ERROR
    assert pipeline.settle(rows[3:], failures=[Failure(row=1, reason="it burst")]).failures == ()
    assert pipeline.settle(rows[:3]).failures == (Failure(row=4, reason="it burst"),)


@pytest.mark.parametrize(
    ("column", "value", "words"),
    [
        ("genome", 0.5, "genome differs .* generation 0, index 2"),
        ("genome", -0.0, "genome differs .* generation 0, index 2"),
        ("index", 7, "index differs .* generation 0, index 2"),
        ("trial", 1, "trial differs .* generation 0, index 2"),
        ("generation", 1, "generation differs .* generation 0, index 2"),
        ("nu", 9.0, "genome differs .* generation 1, index 0"),  # what is asked next
    ],
)
def test_a_journal_of_another_run_is_refused_in_one_sentence(column: str, value: float, words: str) -> None:
    plan = Plan(population=4, evaluations=40)
    recorded = rows_in(reference(plan)).copy()
    recorded[column][2] = value
    with pytest.raises(ReplayError, match=f"journal's {words}") as caught:
        plan.pipeline().replay(recorded)
    assert "\n" not in str(caught.value)


class Fertile(Spy):
    """Asks successes at even indices and misses at odd ones."""

    def ask(self, generation: int) -> Genomes:
        genomes = super().ask(generation)
        genomes[:, 0] = np.where(np.arange(len(genomes)) % 2, 0.1, 0.6)
        return genomes

    def tell(self, generation: int, rows: Rows) -> None:
        super().tell(generation, rows)
        self.heard = rows


def fertile(population: int = 4, evaluations: int = 100, trials: int = 3) -> tuple[Fertile, Pipeline]:
    search = Fertile(population)
    return search, Plan(evaluations=evaluations, trials=trials).pipeline_of(search)


def keys_of(rows: Rows) -> list[tuple[int, int]]:
    return list(zip(rows["index"].tolist(), rows["trial"].tolist(), strict=True))


def test_the_trials_of_a_success_are_asked_when_the_nominal_rows_up_to_it_are_here() -> None:
    _, pipeline = fertile()
    nominal = asked(pipeline)
    pipeline.settle(nominal[2:])
    assert pipeline.ask() is None
    pipeline.settle(nominal[:1])
    assert keys_of(asked(pipeline)) == [(0, 1), (0, 2), (0, 3)]
    pipeline.settle(nominal[1:2])
    assert keys_of(asked(pipeline)) == [(2, 1), (2, 2), (2, 3)]
    assert pipeline.ask() is None


def test_the_search_hears_the_sum_over_the_trials_as_the_fitness_of_a_success() -> None:
    search, pipeline = fertile()
    nominal = asked(pipeline)
    pipeline.settle(nominal)
    trials = asked(pipeline)
    trials["outcome"], trials["fitness"] = Outcome.HELD, 2
    trials["outcome"][4], trials["fitness"][4] = Outcome.ERROR, 0
    assert search.calls == ["ask 0"]
    pipeline.settle(trials)
    assert search.calls == ["ask 0", "tell 0", "ask 1"]
    assert search.heard["fitness"].tolist() == [6, 0, 4, 0]
    heard = search.heard.copy()
    assert heard["trial"].tolist() == [3, 0, 3, 0]
    heard["fitness"], heard["trial"] = nominal["fitness"], 0
    assert heard.tobytes() == nominal.tobytes()


def test_trials_that_nobody_asked_for_are_ignored() -> None:
    _, pipeline = fertile()
    nominal = asked(pipeline)
    early = nominal.copy()
    early["trial"] = 1
    assert len(pipeline.settle(early)) == 0
    assert pipeline.settle(nominal).rows.tobytes() == nominal.tobytes()
    trials = asked(pipeline)
    wrong = trials[:3].copy()
    wrong["trial"] = [4, 60_000, 1]
    wrong["index"][2] = 1  # no success
    assert len(pipeline.settle(wrong)) == 0
    assert len(pipeline.settle(trials[1:3])) == 0
    assert len(pipeline.settle(trials[1:3])) == 0
    assert pipeline.settle(trials[:1]).rows.tobytes() == trials[:3].tobytes()


@pytest.mark.parametrize(("column", "value"), [("trial", 2), ("index", 1), ("genome", 0.25)])
def test_a_journal_with_other_trials_is_refused(column: str, value: float) -> None:
    _, pipeline = fertile()
    nominal = asked(pipeline)
    pipeline.settle(nominal)
    recorded = np.concatenate([nominal, asked(pipeline)])
    recorded[column][4] = value
    with pytest.raises(ReplayError, match=rf"journal's {column} differs .* generation 0, index 0"):
        fertile()[1].replay(recorded)
