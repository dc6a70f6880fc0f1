"""The search that aims at value, on a make-believe object; its cells, models and measures of quality."""

from dataclasses import replace

import numpy as np
import pytest
from tests.coordinator.metrics.test_grasp_quality import rows_of
from tests.coordinator.scenes import made_scene
from tests.coordinator.search.synthetic_scene import covered, evaluate, play, space
from tests.coordinator.search.test_aimed import build, spec, targets

from qdgrasp_assets.genes import STEEPEST_VALUE, TOUCH_VALUE, VALUE_FEATURES
from qdgrasp_assets.geometry.rotation import Floats
from qdgrasp_coordinator.metrics.cells import cells
from qdgrasp_coordinator.metrics.grasp_quality import recorded_margins
from qdgrasp_coordinator.search.base import search_space
from qdgrasp_coordinator.search.frontier import FULL_QUALITY, NEIGHBOURS, Frontier
from qdgrasp_coordinator.search.success_model import FIRST_QUALITY_WEIGHTS, FIRST_TOUCH_WEIGHTS
from qdgrasp_coordinator.search.value_search import (
    FULL_ETAS,
    FULL_MARGIN,
    LOOSENESS,
    QUALITY_GRAIN,
    ValueModel,
    ValueSearch,
    quality_measure,
)
from qdgrasp_protocol.rows import Outcome, RowShape

SPACE = space("valued")


def test_to_aim_for_grasps_that_hold_finds_more_of_them_and_hardly_fewer_touches() -> None:
    hold, touch = (play(*build(spec(aim_for=aim_for)), 1200) for aim_for in ("hold", "touch"))
    assert covered(hold, Outcome.HELD) > 1.1 * covered(touch, Outcome.HELD)
    assert covered(hold) > 0.9 * covered(touch)


def test_a_cell_stays_open_until_it_holds() -> None:
    """In a box of few cells, weak ones are tried again as soon as the empty ones are spent."""
    where = replace(SPACE, box=(np.array([0.06, -0.03, -0.03]), np.array([0.11, 0.03, 0.03])))
    seeking = ValueSearch(spec(aim_for="hold"), where)
    held: set[tuple[int, ...]] = set()
    touched: set[tuple[int, ...]] = set()
    again = 0
    for generation in range(30):
        rows = evaluate(where, generation, seeking.ask(generation))
        tight = rows[where.layout.values(rows["genome"])[:, LOOSENESS] == 0]
        aims = set(map(tuple, cells(targets(where, tight))))
        assert len(aims) == len(tight)
        assert not aims & held
        again += len(aims & touched)
        seeking.tell(generation, rows)
        for found, least in ((held, Outcome.HELD), (touched, Outcome.DROPPED)):
            found |= set(map(tuple, cells(rows[rows["outcome"] >= least]["descriptor"][:, :3])))
    assert again > 20


BEST = {"hold": 0, "eta": 1}
"""Of a robust grasp with few trials survived, and a weak one with many, which one its cell passes on."""


@pytest.mark.parametrize("aim_for", BEST)
def test_a_cell_passes_on_the_grasp_that_is_best_by_the_objective(aim_for: str) -> None:
    seeking, where = build(spec(aim_for=aim_for, protocol="robust"))
    rows = evaluate(where, 0, seeking.ask(0))
    rows["outcome"] = Outcome.MISSED
    rows["outcome"][:2], rows["fitness"][:2] = [Outcome.HELD, Outcome.SHAKEN], [50, 150]
    rows["descriptor"][:2, :3] = 0.0
    seeking.tell(0, rows)
    passed_on = seeking._elites.points(seeking._frontier.places(np.zeros((1, 3))))
    assert passed_on.tolist() == rows["surface_point"][[BEST[aim_for]]].tolist()


BOX = (np.full(3, -0.05), np.full(3, 0.05))
MIDDLE = np.zeros((1, 3), int)


@pytest.fixture
def frontier() -> Frontier:
    return Frontier(BOX, 0.1)


def add(frontier: Frontier, found: np.ndarray, quality: Floats) -> None:
    """Add grasps in cells (n, 3) that look at points 5 cm below."""
    positions = found / 100
    frontier.add_grasps(frontier.places(positions), positions - [0, 0, 0.05], np.asarray(quality, float))


