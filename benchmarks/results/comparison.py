"""The default method against every other, after as many evaluations and after as many CPU seconds."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from benchmarks.results.programme import Programme
from benchmarks.results.table import CPU_MILESTONES, Key, Row
from numpy.typing import ArrayLike, NDArray

from qdgrasp_coordinator.search.registry import method
from qdgrasp_protocol.spec import RunSpec
from qdgrasp_tools.report.bootstrap import (
    CONFIDENCE_LEVEL,
    LEAST_RUNS,
    LEAST_SCENES,
    RESAMPLES,
    ConfidenceInterval,
    ScenesOfRuns,
    difference_interval,
    ratio_interval,
)
from qdgrasp_tools.report.tables import markdown_table

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
    """Key of any of its runs; the seed means nothing."""
    seeds: tuple[int, ...]
    """Seeds of the wanted runs."""
    rows: Mapping[int, Row]
    """Rows of the table, by seed."""

    @property
    def method(self) -> str:
        """The method, with the settings that differ from its own."""
        aims = "" if self.key.method != DEFAULT or "aim_for" in settings_of(self.key) else " for touch"
        return f"`{self.key.method}`{aims}" + (
            f" ({', '.join(found)})" if (found := changed(self.key)) else ""
        )

    @property
    def is_default(self) -> bool:
        """Whether its method is the default one, with its own settings, whatever it aims for."""
        return self.key.method == DEFAULT and not changed(self.key)

    @property
    def is_complete(self) -> bool:
        """Whether all its runs are finished."""
        return len(self.rows) == len(self.seeds)

    @property
    def count(self) -> str:
        """The number of its finished runs, in words."""
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


SCENE_SETTINGS = ("surface_seed", "base")
"""Settings of a scene rather than of its method."""


def settings_of(key: Key) -> dict[str, str]:
    """The settings in a key by their names."""
    return dict(word.partition("=")[::2] for word in key.settings.split())


def changed(key: Key) -> list[str]:
    """The settings of a run that are not those of a campaign's run of its method."""
    usual = {"population": str(method(key.method).population), "aim_for": "hold", "in_flight": "400"}
    said = {"population": str(ANY.population)} | settings_of(key)
    return sorted(
        f"{name}={value}"
        for name, value in said.items()
        if name not in SCENE_SETTINGS and usual.get(name) != value
    )


def spread(values: NDArray[np.float64], digits: int = 1) -> str:
    """The median of some numbers, and in brackets their range where there are several."""
    if not len(values):
        return ""
    low, middle, high = (f"{value:.{digits}f}" for value in (values.min(), np.median(values), values.max()))
    return middle if len(values) == 1 else f"{middle} ({low} to {high})"


@dataclass(frozen=True)
class Figure:
    """A figure that two arms are compared by."""

    name: str
    words: str
    scale: float = 1.0
    digits: int = 1


COVERAGE = Figure("coverage", "coverage, %", 100)
CELLS = Figure("cells", "cells", digits=0)
ROBUST_CELLS = Figure("robust_cells", "cells that hold", digits=0)
ROBUST_NICHES = Figure("robust_niches", "niches that hold", digits=0)
BESIDE = (
    Figure("mean_best", "mean best fitness", digits=2),
    Figure("orientations", "orientations", digits=2),
)
OF_TOUCH = (
    Figure("robust_share", "robust share of S_G, %", 100),
    *BESIDE,
    Figure("niches", "niches", digits=0),
)
"""Further figures, which show if coverage comes with worse grasps."""
OF_HOLD = (ROBUST_NICHES, Figure("qd_score", "QD score", digits=0), *BESIDE)
"""Further figures under `physical`."""
SCREENED = Figure("screened", "poses screened")
BOTH_CELLS = Figure("both_cells", "cells that hold in both", digits=0)
"""Figures without a loss: the one is a cost, the other an estimate of few drawn grasps."""
LEAST_P_VALUE = 2 / (RESAMPLES + 1)
"""The least p-value that so many resamples can give."""
SIGNIFICANT = 1 - CONFIDENCE_LEVEL
"""An adjusted p-value of at most this is a win or a loss."""
VERDICT = ("difference", f"{CONFIDENCE_LEVEL:.0%} interval", "adjusted p", "verdict")
COMPARED = ("hand", "object", "against", "seeds", "of", "default", "other", *VERDICT)
POOLED = ("hand", "against", "objects", "of", *VERDICT)
BEHIND = ("behind in", "hand", "object", "by a loss to", "else to")


