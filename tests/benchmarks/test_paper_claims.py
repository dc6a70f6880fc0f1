"""The paper's claims, judged from the table of results."""

from typing import Any

import pytest
from benchmarks.results.comparison import Arm
from benchmarks.results.paper_claims import claims_part, numbers
from tests.benchmarks.test_results_table import row

from qdgrasp_coordinator.report.claims import ClaimAgreement


def arm(method: str, *ends: float, **values: Any) -> Arm:
    """Runs of a method on the mug with these coverages in the end, by seed from 1 on."""
    rows = {
        seed: row(method, seed, **{"budget": 10_000, "coverage": end, "coverage_5k": end / 2, **values})
        for seed, end in enumerate(ends, start=1)
    }
    return Arm(rows[1].key._replace(seed=0), tuple(rows), rows)


def number(letter: str, *arms: Arm) -> Any:
    return next(one for one in numbers(arms) if one.claim.letter == letter)


FIVE = (0.50, 0.52, 0.49, 0.51, 0.50)


def test_a_ratio_is_of_coverage_after_as_many_evaluations() -> None:
    found = number("b", arm("contact_me_scs", *FIVE), arm("approach_me_scs", *(end / 2 for end in FIVE)))
    assert found.interval(10_000, 5).value == pytest.approx(2.0)
    assert found.verdict(10_000, 5) is ClaimAgreement.DOES_NOT


def test_a_verdict_is_stable_from_where_it_stays() -> None:
    late = arm("approach_me_scs", *FIVE, coverage_1k=0.1, coverage_2k=0.3, coverage_500=0.1, coverage_5k=0.3)
    ours = arm("contact_me_scs", *FIVE, coverage_1k=0.3, coverage_2k=0.3, coverage_500=0.1, coverage_5k=0.3)
    found = number("b", ours, late)
    assert found.verdict(500, 5) is ClaimAgreement.AGREES
    assert found.verdict(1000, 5) is ClaimAgreement.DOES_NOT
    assert found.stable_from() == (2000, 5)


def test_with_four_seeds_there_is_no_verdict() -> None:
    text = claims_part([arm("contact_me_scs", *FIVE[:4]), arm("approach_me_scs", *FIVE)])
    summary, line = (line.split(" | ") for line in text.splitlines() if line.startswith("| b |"))
    assert summary[3].startswith("**cannot be said** (0 of 1 number)")
    assert line[4] == "4"
    assert "few seeds" in line


def test_a_claim_agrees_when_all_its_numbers_do() -> None:
    ends = {"contact_me_scs": 1.0, "approach_me_scs": 1.2, "contact_rand": 0.3, "approach_rand": 1.1}
    text = claims_part([arm(name, *(end * value for value in FIVE)) for name, end in ends.items()])
    verdicts = dict(
        line.split(" | ")[::3] for line in text.splitlines() if line.startswith("| ") and "**" in line
    )
    assert verdicts | {"| d": ""} == {
        "| d": "",
        "| a": "**does not** (3 of 4 numbers) |",
        "| b": "**agrees** (1 of 1 number) |",
    }


def test_the_second_half_is_taken_where_half_of_the_budget_is_a_milestone() -> None:
    found = number("c", arm("antipodal_rand", *FIVE))
    assert found.interval(10_000, 5).value == pytest.approx(0.5)
    assert found.budgets == [1000, 2000, 10_000]
    assert not [*numbers([arm("antipodal_rand", *FIVE, budget=5000)])]


def test_nu_is_that_of_the_end() -> None:
    found = number("d", arm("contact_me_scs", *FIVE, near_nu=0.7))
    assert found.verdict(10_000, 5) is ClaimAgreement.AGREES


def test_longer_runs_make_a_number_of_their_own() -> None:
    long = arm("antipodal_rand", 0.6, 0.6, budget=100_000, coverage_50k=0.57)
    found = [one for one in numbers([arm("antipodal_rand", *FIVE), long]) if one.claim.letter == "c"]
    assert [(one.budgets[-1], one.seeds) for one in found] == [(10_000, 5), (100_000, 2)]
    assert found[1].interval(100_000, 2).value == pytest.approx(0.05)


def test_a_method_with_other_settings_says_nothing_of_it() -> None:
    other = arm("contact_me_scs", *FIVE, settings="population=50")
    assert not [one for one in numbers([other, arm("approach_me_scs", *FIVE)]) if one.claim.letter == "b"]
    assert "No runs of the claims' campaigns are in yet" in claims_part([])
