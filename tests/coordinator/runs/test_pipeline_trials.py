"""The trials of successes in the order of asks and tells."""

import numpy as np
import pytest
from tests.coordinator.runs.plans import SHAPE, Plan, Spy, asked

from qdgrasp_coordinator.runs.pipeline import Pipeline
from qdgrasp_protocol.errors import ReplayError
from qdgrasp_protocol.genome import Genomes
from qdgrasp_protocol.outcome import Outcome
from qdgrasp_protocol.rows import Rows


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
    return search, Pipeline(search, SHAPE, evaluations, "count", trials=trials)


def keys_of(rows: Rows) -> list[tuple[int, int]]:
    return list(zip(rows["index"].tolist(), rows["trial"].tolist(), strict=True))


def test_a_generation_is_journalled_as_nominal_rows_and_then_the_trials_of_its_successes() -> None:
    _, pipeline = fertile()
    nominal = asked(pipeline)
    first = pipeline.settle(nominal)
    trials = asked(pipeline)
    second = pipeline.settle(trials[::-1])
    assert keys_of(first.rows) == [(0, 0), (1, 0), (2, 0), (3, 0)]
    assert keys_of(second.rows) == [(0, 1), (0, 2), (0, 3), (2, 1), (2, 2), (2, 3)]
    assert (second.rows["genome"] == nominal["genome"][[0, 0, 0, 2, 2, 2]]).all()


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
    heard["fitness"] = nominal["fitness"]
    assert heard.tobytes() == nominal.tobytes()


def test_a_run_ends_with_the_trials_of_the_rows_that_its_budget_reaches() -> None:
    search, pipeline = fertile(evaluations=3)
    assert len(pipeline.settle(asked(pipeline))) == 3
    assert pipeline.finished is None
    assert pipeline.tally.left == 0
    assert len(pipeline.settle(asked(pipeline))) == 6
    assert pipeline.finished == "the budget of 3 evaluations is spent"
    assert (pipeline.tally.evaluations, pipeline.tally.trials, pipeline.tally.rows) == (3, 6, 9)
    assert search.calls == ["ask 0"]


def test_where_overlaps_are_redrawn_no_trial_is_asked_behind_the_row_that_ends_the_run() -> None:
    plan = Plan(population=9, evaluations=3, overlaps="redraw", trials=3, seed=2)
    pipeline = plan.pipeline()
    pipeline.settle(asked(pipeline)[::-1])
    end = pipeline.tally.rows
    assert end < 9
    assert asked(pipeline)["index"].max() < end


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


def test_of_recorded_trials_only_the_missing_ones_are_asked_again() -> None:
    _, pipeline = fertile()
    nominal = asked(pipeline)
    pipeline.settle(nominal)
    recorded = np.concatenate([nominal, asked(pipeline)[:4]])
    _, resumed = fertile()
    resumed.replay(recorded)
    assert keys_of(asked(resumed)) == [(2, 2), (2, 3)]


def test_a_generation_with_fifty_thousand_trials_is_told_when_the_last_is_here() -> None:
    """Five hundred successes with a hundred trials each, in batches of twenty-five."""
    search, pipeline = fertile(population=1000, evaluations=10_000, trials=100)
    pipeline.settle(asked(pipeline))
    trials = asked(pipeline)
    assert len(trials) == 50_000
    found = [len(pipeline.settle(trials[first : first + 25])) for first in range(0, len(trials), 25)]
    assert sum(found) == 50_000
    assert search.calls[-1] == "ask 1"
