"""The default method against every other, after as many evaluations."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from benchmarks.results.programme import Programme
from benchmarks.results.table import Key, Row
from numpy.typing import NDArray

from qdgrasp_coordinator.report import claims
from qdgrasp_coordinator.report.claims import CONFIDENCE_LEVEL, RESAMPLES, ConfidenceInterval
from qdgrasp_coordinator.report.tables import markdown_table
from qdgrasp_coordinator.search.registry import method
from qdgrasp_protocol.spec import RunSpec

ANY = RunSpec(gripper="any", object="any")
DEFAULT = ANY.method
"""The method of a run that names none."""
CODE = 6
"""Digits of a digest that tell it from others on a page."""
COUNTING = {"count": "every pose counted", "redraw": "overlaps redrawn"}


@dataclass(frozen=True)
class Arm:
    """Runs of the programme with one spec but for the seed."""

    key: Key
    """Of any of them; the seed means nothing."""
    seeds: tuple[int, ...]
    """Those that are wanted."""
    rows: Mapping[int, Row]
    """Those that are in the table, by seed."""

    @property
    def scene(self) -> tuple[str, str, str]:
        """Hand, object and protocol."""
        return self.key.gripper, self.key.object, self.key.protocol

    @property
    def method(self) -> str:
        """The method, with those of its settings that are not as it has them."""
        return f"`{self.key.method}`" + (f" ({', '.join(changes)})" if (changes := changed(self.key)) else "")

    @property
    def is_default(self) -> bool:
        """Whether its method is the default one, with its own settings."""
        return self.key.method == DEFAULT and not changed(self.key)

    @property
    def count(self) -> str:
        """How many of its runs are in, in words."""
        whole, here = len(self.seeds), len(self.rows)
        return str(whole) if here == whole else f"{here} of {whole}"

    @property
    def codes(self) -> str:
        """Beginnings of the digests of its runs' evaluation code."""
        return ", ".join(f"`{code[:CODE]}`" for code in sorted({row.code for row in self.rows.values()}))

    def values(self, figure: str, scale: float = 1.0) -> NDArray[np.float64]:
        """A figure of each run that has it (n,), by seed."""
        found = [getattr(self.rows[seed], figure) for seed in sorted(self.rows)]
        return scale * np.array([value for value in found if value is not None], dtype=np.float64)

    def words(self, figure: str, scale: float = 1.0, digits: int = 1) -> str:
        """The median of a figure, and in brackets its range where there are several runs."""
        return spread(self.values(figure, scale), digits)


def arms(known: Programme, table: Mapping[Key, Row]) -> list[Arm]:
    """The arms of a programme, by hand, object, protocol and method."""
    groups: dict[Key, list[Key]] = {}
    for asked in sorted(known.wanted):
        groups.setdefault(asked._replace(seed=0), []).append(asked)
    return [
        Arm(arm, tuple(one.seed for one in runs), {one.seed: table[one] for one in runs if one in table})
        for arm, runs in groups.items()
    ]


def changed(key: Key) -> list[str]:
    """The settings of a run that are not those of a campaign's run of its method."""
    said = {f"population={ANY.population}"} if "population=" not in key.settings else set()
    return sorted({*said, *key.settings.split()} - {f"population={method(key.method).population}"})


def spread(values: NDArray[np.float64], digits: int = 1) -> str:
    """The median of some numbers, and in brackets their range where there are several."""
    if not len(values):
        return ""
    low, middle, high = (f"{value:.{digits}f}" for value in (values.min(), np.median(values), values.max()))
    return middle if len(values) == 1 else f"{middle} ({low} to {high})"


@dataclass(frozen=True)
class Figure:
    """What two arms are compared by."""

    name: str
    words: str
    scale: float = 1.0
    digits: int = 1


COVERAGE = Figure("coverage", "coverage, %", 100)
CELLS = Figure("cells", "cells", digits=0)
BESIDE = (
    Figure("robust_coverage", "robust coverage, %", 100),
    Figure("mean_best", "mean best fitness", digits=2),
    Figure("orientations", "orientations", digits=2),
    Figure("niches", "niches", digits=0),
)
"""What stands beside, so that coverage is not bought with worse grasps."""
VERDICT = ("difference", f"{CONFIDENCE_LEVEL:.0%} interval", "verdict")
COMPARISON_COLUMNS = (
    "hand", "object", "against", "seeds", "of", "default", "other", *VERDICT,
    *(figure.words for figure in BESIDE), "code",
)  # fmt: skip
POOLED = ("hand", "against", "objects", "of", *VERDICT)
BEHIND = ("behind in", "hand", "object", "by a loss to", "else to")


