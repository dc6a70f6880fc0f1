"""The cells of a box, and which of them are tried next."""

import numpy as np
import pytest

from qdgrasp_assets.geometry.rotation import conjugate, from_frame, multiply, tangents, turned, unit
from qdgrasp_coordinator.search.base import keyed_generator
from qdgrasp_coordinator.search.frontier import FIRST_CAPACITY, EliteStore, Places, outcome_ranks
from qdgrasp_coordinator.search.touch_search import TouchFrontier
from qdgrasp_protocol.rows import Outcome, Rows, RowShape

BOX = (np.full(3, -0.05), np.full(3, 0.05))
MIDDLE = np.zeros((1, 3))
REACH = 0.1
BESIDE = np.concatenate([np.eye(3), -np.eye(3)]) / 100


def generator(number: int = 0) -> np.random.Generator:
    return keyed_generator(0, "targets", number)


@pytest.fixture
def frontier() -> TouchFrontier:
    return TouchFrontier(BOX, REACH)


def succeed(frontier: TouchFrontier, positions) -> None:
    """Successes at `positions` that look at points 5 cm below."""
    positions = np.asarray(positions, float)
    frontier.add_successes(frontier.places(positions), positions - [0, 0, 0.05])


def equals(frontier: TouchFrontier) -> Places:
    """Six cells that are equally far from the only success and what it looks at."""
    frontier.add_successes(frontier.places(MIDDLE), MIDDLE)
    return frontier.places(BESIDE)


def by_hand(frontier: TouchFrontier, found: np.ndarray) -> set[tuple[int, ...]]:
    """The empty cells of the box beside `found` cells (n, 3), one by one."""
    cells = {tuple(cell) for cell in found}
    around = {tuple(np.add(cell, step) - 1) for cell in cells for step in np.ndindex(3, 3, 3)}
    return {cell for cell in around - cells if max(map(abs, cell)) <= 5}


def test_places_and_centres_are_each_others_inverse(frontier: TouchFrontier) -> None:
    cells = np.stack(np.meshgrid(*[np.arange(-5, 6)] * 3), axis=-1).reshape(-1, 3)
    places = frontier.places(cells / 100)
    assert len(np.unique(places)) == 11**3
    assert places.min() >= 0
    assert frontier.centres(places) == pytest.approx(cells / 100)


def test_positions_outside_the_box_have_no_place(frontier: TouchFrontier) -> None:
    assert frontier.places([[0.056, 0, 0], [0, -0.056, 0], [0.054, 0, 0]]).tolist()[:2] == [-1, -1]
    assert frontier.places([[0.054, 0, 0]])[0] >= 0


def test_a_success_makes_its_26_neighbours_worth_a_try(frontier: TouchFrontier) -> None:
    succeed(frontier, MIDDLE)
    reached = np.rint(frontier.centres(frontier.edge) * 100)
    assert len(reached) == 26
    assert np.abs(reached).max(axis=1).tolist() == [1] * 26
    worth = frontier.worth(frontier.edge)
    assert worth.min() > 0
    assert worth.max() < 1


def test_the_edge_is_what_one_finds_cell_by_cell(frontier: TouchFrontier) -> None:
    random = np.random.default_rng(1)
    found = np.zeros((0, 3), int)
    for _ in range(12):
        new = random.integers(-5, 6, (random.integers(1, 8), 3))
        found = np.concatenate([found, new])
        succeed(frontier, new / 100)
        edge = np.rint(frontier.centres(frontier.edge) * 100).astype(int)
        assert len(edge) == len({tuple(cell) for cell in edge})
        assert {tuple(cell) for cell in edge} == by_hand(frontier, found)
        beside = (np.abs(edge[:, None] - np.unique(found, axis=0)[None]).max(axis=2) == 1).sum(axis=1)
        assert (frontier.features(frontier.edge)[:, 2] * 26).tolist() == pytest.approx(beside.tolist())


