import math
from itertools import chain

import numpy as np
import pytest
from tests.coordinator.report.made_runs import climb, made

from qdgrasp_coordinator.report.claims import (
    CLAIMS,
    AgreementBand,
    ClaimAgreement,
    ClaimEvidence,
    ConfidenceInterval,
    GroupsByScene,
    JudgedClaim,
    groups_by_scene,
    judge_claims,
    late_share,
    mean_interval,
    near_nu_share,
    ratio_interval,
    reached_ratio,
    resample,
)
from qdgrasp_coordinator.report.run_groups import group_runs
from qdgrasp_coordinator.report.run_history import RunHistory
from qdgrasp_coordinator.search.registry import METHODS


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


INTERVALS = {
    "equal runs have no spread": (mean_interval([values(3, 3, 3), values(3, 3)]), (3, 3, 3)),
    "that of two runs reaches from one to the other": (mean_interval([values(1, 5)]), (1, 3, 5)),
    "a ratio over nothing": (ratio_interval([values(1, 2)], [values(0, 0)]), (np.inf, np.inf, np.inf)),
    "a ratio of nothing": (ratio_interval([values(0, 0)], [values(1, 2)]), (0, 0, 0)),
}


@pytest.mark.parametrize(("found", "expected"), INTERVALS.values(), ids=INTERVALS)
def test_an_interval_reaches_from_low_to_high_around_its_value(found, expected) -> None:
    assert (found.low, found.value, found.high) == expected


@pytest.mark.parametrize("lone", [mean_interval([values(2)]), ratio_interval([values(2)], [values(1, 3)])])
def test_of_one_run_on_one_scene_there_is_a_number_and_no_interval(lone) -> None:
    assert np.isfinite(lone.value)
    assert not lone.is_known


def test_of_nothing_there_is_no_number() -> None:
    ratios = [ratio_interval([values()], [values(1)]), ratio_interval([values(0)], [values(0)])]
    for found in (mean_interval([]), mean_interval([values()]), *ratios):
        assert np.isnan(found.value)
        assert not found.is_known


def test_scenes_that_differ_widen_an_interval_beyond_that_of_their_runs() -> None:
    scenes = [normal(50, seed, around=3.0 * seed) for seed in range(4)]
    pooled = mean_interval([np.concatenate(scenes)])
    found = mean_interval(scenes)
    assert found.value == pytest.approx(pooled.value)
    assert found.high - found.low > 3 * (pooled.high - pooled.low)


def test_a_scene_weighs_the_same_however_many_runs_and_however_large_its_numbers() -> None:
    assert mean_interval([values(1, 1, 1, 1), values(3)]).value == 2
    few = ratio_interval([values(2, 2), values(1, 1)], [values(1, 1), values(1, 1)])
    large = ratio_interval([values(2000, 2000), values(1, 1)], [values(1000, 1000), values(1, 1)])
    assert large == few
    assert 1 < few.value < 2


def test_the_exchanged_ratio_is_the_reciprocal() -> None:
    a, b = [values(3, 4), values(10, 20, 30)], [values(1, 2), values(9, 9)]
    assert ratio_interval(a, b).value == pytest.approx(1 / ratio_interval(b, a).value)
    assert ratio_interval(a, b).runs == (5, 4)


def test_scenes_without_one_of_the_arms_are_left_out() -> None:
    assert ratio_interval([values(4, 4), values(1, 1)], [values(2, 2), values()]).scenes == 1


def test_the_same_runs_give_the_same_interval() -> None:
    sample = [normal(5, 1), normal(4, 2)]
    assert mean_interval(sample) == mean_interval(sample)
    assert mean_interval(sample) != mean_interval(sample, seed=1)


def test_a_scene_that_is_drawn_twice_has_its_runs_drawn_twice() -> None:
    drawn = resample([(values(0, 1),)], 1000, np.random.default_rng(0))
    assert drawn.shape == (1000, 1, 1)
    two = resample([(values(0, 1),), (values(0, 1),)], 1000, np.random.default_rng(0))[..., 0]
    assert abs(np.corrcoef(two.T)[0, 1]) < 0.1