@dataclass(frozen=True)
class MethodComparison:
    """The default method and another on one scene, run by run of the same seed."""

    ours: Arm
    theirs: Arm

    @property
    def seeds(self) -> list[int]:
        """Those that both have run."""
        return sorted(self.ours.rows)

    @property
    def figure(self) -> Figure:
        """Coverage where the scene has a set, else cells."""
        return COVERAGE if len(self.differences(COVERAGE)) else CELLS

    def differences(self, figure: Figure) -> NDArray[np.float64]:
        """Ours less theirs for each seed that has the figure in both arms (n,)."""
        pairs = [
            [getattr(arm.rows[seed], figure.name) for arm in (self.ours, self.theirs)] for seed in self.seeds
        ]
        return figure.scale * np.array(
            [ours - theirs for ours, theirs in pairs if None not in (ours, theirs)]
        )

    @property
    def codes(self) -> str:
        """The evaluation code of both, the default's first where they are not alike."""
        ours, theirs = self.ours.codes, self.theirs.codes
        return f"{ours} / {theirs}" if self.is_mixed else ours

    @property
    def is_mixed(self) -> bool:
        """Whether not all runs are of one evaluation code."""
        return len({row.code for arm in (self.ours, self.theirs) for row in arm.rows.values()}) > 1


def compare_arms(ours: Arm, theirs: Arm) -> MethodComparison:
    """Two arms, each with the seeds alone that both have run: medians are of what differences are of."""
    both = ours.rows.keys() & theirs.rows.keys()
    alike = [replace(arm, rows={seed: arm.rows[seed] for seed in both}) for arm in (ours, theirs)]
    return MethodComparison(*alike)


def compare_methods(known: Sequence[Arm]) -> dict[tuple[str, str, int], list[MethodComparison]]:
    """The default against each other method of its scene and budget; by both countings and the budget."""
    groups: dict[tuple[str, str, int], list[MethodComparison]] = {}
    for ours in (arm for arm in known if arm.is_default):
        for theirs in known:
            alike = (ours.scene, ours.key.budget) == (theirs.scene, theirs.key.budget)
            countings = ours.key.overlaps, theirs.key.overlaps
            if alike and not theirs.is_default and countings != ("count", "redraw"):
                groups.setdefault((*countings, ours.key.budget), []).append(compare_arms(ours, theirs))
    return groups


def comparison_part(known: Sequence[Arm]) -> str:
    """The section on comparisons."""
    return (
        "## The default method against the others\n\n"
        "After equally many counted evaluations. A difference is the mean over seeds of the default's figure "
        "less the other's in runs of the same seed; its interval is a bootstrap of these pairs, "
        f"{RESAMPLES:,} resamples (over several objects: of objects and of the pairs on each). *Win* and "
        "*loss*: the whole interval is on one side of 0; with few seeds it is narrower than it says. Of the "
        "other figures the default's median stands first, then the other's; *orientations* is a mean over "
        "all cells with a success, which whoever finds more cells lowers: read it beside *niches*. "
        "*Code*: which evaluation code the runs are of; where it is not the same, the default's stands "
        "first.\n\n" + "\n".join(_groups(known))
    )


def _groups(known: Sequence[Arm]) -> Iterator[str]:
    for (ours, theirs, budget), group in sorted(
        compare_methods(known).items(), key=lambda item: item[0][::-1]
    ):
        fought = [duel for duel in group if duel.seeds]
        counting = COUNTING[ours] if ours == theirs else f"{COUNTING[theirs]}; default: {COUNTING[ours]}"
        yield f"### {budget:,} evaluations, {counting}\n"
        if fought:
            yield markdown_table(COMPARISON_COLUMNS, [_line(duel) for duel in fought])
            yield "\n".join(_losses(fought)) + "\n"
        if over_objects := list(_pooled(fought)):
            yield markdown_table(POOLED, over_objects)
        if len(fought) < len(group):
            yield f"{len(group) - len(fought)} of {len(group)} comparisons are not in yet.\n"


