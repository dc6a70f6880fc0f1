import numpy as np
import pytest

from qdgrasp_tools.report import bootstrap
from qdgrasp_tools.report.bootstrap import (
    LEAST_RUNS,
    LEAST_SCENES,
    difference_interval,
    mean_interval,
    ratio_interval,
    resample,
)


def values(*numbers: float) -> np.ndarray:
    return np.array(numbers, dtype=np.float64)


def normal(n: int, seed: int, around: float = 0.0) -> np.ndarray:
    return around + np.random.default_rng(seed).normal(size=n)


def test_the_interval_of_a_mean_is_the_one_of_a_normal_sample() -> None:
    sample = normal(400, 1)
    found = mean_interval([sample])
    error = 1.96 * sample.std() / 20
    assert (found.value, found.scenes, found.runs) == (pytest.approx(sample.mean()), 1, (400,))
    assert (found.low, found.high) == pytest.approx(
        (found.value - error, found.value + error), abs=0.1 * error
    )


FIVE = values(1, 2, 3, 4, 5)
INTERVALS = {
    "equal runs have no spread": (mean_interval([values(3, 3, 3, 3, 3)]), (3, 3, 3)),
    "a ratio over nothing": (ratio_interval([FIVE], [0 * FIVE]), (np.inf, np.inf, np.inf)),
    "a ratio of nothing": (ratio_interval([0 * FIVE], [FIVE]), (0, 0, 0)),
}


@pytest.mark.parametrize(("found", "expected"), INTERVALS.values(), ids=INTERVALS)
def test_where_nothing_varies_the_interval_is_its_value(found, expected) -> None:
    assert (found.low, found.value, found.high) == expected


def skewed(random: np.random.Generator, scenes: int, runs: int) -> list[np.ndarray]:
    """Runs of one arm on scenes whose means differ, all skewed and of mean 0."""
    around = random.exponential(1, scenes) - 1 if scenes > 1 else np.zeros(1)
    return [mean + random.exponential(0.5, runs) - 0.5 for mean in around]


@pytest.mark.parametrize(("scenes", "runs", "least"), [(1, 5, 0.9), (1, 10, 0.9), (20, 5, 0.9)])
def test_intervals_hold_the_true_difference_about_as_often_as_they_say(scenes, runs, least, monkeypatch):
    monkeypatch.setattr(bootstrap, "RESAMPLES", 400)
    random = np.random.default_rng(3)
    found = [
        difference_interval(
            skewed(random, scenes, runs), [random.exponential(0.5, runs) - 0.5 for _ in range(scenes)]
        )
        for _ in range(200)
    ]
    assert least <= np.mean([one.low <= 0 <= one.high for one in found]) <= 0.995


@pytest.mark.parametrize("arm", [values(2), normal(LEAST_RUNS - 1, 0)])
def test_of_fewer_than_five_runs_there_is_a_number_and_no_interval(arm) -> None:
    for lone in (mean_interval([arm]), ratio_interval([arm**2], [FIVE]), difference_interval([FIVE], [arm])):
        assert np.isfinite(lone.value)
        assert not lone.is_known
        assert np.isnan(lone.p_value)


def test_many_scenes_do_not_stand_in_for_runs() -> None:
    assert not mean_interval([values(number) for number in range(30)]).is_known


def test_of_nothing_there_is_no_number() -> None:
    ratios = [ratio_interval([values()], [values(1)]), ratio_interval([values(0)], [values(0)])]
    for found in (mean_interval([]), mean_interval([values()]), *ratios):
        assert np.isnan(found.value)
        assert not found.is_known


def test_scenes_that_differ_widen_an_interval_beyond_that_of_their_runs() -> None:
    scenes = [normal(50, seed, around=3.0 * seed) for seed in range(LEAST_SCENES)]
    pooled = mean_interval([np.concatenate(scenes)])
    found = mean_interval(scenes)
    assert found.value == pytest.approx(pooled.value)
    assert found.high - found.low > 2 * (pooled.high - pooled.low)


def test_of_few_scenes_the_interval_is_for_these_scenes_however_they_differ() -> None:
    apart = [normal(6, seed) + 30.0 * seed for seed in range(LEAST_SCENES - 1)]
    alike = [normal(6, seed) for seed in range(LEAST_SCENES - 1)]
    found, same = mean_interval(apart), mean_interval(alike)
    assert found.high - found.low == pytest.approx(same.high - same.low)


def test_a_scene_weighs_the_same_however_many_runs_and_however_large_its_numbers() -> None:
    assert mean_interval([values(1, 1, 1, 1), values(3)]).value == 2
    few = ratio_interval([values(2, 2), values(1, 1)], [values(1, 1), values(1, 1)])
    large = ratio_interval([values(2000, 2000), values(1, 1)], [values(1000, 1000), values(1, 1)])
    assert large.value == few.value
    assert 1 < few.value < 2


def test_exchanged_arms_give_the_reciprocal_and_the_opposite() -> None:
    a, b = [normal(5, 1, 9), normal(6, 2, 20)], [normal(7, 3, 5), normal(5, 4, 30)]
    ratio, back = ratio_interval(a, b), ratio_interval(b, a)
    assert ratio.value == pytest.approx(1 / back.value)
    assert ratio.runs == (11, 12)
    assert difference_interval(a, b).value == pytest.approx(-difference_interval(b, a).value)


def test_scenes_without_one_of_the_arms_are_left_out() -> None:
    assert ratio_interval([FIVE, FIVE], [FIVE, values()]).scenes == 1
    assert difference_interval([FIVE, values()], [FIVE, FIVE]).scenes == 1


def test_the_same_runs_give_the_same_interval() -> None:
    sample = [normal(5, 1), normal(6, 2)]
    assert mean_interval(sample) == mean_interval(sample)
    assert mean_interval(sample) != mean_interval(sample, seed=1)


def test_a_scene_that_is_drawn_twice_has_its_runs_drawn_twice() -> None:
    scenes = [(values(0, 1),), (values(0, 1),)]
    means, variances = resample(scenes, 1000, np.random.default_rng(0), of_others=True)
    assert means.shape == variances.shape == (1000, 2, 1)
    assert abs(np.corrcoef(means[..., 0].T)[0, 1]) < 0.1
    assert set(np.unique(variances)) == {0.0, 0.25}


@pytest.mark.parametrize("shift", [0.0, 0.4, 3.0])
def test_a_p_value_is_below_five_percent_where_the_interval_lacks_zero(shift) -> None:
    found = difference_interval([normal(8, 5, shift)], [normal(8, 6)])
    assert (found.p_value < 0.05) == (not found.low <= 0 <= found.high)


def test_the_p_value_of_a_ratio_is_against_one() -> None:
    alike, apart = ratio_interval([FIVE], [FIVE]), ratio_interval([FIVE + 20], [FIVE])
    assert alike.p_value > 0.9
    assert apart.p_value < 0.01 < apart.low


def test_a_ratio_cannot_be_less_than_nothing_where_runs_differ_much() -> None:
    found = ratio_interval([values(1, 1, 2, 1, 90)] * LEAST_SCENES, [values(1, 40, 1, 1, 1)] * LEAST_SCENES)
    assert 0 < found.low < found.value < found.high < np.inf