@dataclass(frozen=True)
class MethodComparison:
    """The default method and another on one scene; their runs share no random numbers, and are not paired."""

    ours: Arm
    theirs: Arm

    @property
    def has_runs(self) -> bool:
        """Whether both have runs."""
        return bool(self.ours.rows and self.theirs.rows)

    @property
    def seeds(self) -> str:
        """Numbers of runs of both, one number where they are equal."""
        ours, theirs = len(self.ours.rows), len(self.theirs.rows)
        return str(ours) if ours == theirs else f"{ours} / {theirs}"

    @property
    def figure(self) -> Figure:
        """Cells that hold under `physical`; else coverage where the scene has a set, else cells."""
        if self.ours.key.protocol.startswith("physical"):
            return ROBUST_CELLS
        has_set = all(len(arm.values(COVERAGE.name)) for arm in (self.ours, self.theirs))
        return COVERAGE if has_set else CELLS

    def pair(self, figure: Figure) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """A figure of the runs of both."""
        ours, theirs = (arm.values(figure.name, figure.scale) for arm in (self.ours, self.theirs))
        return ours, theirs

    def difference(self, figure: Figure) -> ConfidenceInterval:
        """The default's mean less the other's."""
        return over_scenes(difference_interval, [self], figure)

    @cached_property
    def found(self) -> ConfidenceInterval:
        """The difference in the figure that decides."""
        return self.difference(self.figure)

    @property
    def is_physical(self) -> bool:
        """Whether it is about grasps that hold."""
        return self.figure is ROBUST_CELLS

    @property
    def beside(self) -> tuple[Figure, ...]:
        """Figures in which the default may be behind, other than the one that decides."""
        return OF_HOLD if self.is_physical else OF_TOUCH

    def equal_cpu(self) -> tuple[int, tuple[NDArray[np.float64], NDArray[np.float64]]] | None:
        """The most CPU seconds of the milestones that all runs of both took, and cells that hold after them.

        None where a run took fewer than the first milestone.
        """
        runs = [*self.ours.rows.values(), *self.theirs.rows.values()]
        for name, seconds in reversed(CPU_MILESTONES.items()):
            if all(getattr(row, f"robust_cells_{name}") is not None for row in runs):
                ours, theirs = (arm.values(f"robust_cells_{name}") for arm in (self.ours, self.theirs))
                return seconds, (ours, theirs)
        return None

    @property
    def codes(self) -> str:
        """The evaluation code of both, the default's first where they differ."""
        ours, theirs = self.ours.codes, self.theirs.codes
        return f"{ours} / {theirs}" if self.is_mixed else ours

    @property
    def is_mixed(self) -> bool:
        """Whether not all runs are of one evaluation code."""
        return len({row.code for arm in (self.ours, self.theirs) for row in arm.rows.values()}) > 1


def over_scenes(
    interval: Callable[[ScenesOfRuns, ScenesOfRuns], ConfidenceInterval],
    group: Sequence[MethodComparison],
    figure: Figure,
) -> ConfidenceInterval:
    """An interval of both arms' figures over the scenes of some comparisons."""
    upper, lower = zip(*(one.pair(figure) for one in group), strict=True)
    return interval(upper, lower)


def compare_methods(known: Sequence[Arm]) -> dict[tuple[int, str], list[MethodComparison]]:
    """The default against each other method of its scene, by budget and counting of both."""
    groups: dict[tuple[int, str], list[MethodComparison]] = {}
    for ours in (arm for arm in known if arm.is_default):
        for theirs in known:
            work = ours.key.budget, ours.key.overlaps
            alike = (ours.key.scene, *work) == (theirs.key.scene, theirs.key.budget, theirs.key.overlaps)
            if alike and not theirs.is_default:
                groups.setdefault(work, []).append(MethodComparison(ours, theirs))
    return groups