def _line(duel: MethodComparison) -> tuple[str, ...]:
    figure, found = duel.figure, _interval([duel.differences(duel.figure)])
    return (
        duel.ours.key.gripper, duel.ours.key.object, duel.theirs.method, str(len(duel.seeds)),
        figure.words, duel.ours.words(figure.name, figure.scale, figure.digits),
        duel.theirs.words(figure.name, figure.scale, figure.digits), *_number(found, figure), verdict(found),
        *(_beside(duel, other) for other in BESIDE), duel.codes,
    )  # fmt: skip


def _pooled(fought: Sequence[MethodComparison]) -> Iterator[tuple[str, ...]]:
    """The same for each hand and method over its objects that have a figure alike."""
    groups: dict[tuple[str, str, Figure], list[MethodComparison]] = {}
    for duel in fought:
        groups.setdefault((duel.ours.key.gripper, duel.theirs.method, duel.figure), []).append(duel)
    for (hand, rival, figure), group in groups.items():
        if len(group) > 1:
            found = _interval([duel.differences(figure) for duel in group])
            yield hand, rival, str(len(group)), figure.words, *_number(found, figure), verdict(found)


def _losses(fought: Sequence[MethodComparison]) -> Iterator[str]:
    """How often the default won, and every figure in which it is behind: a table where there are any."""
    verdicts = [verdict(_interval([duel.differences(duel.figure)])) for duel in fought]
    said = ", ".join(f"{words} {verdicts.count(one)}" for one, words in VERDICTS.items() if one in verdicts)
    lost = {label(figure): list(_behind(fought, figure)) for figure in (None, *BESIDE)}
    unlost = "; ".join(name for name, lines in lost.items() if not lines)
    yield f"In coverage, or cells: {said}. Behind nowhere in: {unlost or 'no figure'}."
    if mixed := sum(duel.is_mixed for duel in fought):
        yield f"Of two evaluation codes: {mixed} of {len(fought)}, whose difference may be the codes'."
    if lines := [line for some in lost.values() for line in some]:
        yield "\n" + markdown_table(BEHIND, lines).rstrip("\n")


VERDICTS = {"win": "wins", "loss": "losses", "level": "level", "one seed": "of one seed"}


def verdict(found: ConfidenceInterval) -> str:
    """Who is ahead for certain."""
    if not found.is_known:
        return "one seed"
    return "win" if found.low > 0 else "loss" if found.high < 0 else "level"


def _behind(fought: Sequence[MethodComparison], figure: Figure | None) -> Iterator[tuple[str, ...]]:
    """For each hand and object where the default is behind in a figure: whom, and by how much, most first."""
    groups: dict[tuple[str, str], list[tuple[float, str, str]]] = {}
    for duel in fought:
        measure = figure or duel.figure
        differences = duel.differences(measure)
        if len(differences) and (by := -differences.mean()) > 0:
            group = groups.setdefault((duel.ours.key.gripper, duel.ours.key.object), [])
            words = f"{duel.theirs.method} {by:.{measure.digits}f}"
            group.append((by, words, verdict(_interval([differences]))))
    for (hand, thing), group in groups.items():
        sure, unsure = (
            ", ".join(
                words for _, words, found in sorted(group, reverse=True) if (found == "loss") is certain
            )
            for certain in (True, False)
        )
        yield label(figure), hand, thing, sure, unsure


def label(figure: Figure | None) -> str:
    """A figure's name without its unit; None: coverage, or cells where there is no set."""
    return "coverage, or cells" if figure is None else figure.words.removesuffix(", %")


def _beside(duel: MethodComparison, figure: Figure) -> str:
    medians = [arm.values(figure.name, figure.scale) for arm in (duel.ours, duel.theirs)]
    return " / ".join(f"{np.median(values):.{figure.digits}f}" if len(values) else "-" for values in medians)


def _interval(differences: list[NDArray[np.float64]]) -> ConfidenceInterval:
    return claims.mean_interval(differences)


def _number(found: ConfidenceInterval, figure: Figure) -> tuple[str, str]:
    digits = figure.digits
    interval = f"{found.low:+.{digits}f} to {found.high:+.{digits}f}" if found.is_known else ""
    return f"{found.value:+.{digits}f}", interval