def test_cells_features_and_worth_are_those_that_one_finds_cell_by_cell(frontier: Frontier) -> None:
    random = np.random.default_rng(1)
    best: dict[tuple[int, ...], float] = {}
    for _ in range(12):
        new = random.integers(-5, 6, (8, 3))
        quality = random.choice([0.0, 0.25, 0.5, FULL_QUALITY, 1.0], 8)
        add(frontier, new, quality)
        for cell, value in zip(map(tuple, new.tolist()), quality.tolist(), strict=True):
            best[cell] = max(best.get(cell, 0.0), value)
        edge = [tuple(cell) for cell in np.rint(frontier.centres(frontier.edge) * 100).astype(int).tolist()]
        near = {tuple(step) for cell in best for step in (*(NEIGHBOURS + cell).tolist(), cell)}
        assert len(edge) == len(set(edge))
        assert set(edge) == {c for c in near if max(map(abs, c)) <= 5 and best.get(c, 0.0) < FULL_QUALITY}
        around = [[best.get(tuple(one), -1.0) for one in (NEIGHBOURS + cell).tolist()] for cell in edge]
        features = frontier.features(frontier.edge)
        assert features[:, 2] == pytest.approx((np.array(around) >= 0).mean(axis=1))
        assert features[:, 3] == pytest.approx(np.maximum(around, 0).sum(axis=1) / 26)
        assert features[:, 4].tolist() == [cell in best for cell in edge]
        touch, hold = (
            1 / (1 + np.exp(-features @ weights)) for weights in (FIRST_TOUCH_WEIGHTS, FIRST_QUALITY_WEIGHTS)
        )
        left = 1.0 - np.array([best.get(cell, 0.0) for cell in edge])
        value = touch * (TOUCH_VALUE * (1 - features[:, 4]) + (1 - TOUCH_VALUE) * hold * left)
        assert frontier.worth(frontier.edge) == pytest.approx(value)


def test_it_learns_touch_of_all_tries_and_quality_of_successes_alone(frontier) -> None:
    """Grasps far from the contact point seldom touch; those that do are all held, others never."""
    random = np.random.default_rng(0)
    features = np.zeros((2000, 6))
    features[:, 0] = random.uniform(0.2, 1.2, 2000)
    features[:, 1], features[:, 5] = features[:, 0] ** 2, 1.0
    is_far = features[:, 0] > 0.7
    is_success = random.random(2000) < np.where(is_far, 0.1, 0.9)
    frontier.learn_quality(features, is_success, np.where(is_success, is_far, 0.0))
    near, far = np.array([0.3, 0.09, 0, 0, 0, 1]), np.array([1.1, 1.21, 0, 0, 0, 1])
    touch, hold = (model.likely(np.stack([near, far])) for model in (frontier.touch, frontier.quality))
    assert touch[0] > 3 * touch[1]
    assert hold[1] > 3 * hold[0]


N = len(VALUE_FEATURES)


def test_candidates_are_ranked_by_models_of_touch_and_quality_once_both_can_be_told() -> None:
    """One feature decides on touch, another one on what a touch is worth."""
    random, model = np.random.default_rng(0), ValueModel()
    wanted = np.array([0.0, 0.3])
    assert not model.ranking(wanted).any()
    rows = RowShape(genes=1, joints=1, descriptors=3 + N).empty(1500)
    features = np.concatenate([random.random((1500, N - 1)), np.ones((1500, 1))], axis=1)
    rows["descriptor"][:, 3:] = features
    is_success = features[:, 1] > 0.5
    rows["outcome"] = np.where(is_success, Outcome.HELD, Outcome.MISSED)
    model.learn(rows, np.where(is_success, features[:, 6], 0.0))
    ranking = model.ranking(wanted)
    assert ranking[:, -1].tolist() == wanted.tolist()
    touch, quality = ranking[0, :N], ranking[0, N:-1]
    assert (touch[:-1].argmax(), quality[:-1].argmax()) == (1, 6)
    assert ranking[1, :-1].tolist() == ranking[0, :-1].tolist()
    model.touch.weights = np.full(N, -1000.0)
    assert (model.ranking(wanted)[:, :N] == -STEEPEST_VALUE).all()


@pytest.mark.parametrize(
    ("values", "expected"),
    [
        ({"aim_for": "hold"}, [1, 1, 0, 0]),
        ({"aim_for": "eta", "protocol": "robust"}, [1, 0.5, 0.05, 0]),
        ({"aim_for": "eta", "protocol": "robust", "base": "physical"}, [1, 0.5, 0.05, 0]),
    ],
)
def test_quality_is_whether_a_grasp_held_or_its_eta_as_a_share_of_the_greatest(values, expected) -> None:
    asked, rows = spec(**values), rows_of(4)
    full = FULL_ETAS.get(asked.nominal_protocol, 1.0) * asked.disturbances * 100  # trials
    rows["outcome"] = [Outcome.HELD, Outcome.HELD, Outcome.SHAKEN, Outcome.DROPPED]
    rows["fitness"] = [full * 2, full / 2, full / 20, 0]
    assert quality_measure(asked, SPACE)(rows) == pytest.approx(np.array(expected))


def test_a_margin_counts_as_a_share_of_the_greatest_in_whole_grains_and_none_as_nothing() -> None:
    scene, rows = made_scene("jaw"), rows_of(3)
    rows["contact_links"][1, 2:] = 0  # a single finger
    rows["settled"][2] = 0.0  # not recorded
    quality = quality_measure(spec(aim_for="margin"), search_space(scene, "valued"))(rows)
    share = min(1.0, recorded_margins(rows, scene.object)[0] / FULL_MARGIN)
    assert quality == pytest.approx([share, 0, 0], abs=1 / QUALITY_GRAIN)
    assert quality[0] > 0
    assert (quality * QUALITY_GRAIN % 1 == 0).all()