def test_a_try_costs_more_than_a_dead_end(frontier: TouchFrontier) -> None:
    places = equals(frontier)[:3]
    tried = frontier.worth(places)[0] / 2
    frontier.count_tries(places)
    assert frontier.worth(places).tolist() == pytest.approx([tried] * 3)
    frontier.count_dead_ends(places[:1])
    assert frontier.worth(places).tolist() == pytest.approx([tried * 2 / 1.5, tried, tried])


def test_the_best_are_those_with_most_neighbours_and_fewest_tries(frontier: TouchFrontier) -> None:
    succeed(frontier, [[-0.01, 0, 0], [0.01, 0, 0]])
    between = frontier.places(MIDDLE)
    level = frontier.places([[0.02, 0, 0], [0.01, 0.01, 0], [0.01, -0.01, 0]])
    compared = np.concatenate([between, level])
    assert frontier.best(1, generator(), compared).tolist() == between.tolist()
    frontier.count_tries(np.repeat(between, 2))
    assert between not in frontier.best(3, generator(), compared)


def test_before_anything_is_learned_near_cells_come_first(frontier: TouchFrontier) -> None:
    succeed(frontier, MIDDLE)
    assert frontier.centres(frontier.best(9, generator()))[:, 2] == pytest.approx(np.full(9, -0.01))


@pytest.mark.parametrize("n", [0, 1, 20, 26, 400])
def test_no_cell_is_chosen_twice_and_never_a_successful_one(frontier: TouchFrontier, n: int) -> None:
    succeed(frontier, MIDDLE)
    best = frontier.best(n, generator())
    assert len(np.unique(best)) == len(best) == min(n, 26)
    assert not frontier.successful[best].any()


def test_among_equals_every_cell_has_its_turn(frontier: TouchFrontier) -> None:
    among = equals(frontier)
    seen = {int(place) for number in range(60) for place in frontier.best(2, generator(number), among)}
    assert seen == set(among.tolist())


def test_a_dead_end_is_not_tried_for_ever(frontier: TouchFrontier) -> None:
    among = equals(frontier)
    times: dict[int, int] = {}
    for number in range(104):
        best = frontier.best(5, generator(number), among)
        frontier.count_tries(best)
        frontier.count_dead_ends(best)
        for place in best.tolist():
            times[place] = times.get(place, 0) + 1
    assert max(times.values()) - min(times.values()) <= 1


def test_the_nearest_contact_point_beside_a_cell_counts(frontier: TouchFrontier) -> None:
    below, above = np.array([[0.0, 0, -0.05]]), np.array([[0.0, 0, 0.03]])
    frontier.add_successes(frontier.places(MIDDLE), below)
    cell = frontier.places([[0.0, 0, 0.01]])
    assert frontier.features(cell)[0] == pytest.approx([0.6, 0.36, 1 / 26, 1])
    frontier.add_successes(frontier.places([[0.01, 0, 0.0]]), above)
    assert frontier.features(cell)[0] == pytest.approx([0.2, 0.04, 2 / 26, 1])


def test_it_learns_which_distances_promise_success(frontier: TouchFrontier) -> None:
    random = np.random.default_rng(0)
    distances = random.uniform(0.2, 1.2, 2000)
    features = np.stack([distances, distances**2, random.random(2000), np.ones(2000)], axis=1)
    frontier.learn(features, random.random(2000) < 1 / (1 + np.exp(20 * (distances - 0.5))))
    succeed(frontier, [[0.0, 0, 0], [0, 0, 0.01], [0, 0, 0.02], [0, 0, 0.03], [0, 0, 0.04]])
    near, far = frontier.places([[0.01, 0, -0.01]]), frontier.places([[0.01, 0, 0.05]])
    near_worth, far_worth = frontier.worth(np.concatenate([near, far]))
    assert near_worth > 2 * far_worth


