"""Rules that both searches that aim keep to, on a make-believe object, and the grasps that explore."""

import hashlib
from typing import Any

import numpy as np
import pytest
from tests.coordinator.search.synthetic_scene import (
    DEEPEST,
    PALM,
    SIZE,
    covered,
    evaluate,
    play,
    shape,
    space,
)

from qdgrasp_coordinator.metrics.cells import cells
from qdgrasp_coordinator.scheduler.pipeline import Flight, Pipeline
from qdgrasp_coordinator.search import aimed
from qdgrasp_coordinator.search.aimed import (
    CANDIDATES,
    CONTACT,
    FIRST_EXPLORING,
    LOOSENESS,
    TARGET,
    AimedGrasps,
    AimedSearch,
    directions,
    exploration_grasps,
    scatter_grasps,
)
from qdgrasp_coordinator.search.base import SearchSpace
from qdgrasp_coordinator.search.registry import AIMED, method, prior_of
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


def build(asked: RunSpec, posture: tuple[str, ...] = ()) -> tuple[AimedSearch, SearchSpace]:
    """The search that a spec asks for, and its space."""
    where = space(prior_of(asked), posture)
    search = AIMED.build(asked, where)
    assert isinstance(search, AimedSearch)
    return search, where


def digest() -> str:
    """The sha256 over what is asked and told in 1000 evaluations for each objective."""
    told = [play(*build(spec(**objective), POSTURE), 1000).tobytes() for objective in OBJECTIVES.values()]
    return hashlib.sha256(b"".join(told)).hexdigest()


def targets(where: SearchSpace, rows: Rows) -> np.ndarray:
    return where.layout.values(rows["genome"])[:, TARGET]


@pytest.fixture(params=OBJECTIVES)
def objective(request) -> dict[str, Any]:
    return OBJECTIVES[request.param]


@pytest.mark.parametrize("in_flight", [pytest.param(1, marks=pytest.mark.slow), 2])
def test_a_run_that_was_stopped_goes_on_to_the_same_journal(in_flight, objective) -> None:
    def pipeline() -> Pipeline:
        search, _ = build(spec(seed=3, **objective), POSTURE)
        return Pipeline(search, shape(where), 700, "redraw", Flight(in_flight))

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
    resumed.replay(whole[:333])
    assert journal(resumed).tobytes() == whole[333:].tobytes()


def test_with_one_candidate_it_still_covers_more_when_overlaps_count(objective: dict[str, Any]) -> None:
    search, where = build(spec(overlaps="count", **objective))
    rows = play(search, where, 2000, "count")
    values = where.layout.values(rows["genome"])
    assert (values[:, CANDIDATES] == 1).all()
    assert (values[:, LOOSENESS] == 0).mean() > 0.9
    other = space("contact")
    elites = method("contact_me_scs").build(spec(population=500, overlaps="count"), other)
    assert covered(rows) > 1.5 * covered(play(elites, other, 2000, "count"))


@pytest.mark.parametrize("population", [1, 50, 500])
def test_any_population_finds_its_way(population: int, objective: dict[str, Any]) -> None:
    rows = play(*build(spec(population=population, **objective)), 600)
    assert len(rows) % population == 0
    assert covered(rows) > (100 if population == 500 else 300 / objective.get("grasps_per_cell", 1))


def test_no_target_lies_outside_the_box(objective: dict[str, Any]) -> None:
    search, where = build(spec(**objective))
    rows = play(search, where, 2000)
    low, high = where.box
    assert (targets(where, rows) >= low).all()
    assert (targets(where, rows) <= high).all()
    assert np.abs(rows["genome"]).max() <= 1


def test_where_every_pose_counts_hands_stand_as_far_from_the_hint_as_they_can(objective) -> None:
    search, where = build(spec(overlaps="count", **objective))
    values = where.layout.values(play(search, where, 2000)["genome"])[FIRST_EXPLORING:]
    distances = np.linalg.norm(values[:, TARGET] - values[:, CONTACT], axis=1)
    least, greatest = where.distances
    scatter = 0.005
    assert ((distances > least - scatter) & (distances < greatest + scatter)).mean() > 0.98


def test_the_beginning_and_a_few_later_genomes_explore(objective: dict[str, Any]) -> None:
    search, where = build(spec(**objective))
    rows = play(search, where, 2000)
    loose = where.layout.values(rows["genome"])[:, LOOSENESS] > 0
    assert loose[:FIRST_EXPLORING].all()
    assert 0.01 < loose[1000:][rows["outcome"][1000:] >= Outcome.MISSED].mean() < 0.1