def comparison_part(known: Sequence[Arm], heading: str = "## The default method against the others") -> str:
    """The section on comparisons; empty without an arm."""
    if not known:
        return ""
    return (
        f"{heading}\n\n"
        "After equally many counted evaluations. *Default* and *other* are medians over runs, with their "
        "ranges; a difference is the mean of the default's runs less that of the other's, which are not "
        f"paired. Its interval is a studentised bootstrap, {RESAMPLES:,} resamples; over {LEAST_SCENES} "
        "objects or more these are drawn too, over fewer it is for these objects. *Win* and *loss*: the "
        "p-value, adjusted for all comparisons that are in its table by the method of Holm, is at most "
        f"{SIGNIFICANT:g}; *undecided*: it is greater, which does not make the two equal. Intervals are not "
        "adjusted, and of five runs, among which one is far from the others, the p-value can be large where "
        "the interval is far from 0. ≤ stands before "
        f"the least p-value that the resamples can give. With fewer than {LEAST_RUNS} seeds there is no "
        "verdict. The figures after it are "
        "medians, the default's first. *Orientations* is a mean over all cells with a success: the default "
        "takes a cell for done with the first grasp there (`grasps_per_cell`), and is behind in it by "
        "design. *Code*: which evaluation code the runs are of, the default's first.\n\n"
        + "\n".join(_groups(known))
    )


def _groups(known: Sequence[Arm]) -> Iterator[str]:
    for (budget, counting), group in sorted(compare_methods(known).items()):
        done = [one for one in group if one.has_runs]
        yield f"### {budget:,} evaluations, {COUNTING[counting]}\n"
        if done:
            verdicts = [*verdicts_of([one.found for one in done])]
            columns = [*COMPARED, *(figure.words for figure in done[0].beside)]
            if done[0].is_physical:
                columns += ["equal CPU", SCREENED.words]
            yield markdown_table(
                [*columns, "code"], [_line(*pair) for pair in zip(done, verdicts, strict=True)]
            )
            yield "\n".join(_losses(done, verdicts)) + "\n"
        if over_objects := list(_pooled(done)):
            yield markdown_table(POOLED, over_objects)
        if len(done) < len(group):
            yield f"{len(group) - len(done)} of {len(group)} comparisons are not in yet.\n"


@dataclass(frozen=True)
class Verdict:
    """A difference or ratio among others."""

    found: ConfidenceInterval
    adjusted: float
    """Its p-value, adjusted for the family by the method of Holm; NaN without one."""

    @property
    def words(self) -> str:
        """The verdict on the default: win, loss, undecided or few seeds."""
        if np.isnan(self.adjusted):
            return "few seeds"
        if self.adjusted > SIGNIFICANT:
            return "undecided"
        return "win" if self.found.value > self.found.null else "loss"

    @property
    def p_words(self) -> str:
        """The adjusted p-value, empty without one; with a sign where the resamples can give no lower one."""
        if np.isnan(self.adjusted):
            return ""
        is_least = self.found.p_value <= LEAST_P_VALUE and self.adjusted < 1
        return f"{'≤ ' if is_least else ''}{self.adjusted:.2g}"

    def cells(self, digits: int) -> tuple[str, str, str, str]:
        """The columns of `VERDICT`."""
        found = self.found
        interval = f"{found.low:+.{digits}f} to {found.high:+.{digits}f}" if found.is_known else ""
        return f"{found.value:+.{digits}f}", interval, self.p_words, self.words


def holm(p_values: ArrayLike) -> NDArray[np.float64]:
    """Adjusted p-values (n,) of a family of comparisons (Holm 1979); NaN ones are no part of it.

    A comparison is significant at a level where its adjusted p-value is at most that level.
    """
    given = np.asarray(p_values, np.float64)
    adjusted = np.full(given.shape, np.nan)
    known = np.flatnonzero(~np.isnan(given))
    order = known[np.argsort(given[known], kind="stable")]
    steps = given[order] * np.arange(len(order), 0, -1)
    adjusted[order] = np.minimum(np.maximum.accumulate(steps), 1.0) if len(order) else steps
    return adjusted


def verdicts_of(family: Sequence[ConfidenceInterval]) -> Iterator[Verdict]:
    """The verdicts on a family of differences or ratios."""
    for found, adjusted in zip(family, holm([one.p_value for one in family]), strict=True):
        yield Verdict(found, float(adjusted))