def test_cells_that_no_contact_point_is_near_or_far_enough_from_are_not_aimed_at() -> None:
    """All are of cells around a success whose contact point is 3 cm below it."""
    random = np.random.default_rng(0)
    everywhere, some = TouchFrontier(BOX, REACH), TouchFrontier(BOX, REACH, (0.025, 0.035))
    for frontier in (everywhere, some):
        frontier.add_successes(frontier.places(np.zeros((1, 3))), np.array([[0.0, 0.0, -0.03]]))
    assert set(some.edge) == set(everywhere.edge)
    centres = some.centres(some.best(26, random))
    distances = np.linalg.norm(centres - [0.0, 0.0, -0.03], axis=1)
    assert 0 < len(centres) < 26
    assert ((distances >= 0.025) & (distances <= 0.035)).all()
    assert len(everywhere.best(26, random)) == 26
    some.add_successes(some.places(np.array([[0.0, 0.0, 0.02]])), np.array([[0.0, 0.0, -0.015]]))
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


def test_a_place_passes_on_its_best_success() -> None:
    kept, told = elite_store(), rows([Outcome.SHAKEN, Outcome.HELD, Outcome.DROPPED, Outcome.DROPPED])
    offer(kept, of([7, 7, 7, 9]), told)
    assert kept.points(of([9, 7])).tolist() == told["surface_point"][[3, 1]].tolist()
    assert kept.postures(of([7])) == pytest.approx(told["genome"][1:2, -POSTURE:])
    assert len(kept) == 2


def test_a_better_one_replaces_it_and_an_equal_one_does_not() -> None:
    kept = elite_store()
    for outcome, expected in [*[(Outcome.SHAKEN, 0)] * 2, (Outcome.DROPPED, 0), (Outcome.HELD, 9)]:
        told = rows([outcome] * 4)[3:]
        told["surface_point"] += 0 if len(kept) == 0 else 9
        offer(kept, of([7]), told)
        assert kept.points(of([7]))[0, 0] == 9 + expected
    assert len(kept) == 1


def test_of_equal_outcomes_the_fitter_is_the_better() -> None:
    kept, told = elite_store(), rows([Outcome.HELD] * 3, [150.0, 180.0, 180.0])
    offer(kept, of([1, 1, 1]), told)
    assert kept.points(of([1])).tolist() == told["surface_point"][1:2].tolist()


def test_weak_places_are_those_without_a_robust_grasp() -> None:
    kept = elite_store()
    offer(kept, of([4, 5, 6]), rows([Outcome.DROPPED, Outcome.HELD, Outcome.SHAKEN]))
    assert sorted(kept.weak.tolist()) == [4, 6]
    offer(kept, of([4]), rows([Outcome.HELD]))
    assert kept.weak.tolist() == [6]


def test_places_without_a_success_rank_below_all_others() -> None:
    kept = elite_store()
    offer(kept, of([4, 5]), rows([Outcome.DROPPED, Outcome.HELD]))
    none, weak, best = kept.ranks(of([3, 4, 5]))
    assert none < 0 < weak < best


def test_there_is_room_for_any_number() -> None:
    kept, n = elite_store(), 5 * FIRST_CAPACITY
    for start in range(0, n, 500):
        told = rows([Outcome.DROPPED] * min(500, n - start))
        told["surface_point"] += start
        offer(kept, np.arange(start, start + len(told)), told)
    assert len(kept) == n
    assert kept.points(np.arange(n))[501].tolist() == [503, 504, 505]


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


def test_the_better_neighbour_is_preferred_mostly_and_equals_alike() -> None:
    kept, told = elite_store(), rows([Outcome.DROPPED, Outcome.HELD, Outcome.HELD])
    offer(kept, of([1, 2, 3]), told)
    options = np.tile(of([1, 2, 3, 4]), (3000, 1))
    chosen = kept.preference(options, np.random.default_rng(0)).argmax(axis=1)
    dropped, one, other, none = np.bincount(chosen, minlength=4)
    assert none == 0
    assert 0 < dropped < 0.2 * one
    assert one == pytest.approx(other, rel=0.15)
