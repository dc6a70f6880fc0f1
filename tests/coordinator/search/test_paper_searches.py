"""The optimisation archive, and the parents chosen from it."""

import subprocess
import sys

import numpy as np
import pytest

from qdgrasp_coordinator.search.base import keyed_generator
from qdgrasp_coordinator.search.paper_searches import (
    ArchiveElites,
    EliteArchive,
    mutate,
    select_successes,
    select_uniform,
)
from qdgrasp_protocol.rows import Outcome, Rows, RowShape

SHAPE = RowShape(genes=3, joints=1)
BOX = (np.array([-0.052, -0.048, -0.05]), np.array([0.052, 0.031, 0.07]))


def rows(outcomes: list[Outcome], positions: list[list[float]]) -> Rows:
    """Rows whose first gene tells them apart."""
    made = SHAPE.empty(len(outcomes))
    made["outcome"] = outcomes
    made["fitness"] = np.maximum(made["outcome"].astype(float) - Outcome.DROPPED, 0)
    made["descriptor"] = positions
    made["genome"][:, 0] = np.arange(len(outcomes)) / 100
    return made


def test_positions_outside_the_box_are_left_out() -> None:
    archive = EliteArchive(3, BOX)
    inside = [[-0.0549, 0.0, 0.0], [0.0, 0.0349, 0.0], [0.0, 0.0, 0.0749]]
    outside = [[-0.0551, 0.0, 0.0], [0.0, 0.0351, 0.0], [0.0, 0.0, 0.0751], [9.0, 9.0, 9.0]]
    archive.insert(rows([Outcome.HELD] * 7, inside + outside))
    assert len(archive) == 3


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


def test_mutation_moves_the_stated_share_of_genes_by_the_stated_spread() -> None:
    children = mutate(np.zeros((20_000, 7), dtype=np.float32), 0.1, 0.3, generator())
    moved = children != 0
    assert moved.mean() == pytest.approx(0.3, abs=0.01)
    assert children[moved].std() == pytest.approx(0.1, abs=0.002)
    assert (~moved.any(axis=1)).mean() == pytest.approx(0.7**7, abs=0.01)


LIGHT = """
import sys
import numpy as np
from qdgrasp_coordinator.search.paper_searches import grid_archive_type

found = grid_archive_type()
assert not {"sklearn", "numba", "ribs", "numpy_groupies"} & set(sys.modules)
one = {"solution_dim": 1, "dims": [2], "ranges": [(0, 1)]}
batch = np.arange(4.0)[:, None], [1.0, 2.0, 2.0, 0.0], [[0.1], [0.1], [0.1], [0.9]]
grid = found(**one)
grid.add(*batch)
assert grid.data("solution").ravel().tolist() == [1.0, 3.0]  # of equal ones the first
"""


def test_the_grid_of_pyribs_is_loaded_without_what_other_archives_need() -> None:
    subprocess.run([sys.executable, "-c", LIGHT], check=True)
