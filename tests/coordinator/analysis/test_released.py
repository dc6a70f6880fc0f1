from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from qdgrasp_assets.scene import Scene
from qdgrasp_coordinator.analysis.released import ReleasedArchive, released_archive

CUBE = ReleasedArchive(np.full(3, -0.145), 0.2931)


def replayed(archive: ReleasedArchive, positions: np.ndarray, fitness: np.ndarray) -> set[int]:
    """The elites, by inserting one success after the other."""
    held: dict[int, int] = {}
    for place, key in enumerate(archive.keys(positions).tolist()):
        if key not in held or fitness[place] > fitness[held[key]]:
            held[key] = place
    return set(held.values())


@pytest.mark.parametrize("seed", range(10))
def test_the_elites_are_those_that_inserting_one_by_one_leaves(seed: int) -> None:
    random = np.random.default_rng(seed)
    positions, fitness = random.uniform(-0.03, 0.03, (500, 3)), random.integers(0, 3, 500)
    elites = CUBE.elites(positions, fitness)
    assert set(elites.tolist()) == replayed(CUBE, positions, fitness)
    assert len(elites) < 400


def test_of_equals_the_elder_stays() -> None:
    positions = np.zeros((4, 3))
    assert CUBE.elites(positions, np.array([0, 1, 1, 0])).tolist() == [1]


def test_a_position_below_the_cube_falls_into_a_foreign_cell() -> None:
    outside, inside = [-0.146, 0.0, 0.0], [0.1475, -0.01, 0.0]
    keys = CUBE.keys(np.array([outside, inside]))
    assert CUBE.bins == 29
    assert keys[0] == keys[1]


def test_a_position_above_the_cube_is_clipped_into_the_last_bin() -> None:
    keys = CUBE.keys(np.array([[0.4, 0.0, 0.0], [0.1475, 0.0, 0.0]]))
    assert keys[0] == keys[1]


@pytest.mark.parametrize(
    ("name", "bins", "percent"),
    [
        ("rubiks_cube", 29, 4.2),
        ("mug", 33, 2.6),
        ("power_drill", 40, 5.5),
        ("bleach_cleanser", 46, 13.7),
        ("tennis_ball", 28, 8.5),
        ("bowl", 37, 5.6),
    ],
)
def test_the_share_of_the_set_outside_the_cube_is_that_of_the_released_code(
    reference_data: Path, make_scene: Callable[..., Scene], name: str, bins: int, percent: float
) -> None:
    """Shares that were counted in the authors' code for the Panda hand."""
    hulls = (reference_data / "objects" / name / "collision_vhacd.obj").read_bytes()
    archive = released_archive(make_scene("ref_panda_2f", hulls))
    assert archive is not None
    positions = np.load(reference_data / "reference" / "S_G_panda_2f.npz")[f"{name}.cm"] / 100
    high = archive.low + archive.side
    outside = ((positions < archive.low) | (positions >= high)).any(axis=1).mean()
    assert archive.bins == bins
    assert round(100 * outside, 1) == percent


def test_a_hand_that_the_released_code_lacks_has_no_archive(make_scene: Callable[..., Scene]) -> None:
    assert released_archive(make_scene("hand_of_mine")) is None
    for own in ("panda", "barrett", "allegro", "shadow", "robotiq_2f"):
        assert released_archive(make_scene(own)) is not None
