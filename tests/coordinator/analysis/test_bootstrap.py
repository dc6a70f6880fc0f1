import numpy as np
import pytest

from qdgrasp_coordinator.analysis.bootstrap import mean, ratio, resampled


def values(*numbers: float) -> np.ndarray:
    return np.array(numbers, dtype=np.float64)


def normal(n: int, seed: int, around: float = 0.0) -> np.ndarray:
    return around + np.random.default_rng(seed).normal(size=n)


def test_the_interval_of_a_mean_is_the_one_of_a_normal_sample() -> None:
    sample = normal(400, 1)
    found = mean([sample])
    error = 1.96 * sample.std() / 20
    assert (found.value, found.scenes, found.runs) == (pytest.approx(sample.mean()), 1, (400,))
    assert (found.low, found.high) == pytest.approx(
        (found.value - error, found.value + error), abs=0.1 * error
    )


def test_equal_runs_have_no_spread() -> None:
    found = mean([values(3, 3, 3), values(3, 3)])
    assert (found.low, found.value, found.high) == (3, 3, 3)


def test_of_two_runs_the_interval_reaches_from_one_to_the_other() -> None:
    found = mean([values(1, 5)])
    assert (found.low, found.value, found.high) == (1, 3, 5)


@pytest.mark.parametrize("lone", [mean([values(2)]), ratio([values(2)], [values(1, 3)])])
def test_of_one_run_on_one_scene_there_is_a_number_and_no_interval(lone) -> None:
    assert np.isfinite(lone.value)
    assert not lone.is_known


def test_of_nothing_there_is_no_number() -> None:
    for found in (
        mean([]),
        mean([values()]),
        ratio([values()], [values(1)]),
        ratio([values(0)], [values(0)]),
    ):
        assert np.isnan(found.value)
        assert not found.is_known


def test_scenes_that_differ_widen_an_interval_beyond_that_of_their_runs() -> None:
    scenes = [normal(50, seed, around=3.0 * seed) for seed in range(4)]
    pooled = mean([np.concatenate(scenes)])
    found = mean(scenes)
    assert found.value == pytest.approx(pooled.value)
    assert found.high - found.low > 3 * (pooled.high - pooled.low)


def test_a_scene_weighs_the_same_however_many_runs_and_however_large_its_numbers() -> None:
    assert mean([values(1, 1, 1, 1), values(3)]).value == 2
    few = ratio([values(2, 2), values(1, 1)], [values(1, 1), values(1, 1)])
    large = ratio([values(2000, 2000), values(1, 1)], [values(1000, 1000), values(1, 1)])
    assert large == few
    assert 1 < few.value < 2


def test_the_exchanged_ratio_is_the_reciprocal() -> None:
    a, b = [values(3, 4), values(10, 20, 30)], [values(1, 2), values(9, 9)]
    assert ratio(a, b).value == pytest.approx(1 / ratio(b, a).value)
    assert ratio(a, b).runs == (5, 4)


def test_the_ratio_over_what_found_nothing_is_infinite() -> None:
    found = ratio([values(1, 2)], [values(0, 0)])
    assert (found.value, found.low, found.high) == (np.inf, np.inf, np.inf)
    assert ratio([values(0, 0)], [values(1, 2)]).high == 0


def test_scenes_without_one_of_the_arms_are_left_out() -> None:
    assert ratio([values(4, 4), values(1, 1)], [values(2, 2), values()]).scenes == 1


def test_the_same_runs_give_the_same_interval() -> None:
    sample = [normal(5, 1), normal(4, 2)]
    assert mean(sample) == mean(sample)
    assert mean(sample) != mean(sample, seed=1)


def test_a_scene_that_is_drawn_twice_has_its_runs_drawn_twice() -> None:
    drawn = resampled([(values(0, 1),)], 1000, np.random.default_rng(0))
    assert drawn.shape == (1000, 1, 1)
    two = resampled([(values(0, 1),), (values(0, 1),)], 1000, np.random.default_rng(0))[..., 0]
    assert abs(np.corrcoef(two.T)[0, 1]) < 0.1
