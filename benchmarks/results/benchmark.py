"""The first part of the page: grasps that hold on the scenes of the benchmark, for as much work.

Work is counted evaluations, or CPU seconds of the workers in the same engine and protocol. Under equal CPU,
each scene is compared at the latest of `CPU_MILESTONES` that all runs of both methods reached.
"""

from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import chain

import numpy as np
from benchmarks.results.assets import HANDS, OBJECTS
from benchmarks.results.comparison import (
    BOTH_CELLS,
    DEFAULT,
    ROBUST_CELLS,
    ROBUST_NICHES,
    SCREENED,
    Arm,
    MethodComparison,
    compare_methods,
    over_scenes,
    verdicts_of,
)
from benchmarks.results.drawn_grasps import DRAWN, TRIALS
from benchmarks.results.programme import TUNING, TUNING_HAND
from benchmarks.results.table import CPU_MILESTONES, MILESTONES, Row
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.ticker import FuncFormatter, NullFormatter
from numpy.typing import NDArray

from qdgrasp_protocol.text import counted
from qdgrasp_tools.report.bootstrap import (
    CONFIDENCE_LEVEL,
    LEAST_SCENES,
    ConfidenceInterval,
    ScenesOfRuns,
    ratio_interval,
)
from qdgrasp_tools.report.figure_grid import (
    FigureGrid,
    MethodVariant,
    line_styles,
    panel_heading,
    plain_axes,
)
from qdgrasp_tools.report.tables import markdown_table

FIGURE = "cells-that-hold"
PROTOCOL = "physical in mujoco"
TWO_FINGERS = ("panda", "robotiq_2f", "xarm", "pr2")
SUMMARY_COLUMNS = (
    "scenes", "method", "hands", "objects", "runs", "cells that hold", "niches that hold", "QD score",
    SCREENED.words, "cells that hold for 1,000 poses", "CPU s", "cells that hold a CPU s",
    "default over it, equal evaluations", "adjusted p",
    "default over it, equal CPU", "its adjusted p", "default over it, niches",
)  # fmt: skip
LOSS_COLUMNS = (
    "hand",
    "object",
    "against",
    "after",
    "default over it",
    f"{CONFIDENCE_LEVEL:.0%} interval",
    "verdict",
)


@dataclass(frozen=True)
class SceneGroup:
    """Scenes of the benchmark that are summed up together."""

    words: str
    has: Callable[[Arm], bool]

    def arms(self, known: Sequence[Arm]) -> list[Arm]:
        """Its arms whose runs are all in."""
        return [arm for arm in known if arm.is_complete and arm.key.protocol == PROTOCOL and self.has(arm)]


def is_tuning(arm: Arm) -> bool:
    """Whether constants of searches were chosen on its scene."""
    return arm.key.gripper == TUNING_HAND and arm.key.object in TUNING


GROUPS = (
    SceneGroup("held out, two fingers", lambda arm: not is_tuning(arm) and arm.key.gripper in TWO_FINGERS),
    SceneGroup(
        "held out, more fingers", lambda arm: not is_tuning(arm) and arm.key.gripper not in TWO_FINGERS
    ),
    SceneGroup("tuning", is_tuning),
)
NEW = SceneGroup("new hands and objects", lambda arm: arm.key.object in OBJECTS or arm.key.gripper in HANDS)
"""Those held-out scenes on which nothing had been run before the benchmark."""


@dataclass(frozen=True)
class GroupComparison:
    """The default against one other method over scenes that both have runs on."""

    group: SceneGroup
    scenes: tuple[MethodComparison, ...]

    @property
    def other_method(self) -> str:
        """The other method."""
        return self.scenes[0].theirs.method

    @cached_property
    def equal_evaluations(self) -> ConfidenceInterval:
        """Ratio of cells that hold, the default's over the other's, after as many evaluations."""
        return over_scenes(ratio_interval, self.scenes, ROBUST_CELLS)

    @cached_property
    def equal_cpu(self) -> ConfidenceInterval:
        """That ratio after as many CPU seconds; scenes where a run took too few are left out."""
        pairs = [found[1] for one in self.scenes if (found := one.equal_cpu()) is not None]
        upper: ScenesOfRuns = [ours for ours, _ in pairs]
        return ratio_interval(upper, [theirs for _, theirs in pairs])

    @cached_property
    def niches(self) -> ConfidenceInterval:
        """That ratio of niches that hold, after as many evaluations."""
        return over_scenes(ratio_interval, self.scenes, ROBUST_NICHES)

    @property
    def with_drawn_grasps(self) -> "GroupComparison":
        """It over the scenes where grasps of all runs of both were drawn and evaluated again."""
        return GroupComparison(
            self.group,
            tuple(
                one
                for one in self.scenes
                if all(row.drawn is not None for arm in (one.ours, one.theirs) for row in arm.rows.values())
            ),
        )

    @cached_property
    def both_engines(self) -> ConfidenceInterval:
        """Ratio of cells that hold in both engines."""
        return over_scenes(ratio_interval, self.scenes, BOTH_CELLS)


