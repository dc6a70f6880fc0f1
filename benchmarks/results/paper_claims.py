"""The paper's claims and its choice of sigma, judged from the table.

Numbers and bands of the claims are those of `qdgrasp analyse` (report/claims.py), taken for each hand from
runs of one budget, every method with its own settings. A verdict is stable from the least budget, and from
the fewest seeds, from which on it is the same as with all of them.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from benchmarks.results.comparison import ANY, COVERAGE, Arm, changed, settings_of
from benchmarks.results.table import MILESTONES
from numpy.typing import NDArray

from qdgrasp_protocol.text import counted
from qdgrasp_tools.report import claims
from qdgrasp_tools.report.bootstrap import (
    CONFIDENCE_LEVEL,
    LEAST_RUNS,
    ConfidenceInterval,
    ratio_interval,
    share_interval,
)
from qdgrasp_tools.report.claims import CLAIMS, ClaimAgreement, PaperClaim, agreement_of_all
from qdgrasp_tools.report.tables import markdown_table

JAW = "panda"
"""The hand for which the paper has antipodal methods."""
CAMPAIGN = "claims"
"""Beginning of the names of the campaigns that the claims are judged from."""
SIGMA_GRID = "sigma-grid"
"""The campaign of the choice of sigma."""
SIGMA_COLUMNS = ("object", "method", "evaluations", "runs")
COLUMNS = (
    "", "number", "hand", "objects", "seeds", "evaluations", "value", "of single objects",
    f"{CONFIDENCE_LEVEL:.0%} interval", "verdict", "stable from evaluations", "from seeds",
)  # fmt: skip

REACHED = ("hand", "object", "evaluations", "method", "runs", "coverage, %", "outside, %")


@dataclass(frozen=True)
class ClaimNumber:
    """One number of a claim over the scenes of a hand that have its methods."""

    claim: PaperClaim
    methods: tuple[str, ...]
    scenes: tuple[tuple[Arm, ...], ...]
    """On each scene the arms of these methods, all of one budget."""
    is_judged: bool
    """False for numbers that only stand beside."""

    @property
    def part(self) -> tuple[str, int]:
        """Hand and budget."""
        key = self.scenes[0][0].key
        return key.gripper, key.budget

    @property
    def objects(self) -> int:
        """The number of objects that it is of."""
        return len({arm.key.object for arms in self.scenes for arm in arms})

    @property
    def seeds(self) -> int:
        """The fewest runs that an arm has."""
        return min(len(arm.rows) for arms in self.scenes for arm in arms)

    @property
    def budgets(self) -> list[int]:
        """Milestones before the budget, and it, ascending: those after which the number is known."""
        end = self.scenes[0][0].key.budget
        found = [*(milestone for milestone in MILESTONES.values() if milestone < end), end]
        if self.claim.measure is claims.late_share:
            return [budget for budget in found if budget // 2 in MILESTONES.values()]
        return [end] if self.claim.measure in OF_THE_END else found

    def interval(self, budget: int, seeds: int) -> ConfidenceInterval:
        """The number after so many evaluations, of the first seeds alone."""
        values = [[_first(arm, seeds) for arm in arms] for arms in self.scenes]
        return MEASURES[self.claim.measure](values, budget)

    def of_single_objects(self, budget: int, seeds: int) -> list[float]:
        """The number of each object alone, ascending; objects where it is not known are left out."""
        alone = (replace(self, scenes=(arms,)).interval(budget, seeds).value for arms in self.scenes)
        return sorted(value for value in alone if not np.isnan(value))

    def verdict(self, budget: int, seeds: int) -> ClaimAgreement:
        """Whether that is in the claim's band."""
        return self.claim.band.verdict(self.interval(budget, seeds))

    def stable_from(self) -> tuple[int, int]:
        """The least budget with all seeds, and the fewest seeds at the end, from which the verdict stays."""
        end, seeds = self.budgets[-1], self.seeds
        by_budget = [(budget, self.verdict(budget, seeds)) for budget in self.budgets]
        by_seeds = [
            (number, self.verdict(end, number)) for number in range(min(LEAST_RUNS, seeds), seeds + 1)
        ]
        return _stable(by_budget), _stable(by_seeds)


