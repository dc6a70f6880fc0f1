"""How likely a success must be for a simulation."""

import numpy as np
import pytest

from qdgrasp_coordinator.searches.gate import LEAST, SHARE, WANTED, Gate

NONE, ALL = np.zeros(50, bool), np.ones(50, bool)


def wanted(gate: Gate, dead_ends: int = 0) -> float:
    return float(gate.wanted(np.array([dead_ends], np.int32))[0])


def test_less_is_wanted_of_a_cell_after_each_dead_end() -> None:
    each = [wanted(Gate(), dead_ends) for dead_ends in range(5)]
    assert each[0] == WANTED
    assert (np.diff(each) < 0).all()


def test_less_is_wanted_while_hardly_anything_is_simulated() -> None:
    gate = Gate()
    for _ in range(19):  # a run ends after 20 generations without an evaluation
        gate.tell(NONE)
    assert wanted(gate) < 0.15
    gate.tell(ALL)
    assert wanted(gate) < 0.15
    for _ in range(20):
        gate.tell(ALL)
    assert wanted(gate) == pytest.approx(WANTED)


def test_enough_simulations_change_nothing() -> None:
    gate = Gate()
    gate.tell(np.arange(50) < SHARE * 50)
    assert wanted(gate) == WANTED


def test_something_is_always_wanted_and_it_comes_back_from_the_least() -> None:
    gate = Gate()
    for _ in range(10_000):
        gate.tell(NONE)
    assert wanted(gate, 10**6) == wanted(gate) == LEAST
    for _ in range(100):
        gate.tell(ALL)
    assert wanted(gate) == pytest.approx(WANTED)


def test_it_knows_the_share_that_got_through_lately() -> None:
    gate = Gate()
    shares = [gate.share]
    for through in (NONE, np.arange(50) < 10, ALL):
        gate.tell(through)
        shares.append(gate.share)
    assert shares == [1.0, SHARE, 0.2, 1.0]
