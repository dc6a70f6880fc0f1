import math
from itertools import chain

import numpy as np
import pytest
from tests.tools.report.made_runs import climb, made

from qdgrasp_coordinator.search.registry import METHODS
from qdgrasp_tools.report.bootstrap import ConfidenceInterval
from qdgrasp_tools.report.claims import (
    CLAIMS,
    AgreementBand,
    ClaimAgreement,
    ClaimEvidence,
    GroupsByScene,
    JudgedClaim,
    groups_by_scene,
    judge_claims,
    late_share,
    near_nu_ratio,
    near_nu_share,
    reached_ratio,
)
from qdgrasp_tools.report.run_groups import group_runs
from qdgrasp_tools.report.run_history import RunHistory


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
    assert [claim.letter for claim in CLAIMS] == [*"abcdefgh"]


def test_a_campaign_like_the_paper_s_agrees_with_it() -> None:
    found = verdicts(
        runs("contact_me_scs", 100, 104, 98, 99, 103, nu=np.ones(24, np.int64), near=20),
        runs("approach_me_scs", 101, 99, 103, 100, 98),
        runs("contact_me_rand", 60, 62, 59, 61, 60, nu=np.ones(24, np.int64), near=20),
        runs("me_scs", 3, 1, 2, 2, 1),
        runs("contact_rand", 10, 12, 11, 9, 10, nu=np.ones(24, np.int64), near=9),
        runs("approach_rand", 30, 33, 28, 29, 31),
        [made("antipodal_rand", climb(48, 50), seed=seed) for seed in range(5)],
        [made("antipodal_me_scs", climb(59, 60), seed=seed) for seed in range(5)],
    )
    assert set(found.values()) == {ClaimAgreement.AGREES}


def test_a_campaign_unlike_the_paper_s_does_not() -> None:
    found = verdicts(
        runs("contact_me_scs", 10, 11, 12, 11, 10, nu=np.ones(24, np.int64), near=2),
        runs("approach_me_scs", 30, 31, 32, 30, 31),
        runs("me_scs", 40, 41, 42, 41, 40),
        runs("antipodal_rand", 50, 52, 54, 52, 50),
        runs("antipodal_me_scs", 20, 22, 24, 22, 20),
        runs("contact_me_rand", 30, 31, 33, 31, 30, nu=np.ones(24, np.int64), near=3),
        runs("contact_rand", 60, 62, 61, 60, 61, nu=np.ones(24, np.int64), near=9),
    )
    assert set(found.values()) == {ClaimAgreement.DOES_NOT}


def test_what_a_campaign_lacks_is_said_to_be_absent() -> None:
    found = verdicts(runs("contact_me_scs", 10, 12, 11, 10, 12, nu=np.ones(24, np.int64), near=20))
    assert found.pop("d") is ClaimAgreement.AGREES
    assert set(found.values()) == {ClaimAgreement.ABSENT}


def test_four_runs_say_nothing_and_five_that_differ_much_do_not_either() -> None:
    four = verdicts(runs("contact_me_scs", 100, 99, 98, 97), runs("contact_rand", 1, 2, 1, 2))
    assert four["a"] is ClaimAgreement.UNKNOWN
    wide = verdicts(runs("contact_me_scs", 5, 100, 9, 80, 30), runs("contact_rand", 20, 30, 25, 20, 30))
    assert wide["a"] is ClaimAgreement.UNKNOWN


def test_one_number_against_a_claim_outweighs_those_for_it() -> None:
    against = [
        *runs("contact_me_scs", 50, 52, 51, 50, 52),
        *runs("contact_rand", 1, 2, 1, 2, 1),
        *runs("approach_rand", 90, 95, 92, 91, 94),
    ]
    (a, *_) = judge_claims(group_runs(against))
    assert (a.verdict, len(a.evidence), a.absent_count) == (ClaimAgreement.DOES_NOT, 2, 1)


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
    assert (found.evaluations, found.statistic) == ((60,), "ratio of cells")
    assert found.interval.value == pytest.approx(0.5)


def test_finished_runs_are_compared_where_there_are_any() -> None:
    finished, going = made("me_scs", climb(10)), made("me_scs", climb(99), seed=1, evaluations=20)
    found = ratio(finished, going, *runs("contact_me_scs", 5, 5))
    assert (found.interval.runs, found.evaluations) == ((1, 2), (100,))
    assert found.interval.value == pytest.approx(2.0)


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
    assert (
        near_nu_ratio(scenes(many, made("contact_rand", climb())), "contact_me_scs", "contact_rand") is None
    )