def compare_group(group: SceneGroup, known: Sequence[Arm]) -> list[GroupComparison]:
    """The default against every other method on the scenes of a group, by method."""
    others: dict[str, list[MethodComparison]] = {}
    for one in chain(*compare_methods(group.arms(known)).values()):
        others.setdefault(one.theirs.method, []).append(one)
    return [GroupComparison(group, tuple(found)) for found in others.values()]


BEST_OTHER = "best other of each scene"


def against_best(group: SceneGroup, known: Sequence[Arm]) -> list[ConfidenceInterval]:
    """Ratios to the method that is best on each scene: after equal evaluations, equal CPU, and of niches.

    That method is chosen by the same runs, for each ratio: it is better by chance, too.
    """
    scenes: dict[tuple[str, str, str], list[MethodComparison]] = {}
    for one in chain(*compare_methods(group.arms(known)).values()):
        scenes.setdefault(one.ours.key.scene, []).append(one)
    after = (
        [[one.pair(ROBUST_CELLS) for one in others] for others in scenes.values()],
        [[timed[1] for one in others if (timed := one.equal_cpu())] for others in scenes.values()],
        [[one.pair(ROBUST_NICHES) for one in others] for others in scenes.values()],
    )

    def share(pair: tuple[NDArray[np.float64], NDArray[np.float64]]) -> float:
        """The default's share of both; where both found nothing 1, so that any other method is chosen."""
        ours, theirs = (float(values.mean()) for values in pair)
        return ours / (ours + theirs) if ours + theirs else 1.0

    chosen = ([min(pairs, key=share) for pairs in some if pairs] for some in after)
    return [ratio_interval([ours for ours, _ in pairs], [theirs for _, theirs in pairs]) for pairs in chosen]


def benchmark_part(known: Sequence[Arm]) -> str:
    """The part of the page, from the arms of the benchmark's campaigns."""
    found = [comparison for group in (*GROUPS, NEW) for comparison in compare_group(group, known)]
    if not found:
        return "## Grasps that hold\n\nNo runs of the benchmark are in yet.\n"
    of_all = [one for one in found if one.group is not NEW]
    parts = (_losses(of_all, known), _summary(known, found), _drawn_part(known, found))
    return "\n".join(["## Grasps that hold\n", *chain(*parts)])


def _losses(found: Sequence[GroupComparison], known: Sequence[Arm]) -> Iterator[str]:
    """Scenes on which the default is behind, before anything else is said; and how many scenes are in."""
    scenes = [one for comparison in found for one in comparison.scenes]
    after = {
        "equal evaluations": [(one, one.pair(ROBUST_CELLS)) for one in scenes],
        "equal CPU": [(one, timed[1]) for one in scenes if (timed := one.equal_cpu()) is not None],
    }
    behind = {words: list(_behind(pairs, words)) for words, pairs in after.items()}
    said = " and ".join(
        f"in {len(behind[words]) or 'none'} of {counted(len(pairs), 'comparison')} after {words}"
        for words, pairs in after.items()
    )
    untimed = len(scenes) - len(after["equal CPU"])
    rest = (
        f" ({untimed} more {'has' if untimed == 1 else 'have'} a run too short for that)" if untimed else ""
    )
    yield f"The default method is behind {said}{rest}{':' if any(behind.values()) else '.'}\n"
    if any(behind.values()):
        yield markdown_table(LOSS_COLUMNS, [line for lines in behind.values() for line in lines])
    asked = {arm.key.scene: is_tuning(arm) for arm in known if arm.key.protocol == PROTOCOL}
    here = {one.ours.key.scene for one in scenes}
    held_out, tuning = (
        f"{sum(asked[scene] is kind for scene in here)} of {list(asked.values()).count(kind)}"
        for kind in (False, True)
    )
    by_hand = Counter(hand for hand, *_ in (scene for scene in here if not asked[scene]))
    most_first = sorted(by_hand.items(), key=lambda pair: (-pair[1], pair[0]))
    hands = ", ".join(f"{number} of `{hand}`" for hand, number in most_first)
    yield (
        f"{held_out} held-out scenes are in{f' ({hands})' if hands else ''}, the cheapest first, so that "
        f"they are no random sample of all; of tuning scenes {tuning}. Constants of the default were "
        "chosen on the tuning scenes, so that comparisons there favour it. A scene is in when all seeds "
        "of the default and another method are; methods and scenes with fewer have lines in the tables "
        "below.\n"
    )