def runs(method: str, *ends: int, **differing: object) -> list[RunHistory]:
    """A run of a method for each number of cells in the end."""
    return [
        made(method, climb(end // 2, end, every=50), seed=seed, **differing) for seed, end in enumerate(ends)
    ]


def verdicts(*methods: list[RunHistory]) -> dict[str, ClaimAgreement]:
    return {one.claim.letter: one.verdict for one in judge_claims(group_runs(chain(*methods)))}


def test_claims_name_methods_that_exist() -> None:
    named = {name for claim in CLAIMS for names in (*claim.methods, *claim.beside) for name in names}
    assert named <= set(METHODS)
    assert [claim.letter for claim in CLAIMS] == ["a", "b", "c", "d", "e"]


def test_a_campaign_like_the_paper_s_agrees_with_it() -> None:
    found = verdicts(
        runs("contact_me_scs", 100, 104, 98, nu=np.ones(24, np.int64), near=20),
        runs("approach_me_scs", 101, 99, 103),
        runs("me_scs", 3, 1, 2),
        runs("contact_rand", 10, 12, 11),
        runs("approach_rand", 30, 33, 28),
        [made("antipodal_rand", climb(48, 50), seed=seed) for seed in range(3)],
        [made("antipodal_me_scs", climb(40, 41), seed=seed) for seed in range(3)],
    )
    assert set(found.values()) == {ClaimAgreement.AGREES}


def test_a_campaign_unlike_the_paper_s_does_not() -> None:
    found = verdicts(
        runs("contact_me_scs", 10, 11, 12, nu=np.ones(24, np.int64), near=2),
        runs("approach_me_scs", 30, 31, 32),
        runs("me_scs", 40, 41, 42),
        runs("antipodal_rand", 50, 52, 54),
    )
    assert set(found.values()) == {ClaimAgreement.DOES_NOT}


def test_what_a_campaign_lacks_is_said_to_be_absent() -> None:
    found = verdicts(runs("contact_me_scs", 10, 12, nu=np.ones(24, np.int64), near=20))
    assert found.pop("d") is ClaimAgreement.AGREES
    assert set(found.values()) == {ClaimAgreement.ABSENT}


def test_one_run_says_nothing_and_two_that_differ_much_do_not_either() -> None:
    assert verdicts(runs("contact_me_scs", 100), runs("contact_rand", 1))["a"] is ClaimAgreement.UNKNOWN
    wide = verdicts(runs("contact_me_scs", 5, 100), runs("contact_rand", 20, 30))
    assert wide["a"] is ClaimAgreement.UNKNOWN


def test_one_number_against_a_claim_outweighs_those_for_it() -> None:
    against = [*runs("contact_me_scs", 50, 52), *runs("contact_rand", 1, 2), *runs("approach_rand", 90, 95)]
    (a, *_) = judge_claims(group_runs(against))
    assert (a.verdict, len(a.evidence), a.absent_count) == (ClaimAgreement.DOES_NOT, 2, 4)


@pytest.mark.parametrize(
    ("low", "high", "verdict"),
    [
        (1.1, 2.0, ClaimAgreement.AGREES),
        (1.1, math.inf, ClaimAgreement.AGREES),
        (0.9, 2.0, ClaimAgreement.UNKNOWN),
        (0.2, 1.0, ClaimAgreement.DOES_NOT),
        (math.nan, math.nan, ClaimAgreement.UNKNOWN),
    ],
)  # fmt: skip
def test_an_interval_is_in_a_band_or_out_of_it_or_neither(low, high, verdict) -> None:
    assert AgreementBand(1.0, math.inf).verdict(ConfidenceInterval(1.0, low, high, 1, (2, 2))) is verdict
    assert JudgedClaim(CLAIMS[0], (), ()).verdict is ClaimAgreement.ABSENT


def scenes(*found: RunHistory) -> GroupsByScene:
    return groups_by_scene(group_runs(found))


def ratio(*found: RunHistory) -> ClaimEvidence | None:
    return reached_ratio(scenes(*found), "me_scs", "contact_me_scs")


def test_methods_are_compared_after_as_many_evaluations() -> None:
    found = ratio(made("me_scs", climb(10, 80, every=50)), made("contact_me_scs", climb(20), evaluations=60))
    assert (found.interval.value, found.evaluations, found.statistic) == (0.5, (60,), "ratio of cells")


def test_finished_runs_are_compared_where_there_are_any() -> None:
    finished, going = made("me_scs", climb(10)), made("me_scs", climb(99), seed=1, evaluations=20)
    found = ratio(finished, going, *runs("contact_me_scs", 5, 5))
    assert (found.interval.value, found.interval.runs, found.evaluations) == (2.0, (1, 2), (100,))


def test_scenes_that_have_both_methods_count() -> None:
    both = [*runs("me_scs", 2, 2), *runs("contact_me_scs", 8, 8)]
    lone = runs("me_scs", 100, 100, object="mug")
    found = ratio(*both, *lone)
    assert (found.interval.value, found.interval.scenes) == (0.25, 1)
    assert ratio(*lone) is None


def test_what_the_second_half_adds_is_a_share_of_the_end() -> None:
    some, none = made("antipodal_rand", climb(30, 40, every=50)), made("antipodal_rand", climb(), seed=1)
    found = late_share(scenes(some, none), "antipodal_rand")
    assert (found.interval.value, found.interval.runs) == (0.25, (1,))  # a run without a cell has no share


def test_each_run_counts_alike_in_the_share_of_nu() -> None:
    many = made("contact_me_scs", climb(1), nu=np.full(24, 100), near=2400)
    few = made("contact_me_scs", climb(1), seed=1, nu=np.ones(24, np.int64), near=12)
    found = near_nu_share(scenes(many, few, made("contact_me_scs", climb(1), seed=2)), "contact_me_scs")
    assert (found.interval.value, found.interval.runs) == (0.75, (2,))
