"""How fast something was lately."""

import pytest

from qdgrasp_coordinator.counts.speed import LATELY, Speed


@pytest.mark.parametrize("seconds", [1, 5, 60])
def test_a_steady_speed_is_told_from_the_beginning(seconds: int) -> None:
    speed = Speed(100.0)
    for step in range(1, 20 * seconds + 1):
        speed.count(1, 100.0 + step / 20)
    assert speed.at(100.0 + seconds) == pytest.approx(20, rel=0.03)


def test_what_was_long_ago_is_forgotten() -> None:
    speed = Speed(0.0)
    speed.count(1000, 1.0)
    assert speed.at(2.0) > 50
    assert speed.at(10 * LATELY) < 0.02


def test_nothing_was_counted_before_there_was_time() -> None:
    speed = Speed(5.0)
    speed.count(10, 5.0)
    assert speed.at(5.0) == 0.0
