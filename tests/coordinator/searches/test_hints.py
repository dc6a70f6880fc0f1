"""What a successful cell passes on to its neighbours."""

import numpy as np
import pytest

from qdgrasp_assets.rotation import conjugate, from_frame, multiply, tangents, turned, unit
from qdgrasp_coordinator.searches.hints import FIRST, Hints
from qdgrasp_protocol.outcome import Outcome
from qdgrasp_protocol.rows import Rows, Shape

POSTURE = 2


def rows(outcomes: list[int], fitness: list[float] | None = None) -> Rows:
    """Successes that differ in everything."""
    made = Shape(genes=15 + POSTURE, joints=1, descriptors=9).empty(len(outcomes))
    made["outcome"] = outcomes
    made["fitness"] = np.array(outcomes) - Outcome.DROPPED if fitness is None else fitness
    made["surface_point"] = np.arange(3 * len(outcomes)).reshape(-1, 3)
    made["base_to_object"][:, 6] = 1
    made["genome"] = np.arange(len(outcomes))[:, None] + np.linspace(0, 0.5, 15 + POSTURE)
    return made


def hints(axis: tuple[float, float, float] = (0, 0, 1)) -> Hints:
    return Hints(5000, axis, POSTURE)


def of(places: list[int]) -> np.ndarray:
    return np.array(places, dtype=np.intp)


def test_a_place_passes_on_its_best_success() -> None:
    kept, told = hints(), rows([Outcome.SHAKEN, Outcome.HELD, Outcome.DROPPED, Outcome.DROPPED])
    kept.learn(of([7, 7, 7, 9]), told)
    assert kept.points(of([9, 7])).tolist() == told["surface_point"][[3, 1]].tolist()
    assert kept.postures(of([7])) == pytest.approx(told["genome"][1:2, -POSTURE:])
    assert len(kept) == 2


def test_a_better_one_replaces_it_and_an_equal_one_does_not() -> None:
    kept = hints()
    for outcome, expected in [
        (Outcome.SHAKEN, 0),
        (Outcome.SHAKEN, 0),
        (Outcome.DROPPED, 0),
        (Outcome.HELD, 9),
    ]:
        told = rows([outcome] * 4)[3:]
        told["surface_point"] += 0 if len(kept) == 0 else 9
        kept.learn(of([7]), told)
        assert kept.points(of([7]))[0, 0] == 9 + expected
    assert len(kept) == 1


def test_of_equal_outcomes_the_fitter_is_the_better() -> None:
    kept, told = hints(), rows([Outcome.HELD] * 3, [150.0, 180.0, 180.0])
    kept.learn(of([1, 1, 1]), told)
    assert kept.points(of([1])).tolist() == told["surface_point"][1:2].tolist()


def test_weak_places_are_those_without_a_robust_grasp() -> None:
    kept = hints()
    kept.learn(of([4, 5, 6]), rows([Outcome.DROPPED, Outcome.HELD, Outcome.SHAKEN]))
    assert sorted(kept.weak.tolist()) == [4, 6]
    kept.learn(of([4]), rows([Outcome.HELD]))
    assert kept.weak.tolist() == [6]


def test_places_without_a_success_rank_below_all_others() -> None:
    kept = hints()
    kept.learn(of([4, 5]), rows([Outcome.DROPPED, Outcome.HELD]))
    none, weak, best = kept.ranks(of([3, 4, 5]))
    assert none < 0 < weak < best


def test_there_is_room_for_any_number() -> None:
    kept, n = hints(), 5 * FIRST
    for start in range(0, n, 500):
        told = rows([Outcome.DROPPED] * min(500, n - start))
        told["surface_point"] += start
        kept.learn(np.arange(start, start + len(told)), told)
    assert len(kept) == n
    points = kept.points(np.arange(n))
    assert points[501].tolist() == [503, 504, 505]


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
    kept = hints(axis)
    kept.learn(np.arange(200), told)
    assert np.cos(kept.rolls(np.arange(200), directions) - angles) == pytest.approx(np.ones(200), abs=1e-5)
    aside, _ = turned(*tangents(directions), angles)
    near = unit(directions + random.normal(0, 0.05, (200, 3)))
    read, _ = turned(*tangents(near), kept.rolls(np.arange(200), near))
    assert (aside * read).sum(axis=1).min() > 0.97


def test_the_better_neighbour_is_preferred_mostly_and_equals_alike() -> None:
    kept, told = hints(), rows([Outcome.DROPPED, Outcome.HELD, Outcome.HELD])
    kept.learn(of([1, 2, 3]), told)
    options = np.tile(of([1, 2, 3, 4]), (3000, 1))
    chosen = kept.preference(options, np.random.default_rng(0)).argmax(axis=1)
    dropped, one, other, none = np.bincount(chosen, minlength=4)
    assert none == 0
    assert 0 < dropped < 0.2 * one
    assert one == pytest.approx(other, rel=0.15)
