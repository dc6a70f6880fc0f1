"""The cells of a box, and which of them are tried next."""

import numpy as np
import pytest

from qdgrasp_assets.geometry.rotation import conjugate, from_frame, multiply, tangents, turned, unit
from qdgrasp_coordinator.search.frontier import EliteStore, Frontier, Places, outcome_ranks
from qdgrasp_protocol.rows import Outcome, Rows, RowShape

BOX = (np.full(3, -0.05), np.full(3, 0.05))
REACH = 0.1


@pytest.fixture
def frontier() -> Frontier:
    return Frontier(BOX, REACH)


def test_cells_that_no_contact_point_is_near_or_far_enough_from_are_not_aimed_at() -> None:
    """All are of cells around a success whose contact point is 3 cm below it."""
    random = np.random.default_rng(0)
    everywhere, some = Frontier(BOX, REACH), Frontier(BOX, REACH, (0.025, 0.035))
    for frontier in (everywhere, some):
        frontier.add_grasps(frontier.places(np.zeros((1, 3))), np.array([[0.0, 0.0, -0.03]]), np.ones(1))
    assert set(some.edge) == set(everywhere.edge)
    centres = some.centres(some.best(26, random))
    distances = np.linalg.norm(centres - [0.0, 0.0, -0.03], axis=1)
    assert 0 < len(centres) < 26
    assert ((distances >= 0.025) & (distances <= 0.035)).all()
    assert len(everywhere.best(26, random)) == 26
    some.add_grasps(some.places(np.array([[0.0, 0.0, 0.02]])), np.array([[0.0, 0.0, -0.015]]), np.ones(1))
    assert len(some.best(100, random)) > len(centres)


POSTURE = 2


def rows(outcomes: list[int], fitness: list[float] | None = None) -> Rows:
    """Successes that differ in everything."""
    made = RowShape(genes=15 + POSTURE, joints=1, descriptors=9).empty(len(outcomes))
    made["outcome"] = outcomes
    made["fitness"] = np.array(outcomes) - Outcome.DROPPED if fitness is None else fitness
    made["surface_point"] = np.arange(3 * len(outcomes)).reshape(-1, 3)
    made["base_to_object"][:, 6] = 1
    made["genome"] = np.arange(len(outcomes))[:, None] + np.linspace(0, 0.5, 15 + POSTURE)
    return made


def elite_store(axis: tuple[float, float, float] = (0, 0, 1)) -> EliteStore:
    return EliteStore(5000, axis, POSTURE)


def offer(kept: EliteStore, places: Places, told: Rows) -> None:
    kept.offer(places, told, outcome_ranks(told))


def of(places: list[int]) -> np.ndarray:
    return np.array(places, dtype=np.intp)


@pytest.mark.parametrize("axis", [(0, 0, 1), (1, 0, 0), (0, -1, 0)])
def test_a_roll_is_read_back_from_the_pose_and_kept_in_other_directions(axis: tuple) -> None:
    random = np.random.default_rng(0)
    directions = unit(random.normal(size=(200, 3)))
    angles = random.uniform(0, 2 * np.pi, 200)
    body = np.array([axis], float)
    at_rest = from_frame(*tangents(body), body)
    told = rows([Outcome.HELD] * 200)
    frames = from_frame(*turned(*tangents(directions), angles), directions)
    told["base_to_object"][:, 3:] = multiply(frames, np.tile(conjugate(at_rest), (200, 1)))
    kept = elite_store(axis)
    offer(kept, np.arange(200), told)
    assert np.cos(kept.rolls(np.arange(200), directions) - angles) == pytest.approx(np.ones(200), abs=1e-5)
    aside, _ = turned(*tangents(directions), angles)
    near = unit(directions + random.normal(0, 0.05, (200, 3)))
    read, _ = turned(*tangents(near), kept.rolls(np.arange(200), near))
    assert (aside * read).sum(axis=1).min() > 0.97