def _line(one: MethodComparison, verdict: Verdict) -> tuple[str, ...]:
    figure = one.figure
    spreads = (arm.words(figure.name, figure.scale, figure.digits) for arm in (one.ours, one.theirs))
    return (
        one.ours.key.gripper, one.ours.key.object, one.theirs.method, one.seeds, figure.words, *spreads,
        *verdict.cells(figure.digits), *(_beside(one, other) for other in one.beside),
        *((_equal_cpu(one), _beside(one, SCREENED)) if one.is_physical else ()), one.codes,
    )  # fmt: skip


def _equal_cpu(one: MethodComparison) -> str:
    """The ratio of cells that hold after as many CPU seconds, and these."""
    if (found := one.equal_cpu()) is None:
        return ""
    seconds, (ours, theirs) = found
    return f"{ratio_interval([ours], [theirs]).value:.2f} at {seconds} s"


def _pooled(done: Sequence[MethodComparison]) -> Iterator[tuple[str, ...]]:
    """Verdicts for each hand and method over its objects with the same figure."""
    groups: dict[tuple[str, str, Figure], list[MethodComparison]] = {}
    for one in done:
        groups.setdefault((one.ours.key.gripper, one.theirs.method, one.figure), []).append(one)
    several = {key: group for key, group in groups.items() if len(group) > 1}
    found = [over_scenes(difference_interval, group, figure) for (*_, figure), group in several.items()]
    for ((hand, rival, figure), group), verdict in zip(several.items(), verdicts_of(found), strict=True):
        yield hand, rival, str(len(group)), figure.words, *verdict.cells(figure.digits)


def _losses(done: Sequence[MethodComparison], verdicts: Sequence[Verdict]) -> Iterator[str]:
    """How often the default won, and every figure in which it is behind: a table where there are any."""
    words = [verdict.words for verdict in verdicts]
    said = ", ".join(f"{plural} {words.count(one)}" for one, plural in VERDICTS.items() if one in words)
    lost = {label(figure): list(_behind(done, figure)) for figure in (None, *done[0].beside)}
    unlost = "; ".join(name for name, lines in lost.items() if not lines)
    yield f"In the figure that decides: {said}. Behind nowhere in: {unlost or 'no figure'}."
    if mixed := sum(one.is_mixed for one in done):
        yield f"Of two evaluation codes: {mixed} of {len(done)}, whose difference may be the codes'."
    if lines := [line for some in lost.values() for line in some]:
        yield "\n" + markdown_table(BEHIND, lines).rstrip("\n")


VERDICTS = {"win": "wins", "loss": "losses", "undecided": "undecided", "few seeds": "of few seeds"}


def _behind(done: Sequence[MethodComparison], figure: Figure | None) -> Iterator[tuple[str, ...]]:
    """Hands and objects where the default is behind in a figure: of which method, and how far."""
    compared = [(one, figure or one.figure) for one in done]
    some = [(one, measure) for one, measure in compared if all(len(values) for values in one.pair(measure))]
    verdicts = verdicts_of([one.difference(measure) for one, measure in some])
    groups: dict[tuple[str, str], list[tuple[float, str, bool]]] = {}
    for (one, measure), verdict in zip(some, verdicts, strict=True):
        if (by := -verdict.found.value) > 0:
            group = groups.setdefault((one.ours.key.gripper, one.ours.key.object), [])
            group.append((by, f"{one.theirs.method} {by:.{measure.digits}f}", verdict.words == "loss"))
    for (hand, thing), group in groups.items():
        ordered = sorted(group, reverse=True)
        sure, unsure = (
            ", ".join(words for _, words, is_loss in ordered if is_loss is certain)
            for certain in (True, False)
        )
        yield label(figure), hand, thing, sure, unsure


def label(figure: Figure | None) -> str:
    """A figure's name without its unit; None: the one that decides."""
    return "the figure that decides" if figure is None else figure.words.removesuffix(", %")


def _beside(one: MethodComparison, figure: Figure) -> str:
    return " / ".join(
        f"{np.median(values):.{figure.digits}f}" if len(values) else "-" for values in one.pair(figure)
    )