def _stable(verdicts: Sequence[tuple[int, ClaimAgreement]]) -> int:
    """The first of the trailing entries that have the last verdict."""
    last = verdicts[-1][1]
    steady = next((i for i, (_, one) in enumerate(reversed(verdicts)) if one is not last), len(verdicts))
    return verdicts[-steady][0]


def _first(arm: Arm, seeds: int) -> Arm:
    return Arm(arm.key, arm.seeds, {seed: arm.rows[seed] for seed in sorted(arm.rows)[:seeds]})


def _reached(arm: Arm, budget: int) -> NDArray[np.float64]:
    """Coverage of each run after so many evaluations; in the end cells, where there is no set."""
    if budget == arm.key.budget:
        return arm.values("coverage") if len(arm.values("coverage")) else arm.values("cells")
    return arm.values(next(f"coverage_{name}" for name, at in MILESTONES.items() if at == budget))


def _ratio(scenes: Sequence[Sequence[Arm]], budget: int) -> ConfidenceInterval:
    upper, lower = ([_reached(arms[place], budget) for arms in scenes] for place in (0, 1))
    return ratio_interval(upper, lower)


def _late(scenes: Sequence[Sequence[Arm]], budget: int) -> ConfidenceInterval:
    """The share that the second half added; half of the budget is a milestone."""
    pairs = [(_reached(arm, budget), _reached(arm, budget // 2)) for (arm,) in scenes]
    return share_interval([1 - halves[ends > 0] / ends[ends > 0] for ends, halves in pairs if len(halves)])


def _near(scenes: Sequence[Sequence[Arm]], budget: int) -> ConfidenceInterval:
    """The share of successes with nu below pi / 4, in the end."""
    return share_interval([arm.values("near_nu") for (arm,) in scenes])


def _near_ratio(scenes: Sequence[Sequence[Arm]], budget: int) -> ConfidenceInterval:
    """The ratio of these shares, in the end."""
    upper, lower = ([arms[place].values("near_nu") for arms in scenes] for place in (0, 1))
    return ratio_interval(upper, lower)


MEASURES: Mapping[Callable[..., object], Callable[[Sequence[Sequence[Arm]], int], ConfidenceInterval]] = {
    claims.reached_ratio: _ratio,
    claims.late_share: _late,
    claims.near_nu_share: _near,
    claims.near_nu_ratio: _near_ratio,
}
"""The measure of a claim on rows, by that on runs."""
OF_THE_END = (claims.near_nu_share, claims.near_nu_ratio)
"""Measures that rows have of the end of a run alone."""


def numbers(known: Iterable[Arm]) -> Iterator[ClaimNumber]:
    """The numbers of all claims whose methods are on a scene together, by hand and budget.

    Each is of the scenes on which its methods have enough seeds for a verdict, or of all where there is no
    such scene. Left out are those that are not known in the end: half of the budget is no milestone, or no
    run has a success.
    """
    parts: dict[tuple[str, int], dict[tuple[str, str, str], dict[str, Arm]]] = {}
    for arm in known:
        if arm.rows and not changed(arm.key):
            scenes = parts.setdefault((arm.key.gripper, arm.key.budget), {})
            scenes.setdefault(arm.key.scene, {})[arm.key.method] = arm
    for claim in CLAIMS:
        judged = [(methods, True) for methods in claim.methods]
        for methods, is_judged in judged + [(methods, False) for methods in claim.beside]:
            for (_, budget), scenes in sorted(parts.items()):
                both = [
                    tuple(arms[name] for name in methods) for arms in scenes.values() if {*methods} <= {*arms}
                ]
                enough = [arms for arms in both if all(len(arm.rows) >= LEAST_RUNS for arm in arms)]
                if here := tuple(enough or both):
                    one = ClaimNumber(claim, methods, here, is_judged)
                    if one.budgets[-1:] == [budget] and not np.isnan(one.interval(budget, one.seeds).value):
                        yield one


def claims_part(known: Iterable[Arm]) -> str:
    """The section of the page."""
    known = list(known)
    found = list(numbers(known))
    head = (
        "## The paper's claims\n\n"
        "Numbers and bands of [Analysis](../analysis.md#claims-and-their-intervals). A claim agrees when "
        "all its numbers do (in brackets: how many of them), and does not when one does not. With fewer "
        f"than {LEAST_RUNS} seeds there is no verdict. A number is of the objects on which its methods "
        "have as many, else of all objects; an object that is left out may say the opposite, and *agrees* "
        "is of the mean over objects, not of each. *Of single objects*: the least and the greatest value of "
        "one object alone. A verdict is *stable* from the least budget with all seeds, and from the fewest "
        f"seeds at the end, from which on it stays the same; of {LEAST_RUNS} seeds all are needed, and "
        "nothing is said. (c) is judged where the table has the figure at half of the budget, too: after "
        "10,000 evaluations, a tenth of the paper's curves, where *does not* means that there is no "
        "plateau yet, and after 100,000. A ratio of 0 with an interval from 0 to 0: no run of the upper "
        "method found a cell of S_G, and five runs cannot say how seldom one does. The paper's curves end "
        "at 100,000 evaluations; its Figure 1 is of all four hands, Figure 2 of Panda and Allegro, and "
        "antipodal methods are of the Panda alone ([the figures from these "
        "runs](../experiment.md#the-figures-from-the-runs-so-far)).\n"
    )
    if not found:
        return f"{head}\nNo runs of the claims' campaigns are in yet.\n"
    reached = (
        "The coverages of S_G that these ratios are of, in percent: median over runs, in brackets their "
        "range. *Outside*: the share of a run's cells that are not in S_G.\n"
    )
    shown = [arm for arm in known if len(arm.values("coverage")) and not changed(arm.key)]
    numbers_table = markdown_table(COLUMNS, [_line(one) for one in found])
    lines = [_coverage_line(arm) for arm in sorted(shown, key=lambda arm: arm.key)]
    image = "![The paper's Figures 1 and 2, and its choice of sigma, from these runs](paper-figures.png)\n"
    return "\n".join((head, _summary(found), image, numbers_table, reached, markdown_table(REACHED, lines)))


def _coverage_line(arm: Arm) -> tuple[str, ...]:
    return (
        arm.key.gripper, arm.key.object, f"{arm.key.budget:,}", f"`{arm.key.method}`", arm.count,
        arm.words(COVERAGE.name, COVERAGE.scale, 2), arm.words("outside_share", 100),
    )  # fmt: skip


def _summary(found: Sequence[ClaimNumber]) -> str:
    """Each claim with its verdict, by hand and budget."""
    parts = sorted({one.part for one in found})
    columns = ("", "claim", "agrees when", *(_heading(found, part) for part in parts))
    lines = []
    for claim in CLAIMS:
        judged = [one for one in found if one.claim is claim and one.is_judged]
        verdicts = (_overall(claim, [one for one in judged if one.part == part]) for part in parts)
        lines.append((claim.letter, claim.words, claim.criterion, *verdicts))
    return markdown_table(columns, lines)


def _heading(found: Sequence[ClaimNumber], part: tuple[str, int]) -> str:
    """Hand, budget, and the numbers of objects, the least and the most of any number."""
    hand, budget = part
    here = [one for one in found if one.part == part]
    objects = {one.objects for one in here if one.is_judged} or {one.objects for one in here}
    least = f"{min(objects)} to " if len(objects) > 1 else ""
    return f"{hand}, {budget:,}, {least}{counted(max(objects), 'object')}"


def _overall(claim: PaperClaim, judged: Sequence[ClaimNumber]) -> str:
    """The verdict on the numbers of a claim with a hand, and how many of these agree."""
    if not judged:
        return ""
    verdicts = [one.verdict(one.budgets[-1], one.seeds) for one in judged]
    hand, agreeing = judged[0].part[0], verdicts.count(ClaimAgreement.AGREES)
    wanted = sum(hand == JAW or not any("antipodal" in name for name in names) for names in claim.methods)
    absent = [ClaimAgreement.UNKNOWN] * (len(judged) < wanted)
    return f"**{agreement_of_all([*verdicts, *absent]).value}** ({agreeing} of {wanted})"


def _line(one: ClaimNumber) -> tuple[str, ...]:
    end, seeds = one.budgets[-1], one.seeds
    found, alone = one.interval(end, seeds), one.of_single_objects(end, seeds)
    verdict = one.claim.band.verdict(found).value if found.is_known else "few seeds"
    budget, fewest = one.stable_from() if found.is_known and one.is_judged else (None, None)
    return (
        one.claim.letter, " / ".join(f"`{name}`" for name in one.methods),
        one.part[0], str(one.objects),
        str(seeds), f"{end:,}", f"{found.value:.3g}",
        f"{alone[0]:.3g} to {alone[-1]:.3g}" if len(alone) > 1 else "",
        f"{found.low:.3g} to {found.high:.3g}" if found.is_known else "",
        verdict if one.is_judged else "to compare with",
        "" if budget is None or len(one.budgets) == 1 else f"{budget:,}",
        "" if fewest is None or seeds == LEAST_RUNS else str(fewest),
    )  # fmt: skip


def sigma_part(known: Iterable[Arm]) -> str:
    """The section on the choice of sigma; empty while no run is in."""
    groups: dict[tuple[str, str, int], dict[float, Arm]] = {}
    for arm in known:
        if len(arm.values(COVERAGE.name)):
            groups.setdefault((arm.key.object, arm.key.method, arm.key.budget), {})[sigma_of(arm)] = arm
    if not groups:
        return ""
    sigmas = sorted({sigma for group in groups.values() for sigma in group})
    columns = (*SIGMA_COLUMNS, *(f"{sigma:g}" for sigma in sigmas), "0.1 of the best, %")
    return (
        "## The mutation's sigma\n\n"
        "The paper chose 0.1 for all methods, by a grid search after 20,000 evaluations, as the best values "
        "hardly differed between methods. Coverage of S_G in percent by sigma, Panda: median over runs, in "
        "brackets their range; the best median of a line stands out. *0.1 of the best*: the median with 0.1 "
        "over the best, which of several values is favoured by chance.\n\n"
        + markdown_table(columns, [_sigma_line(*one, sigmas) for one in groups.items()])
    )


def sigma_of(arm: Arm) -> float:
    """The mutation's sigma of the runs of an arm."""
    return float(settings_of(arm.key).get("mutation_sigma", ANY.mutation_sigma))


def _sigma_line(
    group: tuple[str, str, int], by_sigma: Mapping[float, Arm], sigmas: Sequence[float]
) -> tuple[str, ...]:
    scene_object, method, evaluations = group
    reached = {sigma: float(np.median(arm.values(COVERAGE.name))) for sigma, arm in by_sigma.items()}
    best = max(reached, key=reached.__getitem__)
    shown = {sigma: arm.words(COVERAGE.name, COVERAGE.scale, 2) for sigma, arm in by_sigma.items()}
    shown[best] = f"**{shown[best]}**"
    usual = reached.get(ANY.mutation_sigma)
    return (
        scene_object, f"`{method}`", f"{evaluations:,}", str(sum(len(arm.rows) for arm in by_sigma.values())),
        *(shown.get(sigma, "") for sigma in sigmas),
        "" if usual is None or not reached[best] else f"{100 * usual / reached[best]:.0f}",
    )  # fmt: skip