@pytest.mark.parametrize("outcome", [Outcome.ERROR, Outcome.DEAD_END, Outcome.OVERLAP, Outcome.MISSED])
def test_without_a_success_it_explores_on_and_aims_anywhere(
    outcome: Outcome, objective: dict[str, Any]
) -> None:
    (seeking, where), asked = build(spec(**objective)), []
    for generation in range(60):
        rows = evaluate(where, generation, seeking.ask(generation))
        rows["outcome"] = outcome
        seeking.tell(generation, rows)
        asked.append(rows)
    rows = np.concatenate(asked)
    looseness = where.layout.values(rows["genome"])[:, LOOSENESS]
    assert (looseness > 0).all()
    assert (looseness[:200] == 1).mean() < 0.1
    assert (looseness[-500:] == 1).mean() == pytest.approx(0.5, abs=0.1)
    assert len(np.unique(rows["genome"], axis=0)) == len(rows)


def test_dead_ends_are_not_tried_for_ever(objective: dict[str, Any]) -> None:
    """One cell in three is a dead end for all genomes."""
    (seeking, where), told = build(spec(**objective)), []
    for generation in range(80):
        rows = evaluate(where, generation, seeking.ask(generation))
        rows["outcome"][cells(targets(where, rows)).sum(axis=1) % 3 == 0] = Outcome.DEAD_END
        seeking.tell(generation, rows)
        told.append(rows)
    rows = np.concatenate(told)
    aimed_at, times = np.unique(cells(targets(where, rows)), axis=0, return_counts=True)
    dead = aimed_at.sum(axis=1) % 3 == 0
    assert times[dead].max() < 30
    assert covered(rows) > 450


def test_synergies_are_inherited_but_for_some_and_free_joints_drift() -> None:
    seeking, _ = build(spec(), POSTURE)
    parents = np.tile(np.array([[0.5, -1.0]]), (4000, 1))
    children = seeking._varied(parents, np.random.default_rng(0))
    assert (children[:, 0] != 0.5).mean() == pytest.approx(aimed.SYNERGY_REDRAW, abs=0.03)
    assert np.abs(children).max() <= 1
    assert 0 < (children[:, 1] + 1).mean() < 0.05


def test_scattered_aims_stay_in_their_cells_and_are_all_different() -> None:
    n = 500
    whole = np.random.default_rng(1).integers(-20, 20, (n, 3)) / 100
    aims = AimedGrasps(whole, np.zeros((n, 3)), np.zeros(n), np.zeros(n), np.zeros((n, 2)))
    beside = scatter_grasps(aims, np.random.default_rng(0))
    assert (cells(beside.targets) == cells(whole)).all()
    for column in (beside.targets - whole, beside.contacts, beside.rolls[:, None]):
        assert len(np.unique(column, axis=0)) == n
    assert np.abs(beside.contacts).max() < 0.015


def drawn(free_share: float, n: int = 2000) -> AimedGrasps:
    return exploration_grasps(space("aimed"), n, free_share, 1.0, np.random.default_rng(0))


def distances(aims: AimedGrasps) -> np.ndarray:
    return np.linalg.norm(aims.targets - aims.contacts, axis=1)


def test_an_exploring_hand_looks_at_a_face_from_before_it() -> None:
    aims = drawn(free_share=0.0)
    on_face = np.isclose(np.abs(aims.contacts), SIZE / 2)
    assert on_face.any(axis=1).all()
    towards = directions(aims.targets, aims.contacts)
    inward = -np.sign(aims.contacts) * on_face
    assert ((towards * inward).sum(axis=1) > np.cos(np.pi / 4) - 1e-9).all()


def test_an_exploring_hand_stands_in_the_near_half_of_where_the_hand_can_stand() -> None:
    found = distances(drawn(free_share=0.0))
    assert found.min() == pytest.approx(PALM, abs=1e-4)
    assert found.max() == pytest.approx(PALM + DEEPEST / 2, abs=1e-4)


def test_free_ones_aim_anywhere_in_the_box() -> None:
    low, high = space("aimed").box
    found = (drawn(free_share=1.0).targets - low) / (high - low)
    assert np.abs(found.mean(axis=0) - 0.5).max() < 0.05
    assert found.min() < 0.01
    assert found.max() > 0.99