def _behind(
    pairs: Sequence[tuple[MethodComparison, tuple[NDArray[np.float64], NDArray[np.float64]]]], after: str
) -> Iterator[tuple[str, ...]]:
    """A line for each comparison in which the default has fewer cells that hold."""
    ratios = [ratio_interval([ours], [theirs]) for _, (ours, theirs) in pairs]
    for (one, _), verdict in zip(pairs, verdicts_of(ratios), strict=True):
        if verdict.found.value < 1:
            yield (
                one.ours.key.gripper, one.ours.key.object, one.theirs.method, after,
                f"{verdict.found.value:.2f}", interval_words(verdict.found), verdict.words,
            )  # fmt: skip


def _summary(known: Sequence[Arm], found: Sequence[GroupComparison]) -> Iterator[str]:
    yield f"![Cells with a grasp that holds over evaluations and over CPU seconds]({FIGURE}.png)\n"
    yield markdown_table(SUMMARY_COLUMNS, [*_summary_lines(known, found)])
    yield (
        f"Protocol `{PROTOCOL}`. *Cells that hold*: distinct 1 cm cells with a grasp that survived every "
        "push, the figure that the default method searches for; no run can have more than its counted "
        "evaluations. *Niches that hold*: cells, orientations and synergies with one. *QD score*: the "
        "best fitness, 0 to 6, in each cell with a success, summed. *Poses screened*: poses that were "
        "computed for one counted evaluation, with those that overlap and those that the default's models "
        "refuse; the default screens many more than the others, so that by poses it is behind all of "
        "them, and CPU seconds charge for that. All these, and CPU seconds of the workers, are means over "
        "scenes of medians over runs, after equally many evaluations. *Default over it*: the default's "
        "share a / (a + b) of the cells that hold of both is averaged over scenes, and given as the ratio "
        "a / b, so that each scene weighs the same, also one where a method has none; with its "
        f"{CONFIDENCE_LEVEL:.0%} interval, from {LEAST_SCENES} scenes on over scenes and runs, before over "
        "the runs on these scenes; *equal CPU*: on each scene after the most CPU seconds of "
        f"{', '.join(map(str, CPU_MILESTONES.values()))} that all runs of both took; "
        "*niches*: that ratio of niches that hold, after equally many evaluations, where grasps of other "
        "orientation in a cell count too. *Best other*: the method against which the default has the least "
        "ratio on a scene, for each of the three ratios apart; it is chosen by the same runs, and so better "
        "by chance too. *Adjusted p*: by the method of Holm for all lines of this table, for each kind of "
        "work apart; intervals are not adjusted. Over 10 to 20 scenes p-values are too small, by up to ten "
        "times ([how far](../analysis.md#claims-and-their-intervals)), and ≤ stands before the least that "
        "the resamples can give: rather read the intervals. *New hands and objects* are those held-out "
        "scenes on which nothing was run before the benchmark.\n"
    )


def _summary_lines(known: Sequence[Arm], found: Sequence[GroupComparison]) -> Iterator[tuple[str, ...]]:
    judged = list(
        zip(
            found,
            verdicts_of([one.equal_evaluations for one in found]),
            verdicts_of([one.equal_cpu for one in found]),
            strict=True,
        )
    )
    for group in (*GROUPS, NEW):
        here = [one for one in judged if one[0].group is group]
        ours = [arm for arm in group.arms(known) if arm.is_default]
        if here:
            yield (group.words, f"**`{DEFAULT}`**", *_sums(ours), *[""] * 5)
            evaluations, cpu, niches = map(ratio_words, against_best(group, known))
            yield (group.words, BEST_OTHER, *_sums(ours)[:2], *[""] * 8, evaluations, "", cpu, "", niches)
        for comparison, *verdicts in here:
            ratios = (words for one in verdicts for words in (ratio_words(one.found), one.p_words))
            yield (
                group.words,
                comparison.other_method,
                *_sums([one.theirs for one in comparison.scenes]),
                *ratios,
                ratio_words(comparison.niches),
            )


