"""Genomes anywhere and near grasps."""

import numpy as np
import pytest

from qdgrasp_coordinator.bench.regimes import LOOKED_AT, PARENTS, PRIOR, SIGMA, Regime, Regimes
from qdgrasp_protocol.genome import Gene, Layout
from qdgrasp_protocol.outcome import Outcome
from qdgrasp_protocol.rows import Rows, Shape

LAYOUT = Layout(PRIOR, (Gene("x", -1.0, 1.0), Gene("nu", 0.0, np.pi), Gene("d", 0.0, 0.1)))


def rows(genomes: np.ndarray, *outcomes: Outcome) -> Rows:
    found = Shape(len(LAYOUT), 1).empty(len(genomes))
    found["genome"], found["outcome"] = genomes, np.resize(outcomes, len(genomes))
    return found


def look(search: Regimes, *outcomes: Outcome) -> int:
    """Look for grasps until it is enough; in how many generations."""
    generation = 0
    while not search.has_looked:
        search.tell(generation, rows(search.ask(generation), *outcomes))
        generation += 1
    return generation


def test_grasps_are_looked_for_where_the_hand_faces_the_surface() -> None:
    nu = LAYOUT.values(Regimes(LAYOUT).ask(0))[:, 1]
    assert nu.min() >= 0
    assert np.pi / 4 > nu.max() > np.pi / 5


def test_the_first_grasps_are_the_parents_and_successes_that_dropped_the_object_are_not() -> None:
    search = Regimes(LAYOUT)
    first = search.ask(0)
    search.tell(0, rows(first, Outcome.DROPPED, Outcome.SHAKEN, Outcome.MISSED, Outcome.HELD))
    assert search.has_looked
    np.testing.assert_array_equal(search.parents, first[1::2][:PARENTS])


def test_parents_do_not_depend_on_what_is_asked_in_between() -> None:
    plain, other = Regimes(LAYOUT), Regimes(LAYOUT)
    look(plain, Outcome.MISSED, *[Outcome.OVERLAP] * 60, Outcome.HELD)
    other.ask(0)
    look(other, Outcome.MISSED, *[Outcome.OVERLAP] * 60, Outcome.HELD)
    np.testing.assert_array_equal(plain.parents, other.parents)


def test_a_scene_without_grasps_is_given_up() -> None:
    search = Regimes(LAYOUT)
    assert look(search, Outcome.DROPPED) * search.population == LOOKED_AT
    assert search.parents.shape == (0, len(LAYOUT))


def test_near_grasps_each_gene_is_moved_a_little() -> None:
    search = Regimes(LAYOUT)
    look(search, Outcome.HELD)
    search.turn(Regime.NEAR, 500)
    genomes = search.ask(7)
    away = np.linalg.norm(genomes[:, None] - search.parents, axis=2).min(axis=1)
    assert genomes.shape == (500, len(LAYOUT))
    assert np.abs(genomes).max() <= 1
    assert 0 < away.max() < 5 * SIGMA


@pytest.mark.parametrize("generation", [3, 40])
def test_a_turn_begins_with_the_next_generation(generation: int) -> None:
    search = Regimes(LAYOUT)
    search.ask(generation)
    search.turn(Regime.ANYWHERE, 12)
    assert search.since == generation + 1
    assert LAYOUT.values(search.ask(generation + 1))[:, 1].max() > np.pi / 4
