import numpy as np
import pytest

from qdgrasp_coordinator.search.archive import ArchiveElites
from qdgrasp_coordinator.search.base import keyed_generator
from qdgrasp_coordinator.search.map_elites import MapElites, mutate, select_successes, select_uniform
from qdgrasp_protocol.rows import Outcome, RowShape
from qdgrasp_protocol.spec import RunSpec


def elites(n: int, successes: int) -> ArchiveElites:
    """n elites, of which some, spread over the archive, are successful."""
    successful = np.zeros(n, dtype=bool)
    successful[np.random.default_rng(n).permutation(n)[:successes]] = True
    return ArchiveElites(np.arange(n), successful)


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


def test_uniform_selection_takes_no_notice_of_success() -> None:
    found = elites(100, 10)
    picked = sum(times(select_uniform(found, 20, generator(seed)), 100) for seed in range(300))
    assert picked[found.successful].mean() == pytest.approx(60, rel=0.1)
    assert picked[~found.successful].mean() == pytest.approx(60, rel=0.1)


def test_uniform_selection_from_few_fills_the_population() -> None:
    picks = select_uniform(elites(3, 0), 50, generator())
    assert len(picks) == 50
    assert times(picks, 3).min() > 0


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


def test_without_successes_the_selection_is_uniform() -> None:
    found = elites(60, 0)
    picked = sum(times(select_successes(found, 20, generator(seed)), 60) for seed in range(300))
    assert picked == pytest.approx(100, abs=40)


def test_mutation_moves_the_stated_share_of_genes_by_the_stated_spread() -> None:
    children = mutate(np.zeros((20_000, 7), dtype=np.float32), 0.1, 0.3, generator())
    moved = children != 0
    assert moved.mean() == pytest.approx(0.3, abs=0.01)
    assert children[moved].std() == pytest.approx(0.1, abs=0.002)
    assert (~moved.any(axis=1)).mean() == pytest.approx(0.7**7, abs=0.01)


def test_mutation_with_probability_one_moves_every_gene() -> None:
    assert (mutate(np.zeros((500, 7), dtype=np.float32), 0.1, 1.0, generator()) != 0).all()


def test_every_generation_mutates_in_its_own_way() -> None:
    spec = RunSpec(gripper="hand", object="thing", population=20)
    search = MapElites(spec, 2, ([-0.1] * 3, [0.1] * 3), select_uniform)
    rows = RowShape(genes=2, joints=0).empty(1)
    rows["outcome"] = Outcome.HELD
    search.tell(0, rows)
    one, other = search.ask(1), search.ask(2)
    assert not np.array_equal(one, other)


def test_mutation_is_clipped_to_the_cube() -> None:
    children = mutate(np.ones((1000, 3), dtype=np.float32), 2.0, 1.0, generator())
    assert (children.min(), children.max()) == (-1, 1)
    assert children.dtype == np.float32
