"""Aims, before they are genomes."""

import numpy as np

from qdgrasp_coordinator.counts.cells import cells
from qdgrasp_coordinator.searches.aims import Aims, scattered


def test_scattered_aims_stay_in_their_cells_and_are_all_different() -> None:
    n = 500
    whole = np.random.default_rng(1).integers(-20, 20, (n, 3)) / 100
    aims = Aims(whole, np.zeros((n, 3)), np.zeros(n), np.zeros(n), np.zeros((n, 2)))
    beside = scattered(aims, np.random.default_rng(0))
    assert (cells(beside.targets) == cells(whole)).all()
    for column in (beside.targets - whole, beside.contacts, beside.rolls[:, None]):
        assert len(np.unique(column, axis=0)) == n
    assert np.abs(beside.contacts).max() < 0.015
