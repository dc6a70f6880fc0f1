"""Rules that both searches that aim keep to, on a make-believe object, and the grasps that explore."""

import hashlib
from typing import Any

import numpy as np
import pytest
from tests.coordinator.search.synthetic_scene import (
    covered,
    evaluate,
    play,
    shape,
    space,
)

from qdgrasp_coordinator.scheduler.pipeline import Pipeline
from qdgrasp_coordinator.search.base import SearchSpace
from qdgrasp_coordinator.search.registry import AIMED, method, prior_of
from qdgrasp_coordinator.search.value_search import (
    CANDIDATES,
    CONTACT,
    FIRST_EXPLORING,
    LOOSENESS,
    TARGET,
    ValueSearch,
)
from qdgrasp_protocol.rows import Outcome, Rows
from qdgrasp_protocol.spec import RunSpec

POSTURE = ("synergy", "spread")
OBJECTIVES = {
    "touch": {"aim_for": "touch"},
    "hold": {"aim_for": "hold"},
    "kinds": {"aim_for": "hold", "diversity": "posture", "grasps_per_cell": 2},
}
"""Settings that a spec may ask of the search, by name."""


def spec(**values) -> RunSpec:
    defaults = {"gripper": "hand", "object": "thing", "population": 50, "overlaps": "redraw"}
    return RunSpec(**defaults | values)


def build(asked: RunSpec, posture: tuple[str, ...] = ()) -> tuple[ValueSearch, SearchSpace]:
    """The search that a spec asks for, and its space."""
    where = space(prior_of(asked), posture)
    search = AIMED.build(asked, where)
    assert isinstance(search, ValueSearch)
    return search, where


def digest() -> str:
    """The sha256 over what is asked and told in 300 evaluations for each objective."""
    told = [play(*build(spec(**objective), POSTURE), 300).tobytes() for objective in OBJECTIVES.values()]
    return hashlib.sha256(b"".join(told)).hexdigest()


def targets(where: SearchSpace, rows: Rows) -> np.ndarray:
    return where.layout.values(rows["genome"])[:, TARGET]


@pytest.fixture(params=OBJECTIVES)
def objective(request) -> dict[str, Any]:
    return OBJECTIVES[request.param]


def test_a_run_that_was_stopped_goes_on_to_the_same_journal(objective) -> None:
    def pipeline() -> Pipeline:
        search, _ = build(spec(seed=3, **objective), POSTURE)
        budget = spec(evaluations=400, overlaps="redraw", generations_in_flight=2)
        return Pipeline(search, shape(where), budget)

    def journal(running: Pipeline, last_first: bool = False) -> Rows:
        pieces = []
        while running.finished is None:
            asked = []
            while (generation := running.ask()) is not None:
                rows = evaluate(where, generation.number, generation.genomes)
                rows["index"] = generation.indices
                asked.append(rows)
            pieces += [running.settle(rows).rows for rows in (asked[::-1] if last_first else asked)]
        return np.concatenate(pieces)

    _, where = build(spec(**objective), POSTURE)
    whole = journal(pipeline())
    assert journal(pipeline(), last_first=True).tobytes() == whole.tobytes()
    resumed = pipeline()
    resumed.replay(whole[:233])
    assert journal(resumed).tobytes() == whole[233:].tobytes()


def test_where_overlaps_count_one_candidate_is_tried_from_as_far_as_the_hand_can(objective) -> None:
    search, where = build(spec(overlaps="count", **objective))
    rows = play(search, where, 1000, "count")
    values = where.layout.values(rows["genome"])
    assert (values[:, CANDIDATES] == 1).all()
    assert (values[:, LOOSENESS] == 0).mean() > 0.9
    distances = np.linalg.norm(values[:, TARGET] - values[:, CONTACT], axis=1)[FIRST_EXPLORING:]
    least, greatest = where.distances
    scatter = 0.005
    assert ((distances > least - scatter) & (distances < greatest + scatter)).mean() > 0.98
    other = space("contact")
    elites = method("contact_me_scs").build(spec(population=500, overlaps="count"), other)
    assert covered(rows) > 1.5 * covered(play(elites, other, 1000, "count"))


def test_the_beginning_and_a_few_later_genomes_explore(objective: dict[str, Any]) -> None:
    search, where = build(spec(**objective))
    rows = play(search, where, 1000)
    loose = where.layout.values(rows["genome"])[:, LOOSENESS] > 0
    assert loose[:FIRST_EXPLORING].all()
    assert 0.01 < loose[500:][rows["outcome"][500:] >= Outcome.MISSED].mean() < 0.1


@pytest.mark.parametrize("outcome", [Outcome.DEAD_END, Outcome.MISSED])
def test_without_a_success_it_explores_on_and_aims_anywhere(outcome: Outcome) -> None:
    (seeking, where), asked = build(spec()), []
    for generation in range(60):
        rows = shape(where).empty(50)
        rows["genome"], rows["index"], rows["outcome"] = seeking.ask(generation), np.arange(50), outcome
        seeking.tell(generation, rows)
        asked.append(rows)
    rows = np.concatenate(asked)
    looseness = where.layout.values(rows["genome"])[:, LOOSENESS]
    assert (looseness > 0).all()
    assert (looseness[:200] == 1).mean() < 0.1
    assert (looseness[-500:] == 1).mean() == pytest.approx(0.5, abs=0.1)
    assert len(np.unique(rows["genome"], axis=0)) == len(rows)
