"""Genomes and what they stand for."""

import numpy as np
import pytest

from qdgrasp_protocol.rows import Gene, Layout

LAYOUT = Layout("contact", (Gene("x", -0.13, 0.21), Gene("omega", 0.0, 2 * np.pi), Gene("synergy", 0.0, 0.0)))


def test_genomes_of_values_stand_for_these_values() -> None:
    genomes = np.random.default_rng(0).uniform(-1, 1, (500, 3)).astype(np.float32)
    values = LAYOUT.values(genomes)
    assert LAYOUT.values(LAYOUT.genomes(values)) == pytest.approx(values, abs=1e-6)
    assert LAYOUT.genomes(values).dtype == np.float32


def test_values_outside_their_interval_become_its_borders() -> None:
    genomes = LAYOUT.genomes(np.array([[-0.14, 7.0, 0.0], [0.3, -0.1, 0.0]]))
    assert genomes.tolist() == [[-1, 1, 0], [1, -1, 0]]
    assert LAYOUT.values(genomes)[0, 0] == -0.13