def _sums(arms: Sequence[Arm]) -> tuple[str, ...]:
    """Numbers of hands, objects and runs, and the figures of one method over its scenes."""
    hold, niches, score, screened, seconds = (
        np.mean([np.median(arm.values(name)) for arm in arms])
        for name in ("robust_cells", "robust_niches", "qd_score", SCREENED.name, "cpu_seconds")
    )
    rate, of_poses = (
        np.mean([np.median([measure(row) for row in arm.rows.values()]) for arm in arms])
        for measure in (_rate, _of_poses)
    )
    return (
        str(len({arm.key.gripper for arm in arms})), str(len({arm.key.object for arm in arms})),
        str(sum(len(arm.rows) for arm in arms)), f"{hold:.0f}", f"{niches:.0f}", f"{score:.0f}",
        f"{screened:.1f}", f"{of_poses:.0f}", f"{seconds:.0f}", f"{rate:.1f}",
    )  # fmt: skip


DRAWN_COLUMNS = (
    "scenes", "method", "hands", "objects", "grasps drawn", "hold in Bullet too, %", "eta",
    BOTH_CELLS.words, "default over it", "adjusted p",
)  # fmt: skip


def _drawn_part(known: Sequence[Arm], found: Sequence[GroupComparison]) -> Iterator[str]:
    """Drawn grasps that were evaluated again; nothing without one."""
    some = [one for comparison in found if (one := comparison.with_drawn_grasps).scenes]
    if not some:
        return
    yield "### In the other engine, and with small errors\n"
    yield (
        f"Up to {DRAWN} cells that hold were drawn of each run, and the first grasp in each was evaluated "
        "again: in Bullet, the engine that the search did not learn from, and in MuJoCo in "
        f"{TRIALS} trials of `robust`, with a displaced object and other friction (*eta*: the share of "
        "pushes survived). Means over scenes of means over runs. *Cells that hold in both*: the cells that "
        "hold of a run times the share of those drawn; *default over it*: the ratio of that, as above.\n"
    )
    judged = list(zip(some, verdicts_of([one.both_engines for one in some]), strict=True))
    lines = []
    for group in (*GROUPS, NEW):
        here = [pair for pair in judged if pair[0].group is group]
        ours = [arm for arm in group.arms(known) if arm.is_default and len(arm.values("drawn_in_bullet"))]
        if here:
            lines.append((group.words, f"**`{DEFAULT}`**", *_drawn_sums(ours), "", ""))
        for comparison, verdict in here:
            sums = _drawn_sums([one.theirs for one in comparison.scenes])
            lines.append(
                (group.words, comparison.other_method, *sums, ratio_words(verdict.found), verdict.p_words)
            )
    yield markdown_table(DRAWN_COLUMNS, lines)


def _drawn_sums(arms: Sequence[Arm]) -> tuple[str, ...]:
    share, eta, cells = (
        np.mean([arm.values(name).mean() for arm in arms])
        for name in ("drawn_in_bullet", "drawn_eta", BOTH_CELLS.name)
    )
    return (
        str(len({arm.key.gripper for arm in arms})), str(len({arm.key.object for arm in arms})),
        f"{sum(arm.values('drawn').sum() for arm in arms):.0f}", f"{100 * share:.0f}", f"{eta:.2f}",
        f"{cells:.0f}",
    )  # fmt: skip


def _rate(row: Row) -> float:
    return (row.robust_cells or 0) / row.cpu_seconds if row.cpu_seconds else 0.0


def _of_poses(row: Row) -> float:
    """Cells that hold for each 1000 poses that were screened."""
    return 1000 * (row.robust_cells or 0) / row.proposals


def ratio_words(found: ConfidenceInterval) -> str:
    """A ratio with its interval in brackets; nothing where there is none."""
    if np.isnan(found.value):
        return ""
    return f"{found.value:.2f}" + (f" ({interval_words(found)})" if found.is_known else "")


