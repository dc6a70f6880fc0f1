"""The fitness that a search hears, read back from a journal."""

import numpy as np
import pytest
from tests.coordinator.scheduler.search_plans import FEW_CELLS, SHAPE, Chain, Plan, asked

from qdgrasp_coordinator.metrics.successes import TrialPlan, all_successes, find_successes
from qdgrasp_protocol.rows import Outcome, Rows


class Listener(Chain):
    """A search that stores the rows of successes that it is told."""

    def __init__(self) -> None:
        super().__init__(population=8, seed=4)
        self.heard = [SHAPE.empty(0)]

    def tell(self, generation: int, rows: Rows) -> None:
        super().tell(generation, rows)
        self.heard.append(rows[rows["outcome"] >= Outcome.DROPPED])


@pytest.mark.parametrize("size", [1, 5, 1000])
@pytest.mark.parametrize("trials", [0, 3, 7])
def test_scores_are_what_the_search_was_told(trials: int, size: int) -> None:
    search, plan = Listener(), TrialPlan(trials)
    pipeline = Plan(evaluations=1000, trials=trials).pipeline_of(search)
    journal = [SHAPE.empty(0)]
    while len(search.heard) < 6:
        journal.append(pipeline.settle(asked(pipeline, FEW_CELLS)).rows)
    rows, heard = np.concatenate(journal), np.concatenate(search.heard)
    blocks = (rows[first : first + size] for first in range(0, len(rows), size))
    found = np.concatenate([part.scored for part in find_successes(blocks, plan)])
    assert len(heard) > 5
    assert len(np.unique(heard["fitness"])) > 2
    assert set(heard["trial"].tolist()) == {trials}
    assert found.tobytes() == heard.tobytes()


def test_a_success_has_no_score_before_its_last_trial_is_recorded() -> None:
    pipeline = Plan(population=6, trials=4, seed=1).pipeline()
    rows = np.concatenate([pipeline.settle(asked(pipeline)).rows for _ in range(2)])
    assert (rows["trial"] > 0).any()
    whole, short = all_successes(rows, TrialPlan(4)), all_successes(rows[:-1], TrialPlan(4))
    assert short.scored.tobytes() == whole.scored[:-1].tobytes()
    assert np.isnan(short.scores[-1])
    assert (short.trials[-1], short.stop) == (3, short.numbers[-1])
    assert whole.stop == len(rows)
