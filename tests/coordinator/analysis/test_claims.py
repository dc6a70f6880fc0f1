import math
from itertools import chain

import numpy as np
import pytest
from tests.coordinator.analysis.runs import climb, made

from qdgrasp_coordinator.analysis.bootstrap import Interval
from qdgrasp_coordinator.analysis.claims import CLAIMS, Agreement, Band, Judged, judged
from qdgrasp_coordinator.analysis.entries import entries
from qdgrasp_coordinator.analysis.findings import by_scene, late, near, reached
from qdgrasp_coordinator.analysis.history import History
from qdgrasp_coordinator.searches.search import METHODS


def runs(method: str, *ends: int, **differing: object) -> list[History]:
    """A run of a method for each number of cells in the end."""
    return [
        made(method, climb(end // 2, end, every=50), seed=seed, **differing) for seed, end in enumerate(ends)
    ]


def verdicts(*methods: list[History]) -> dict[str, Agreement]:
    return {one.claim.letter: one.verdict for one in judged(entries(chain(*methods)))}


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
    assert set(found.values()) == {Agreement.AGREES}


def test_a_campaign_unlike_the_paper_s_does_not() -> None:
    found = verdicts(
        runs("contact_me_scs", 10, 11, 12, nu=np.ones(24, np.int64), near=2),
        runs("approach_me_scs", 30, 31, 32),
        runs("me_scs", 40, 41, 42),
        runs("antipodal_rand", 50, 52, 54),
    )
    assert set(found.values()) == {Agreement.DOES_NOT}


def test_what_a_campaign_lacks_is_said_to_be_absent() -> None:
    found = verdicts(runs("contact_me_scs", 10, 12, nu=np.ones(24, np.int64), near=20))
    assert found.pop("d") is Agreement.AGREES
    assert set(found.values()) == {Agreement.ABSENT}


def test_one_run_says_nothing_and_two_that_differ_much_do_not_either() -> None:
    assert verdicts(runs("contact_me_scs", 100), runs("contact_rand", 1))["a"] is Agreement.UNKNOWN
    wide = verdicts(runs("contact_me_scs", 5, 100), runs("contact_rand", 20, 30))
    assert wide["a"] is Agreement.UNKNOWN


def test_one_number_against_a_claim_outweighs_those_for_it() -> None:
    (a, *_) = judged(
        entries(
            [*runs("contact_me_scs", 50, 52), *runs("contact_rand", 1, 2), *runs("approach_rand", 90, 95)]
        )
    )
    assert (a.verdict, len(a.findings), a.absent) == (Agreement.DOES_NOT, 2, 4)


@pytest.mark.parametrize(
    ("low", "high", "verdict"),
    [
        (1.1, 2.0, Agreement.AGREES),
        (1.1, math.inf, Agreement.AGREES),
        (0.9, 2.0, Agreement.UNKNOWN),
        (0.2, 1.0, Agreement.DOES_NOT),
        (math.nan, math.nan, Agreement.UNKNOWN),
    ],
)  # fmt: skip
def test_an_interval_is_in_a_band_or_out_of_it_or_neither(
    low: float, high: float, verdict: Agreement
) -> None:
    assert Band(1.0, math.inf).verdict(Interval(1.0, low, high, 1, (2, 2))) is verdict
    assert Judged(CLAIMS[0], (), ()).verdict is Agreement.ABSENT


def test_methods_are_compared_after_as_many_evaluations() -> None:
    scenes = by_scene(
        entries([made("me_scs", climb(10, 80, every=50)), made("contact_me_scs", climb(20), evaluations=60)])
    )
    found = reached(scenes, "me_scs", "contact_me_scs")
    assert found is not None
    assert (found.interval.value, found.evaluations, found.statistic) == (0.5, (60,), "ratio of cells")


def test_finished_runs_are_compared_where_there_are_any() -> None:
    finished, going = made("me_scs", climb(10)), made("me_scs", climb(99), seed=1, evaluations=20)
    found = reached(
        by_scene(entries([finished, going, *runs("contact_me_scs", 5, 5)])), "me_scs", "contact_me_scs"
    )
    assert found is not None
    assert (found.interval.value, found.interval.runs, found.evaluations) == (2.0, (1, 2), (100,))


def test_scenes_that_have_both_methods_count() -> None:
    both = [*runs("me_scs", 2, 2), *runs("contact_me_scs", 8, 8)]
    lone = runs("me_scs", 100, 100, object="mug")
    found = reached(by_scene(entries([*both, *lone])), "me_scs", "contact_me_scs")
    assert found is not None
    assert (found.interval.value, found.interval.scenes) == (0.25, 1)
    assert reached(by_scene(entries(lone)), "me_scs", "contact_me_scs") is None


def test_what_the_second_half_adds_is_a_share_of_the_end() -> None:
    scenes = by_scene(
        entries([made("antipodal_rand", climb(30, 40, every=50)), made("antipodal_rand", climb(), seed=1)])
    )
    found = late(scenes, "antipodal_rand")
    assert found is not None
    assert (found.interval.value, found.interval.runs) == (0.25, (1,))  # a run without a cell has no share


def test_each_run_counts_alike_in_the_share_of_nu() -> None:
    many = made("contact_me_scs", climb(1), nu=np.full(24, 100), near=2400)
    few = made("contact_me_scs", climb(1), seed=1, nu=np.ones(24, np.int64), near=12)
    none = made("contact_me_scs", climb(1), seed=2)
    found = near(by_scene(entries([many, few, none])), "contact_me_scs")
    assert found is not None
    assert (found.interval.value, found.interval.runs) == (0.75, (2,))