def interval_words(found: ConfidenceInterval) -> str:
    """The ends of an interval of a ratio."""
    return f"{found.low:.2f} to {found.high:.2f}" if found.is_known else "few seeds"


PANEL = (3.6, 2.4)
LEGEND_COLUMNS = 2
MIDDLE_HALF = (0.25, 0.75)
"""Quantiles over scenes between which a curve is shaded."""
AXES: Mapping[str, Mapping[str, int]] = {"evaluations": MILESTONES, "CPU seconds": CPU_MILESTONES}


def draw(known: Sequence[Arm]) -> FigureGrid | None:
    """A row of panels for each group: over evaluations, and over CPU seconds; None without a run."""
    groups = [group for group in GROUPS if compare_group(group, known)]
    if not groups:
        return None
    methods: dict[str, MethodVariant] = {
        arm.method: (arm.key.method, arm.method) for group in groups for arm in group.arms(known)
    }
    styles = line_styles(methods.values())
    legend_rows = -(-len(methods) // LEGEND_COLUMNS)
    grid = FigureGrid(len(groups), len(AXES), PANEL, legend_rows=legend_rows, least_width=9.0)
    for row, group in enumerate(groups):
        for column, (words, milestones) in enumerate(AXES.items()):
            axes = grid.axes(row, column)
            _style_axes(axes, list(milestones.values()))
            panel_heading(axes, group.words, f"share of the default's cells that hold, over {words}")
            for method, at, shares in _curves(group, known, milestones, words == "evaluations"):
                style = styles[methods[method]]
                means = [share.mean() for share in shares]
                axes.plot(at, means, color=style.colour, linestyle=style.dashes, marker="o", markersize=2.5)
                low, high = zip(*(np.quantile(share, MIDDLE_HALF) for share in shares), strict=True)
                axes.fill_between(at, low, high, color=style.colour, alpha=0.12, linewidth=0)
            axes.set_ylim(bottom=0)
    grid.title(
        "Cells with a grasp that holds",
        "Mean over scenes of medians over runs; shaded: the middle half of the scenes; 1: the default's end.",
    )
    lines = [
        Line2D([], [], color=styles[arm].colour, linestyle=styles[arm].dashes, label=name.replace("`", ""))
        for name, arm in methods.items()
    ]
    grid.legend(lines, LEGEND_COLUMNS)
    return grid


def _style_axes(axes: Axes, ticks: Sequence[int]) -> None:
    plain_axes(axes)
    axes.set_xscale("log")
    axes.set_xticks(ticks)
    axes.xaxis.set_major_formatter(FuncFormatter(lambda x, _: f"{x:,.0f}"))
    axes.xaxis.set_minor_formatter(NullFormatter())


def _curves(
    group: SceneGroup, known: Sequence[Arm], milestones: Mapping[str, int], has_end: bool
) -> Iterator[tuple[str, list[int], list[NDArray[np.float64]]]]:
    """For each method the milestones that all its runs reached, and the shares of the scenes there.

    With `has_end` the budget is one, where it is the same on all scenes.
    """
    here = group.arms(known)
    ends = {arm.key.scene: float(np.median(arm.values("robust_cells"))) for arm in here if arm.is_default}
    by_method: dict[str, list[Arm]] = {}
    for arm in here:
        if ends.get(arm.key.scene):
            by_method.setdefault(arm.method, []).append(arm)
    for method, arms in by_method.items():
        shares = {milestone: _shares(arms, ends, name) for name, milestone in milestones.items()}
        budgets = {arm.key.budget for arm in arms}
        if has_end and len(budgets) == 1:
            shares[budgets.pop()] = _shares(arms, ends, "")
        reached = {milestone: share for milestone, share in shares.items() if share is not None}
        if reached:
            yield method, list(reached), list(reached.values())


def _shares(
    arms: Sequence[Arm], ends: Mapping[tuple[str, str, str], float], name: str
) -> NDArray[np.float64] | None:
    """For each scene the median at a milestone, or in the end, over the default's end (scenes,).

    None where not all runs got there.
    """
    values = [arm.values(f"robust_cells_{name}".rstrip("_")) for arm in arms]
    if any(len(found) < len(arm.rows) for arm, found in zip(arms, values, strict=True)):
        return None
    return np.array([np.median(found) / ends[arm.key.scene] for arm, found in zip(arms, values, strict=True)])
