import numpy as np
import pytest

from qdgrasp_coordinator.search.archive import ArchiveElites
from qdgrasp_coordinator.search.base import keyed_generator
from qdgrasp_coordinator.search.map_elites import mutate, select_successes, select_uniform


def elites(n: int, successes: int) -> ArchiveElites:
    """n elites, of which some, spread over the archive, are successful."""
    successful = np.zeros(n, dtype=bool)
    successful[np.random.default_rng(n).permutation(n)[:successes]] = True
    return ArchiveElites(np.zeros((n, 2), np.float32), successful)


def generator(seed: int = 0) -> np.random.Generator:
    return keyed_generator(seed, "parents", 0)


def times(picks: np.ndarray, n: int) -> np.ndarray:
    """Number of times that each elite was picked."""
    return np.bincount(picks, minlength=n)


@pytest.mark.parametrize("n", [50, 51, 400])
def test_uniform_selection_takes_nobody_twice_while_there_are_enough(n: int) -> None:
    picks = select_uniform(elites(n, 3), 50, generator())
    assert len(picks) == 50
    assert times(picks, n).max() == 1


@pytest.mark.parametrize("successes", [1, 20, 49])
def test_all_successes_come_first_and_the_rest_are_others(successes: int) -> None:
    found = elites(300, successes)
    picked = times(select_successes(found, 50, generator()), 300)
    assert picked[found.successful].tolist() == [1] * successes
    assert picked.max() == 1
    assert picked.sum() == 50


@pytest.mark.parametrize("successes", [50, 200])
def test_only_successes_are_taken_when_there_are_enough(successes: int) -> None:
    found = elites(300, successes)
    picked = times(select_successes(found, 50, generator()), 300)
    assert picked[found.successful].sum() == picked.sum() == 50
    assert picked.max() == 1


@pytest.mark.parametrize("successes", [0, 1, 12, 30])
def test_a_small_archive_gives_every_elite_once_and_then_any(successes: int) -> None:
    picked = times(select_successes(elites(30, successes), 50, generator()), 30)
    assert picked.sum() == 50
    assert picked.min() == 1


def test_mutation_moves_the_stated_share_of_genes_by_the_stated_spread() -> None:
    children = mutate(np.zeros((20_000, 7), dtype=np.float32), 0.1, 0.3, generator())
    moved = children != 0
    assert moved.mean() == pytest.approx(0.3, abs=0.01)
    assert children[moved].std() == pytest.approx(0.1, abs=0.002)
    assert (~moved.any(axis=1)).mean() == pytest.approx(0.7**7, abs=0.01)


def test_mutation_is_clipped_to_the_cube() -> None:
    children = mutate(np.ones((1000, 3), dtype=np.float32), 2.0, 1.0, generator())
    assert (children.min(), children.max()) == (-1, 1)
    assert children.dtype == np.float32
