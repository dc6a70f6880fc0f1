"""The replay under contacts of others: its measure of a ranking, and its own object."""

import math
from pathlib import Path

import numpy as np
import trimesh
from benchmarks.elsewhere import auc, mallet


def test_a_ranking_that_parts_survivors_has_an_auc_of_1_and_ties_count_half() -> None:
    survived = np.array([True, True, False, False])
    assert auc(np.array([4, 3, 2, 1]), survived) == 1
    assert auc(np.array([1, 2, 3, 4]), survived) == 0
    assert auc(np.array([2, 1, 1, 0]), survived) == 0.875
    assert math.isnan(auc(np.arange(4), np.ones(4, dtype=bool)))


def test_the_mallet_is_a_closed_mesh(tmp_path: Path) -> None:
    mallet(tmp_path / "mallet.stl")
    mesh = trimesh.load_mesh(tmp_path / "mallet.stl")
    assert mesh.is_volume
    np.testing.assert_allclose(mesh.extents, (0.06, 0.06, 0.18), atol=1e-4)
