"""Draws the paper's figures: curves of methods, distributions of nu, success cells."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import to_rgb
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from qdgrasp_assets.scene import Scene
from qdgrasp_coordinator.metrics.cells import cells
from qdgrasp_coordinator.metrics.success_metrics import FITNESS_COLOURS, FITNESS_WORDS, NU_BINS
from qdgrasp_coordinator.metrics.successes import ROBUST, TrialPlan, survival
from qdgrasp_coordinator.storage.run_folder import RunFolder
from qdgrasp_protocol.rows import Rows
from qdgrasp_protocol.text import counted
from qdgrasp_tools.rendering.drawings import OUTLINE, axes_triad, show_view
from qdgrasp_tools.rendering.views import best_azimuth, best_in_cells, hues_of_survival, view_of_cells
from qdgrasp_tools.report.figure_grid import (
    FAINT,
    FAMILIES,
    INK,
    PRIOR_ORDER,
    Dashes,
    FigureGrid,
    LineStyle,
    MethodVariant,
    default_prior,
    evaluation_axis,
    family_of,
    hue_of,
    line_styles,
    panel_heading,
    plain_axes,
    value_axis,
)
from qdgrasp_tools.report.run_groups import (
    CurvePanel,
    QuartileCurve,
    RunGroup,
    SceneName,
    grouped_by,
    mean_interval,
    sample_end,
)
from qdgrasp_tools.report.run_history import RunHistory

BAND_OPACITY = 0.13  # Opacity of an interquartile range
CURVE_COLUMNS = 2  # Panels side by side: the paper's arrangement
PANEL_SIZE, LONE_PANEL_SIZE = (4.2, 2.7), (5.6, 3.3)  # [inches]
LABEL_WIDTH, LETTER_WIDTH = 1.85, 0.066
"""Least width of a column of the legend, and what each letter takes beside the line's 0.75 [inches]."""
CURVE_CAPTION = (
    "Median over seeds; shaded: quartiles. Circle: an unfinished run ends. Dashed: sampling alone."
)
COMPARED_METHODS = ("contact_rand", "approach_rand", "antipodal_rand", "me_scs", "contact_me_scs", "aimed")
"""The methods of the paper's first figure of results, and the default of this project."""


def draw_curves(shown: Sequence[CurvePanel], title: str) -> FigureGrid:
    """Draw a panel for each hand, with a curve for each method (the paper's first two figures)."""
    drawn = line_styles(one.arm for panel in shown for one in panel.curves)
    handles, across = _method_legend(drawn)
    letters = np.array([len(str(handle.get_label())) for handle in handles]).reshape(across, -1).max(axis=1)
    grid = FigureGrid(
        -(-len(shown) // CURVE_COLUMNS),
        min(len(shown), CURVE_COLUMNS),
        PANEL_SIZE if len(shown) > 1 else LONE_PANEL_SIZE,
        legend_rows=len(handles) // across,
        least_width=max(6.4, 0.4 + float(np.maximum(LABEL_WIDTH, 0.75 + LETTER_WIDTH * letters).sum())),
    )
    for number, panel in enumerate(shown):
        axes = grid.axes(*divmod(number, CURVE_COLUMNS))
        plain_axes(axes)
        evaluation_axis(axes, panel.end)
        top = max(float(np.nanmax(one.high, initial=0.0)) for one in panel.curves)
        value_axis(axes, top, share=panel.is_share)
        seeds = _number_span([len(one.samples) for one in panel.curves])
        ends = _number_span([sample_end(sample) for one in panel.curves for sample in one.samples])
        panel_heading(axes, panel.scene.words, panel.measure, f"{seeds} seeds \u00d7 {ends} evaluations")
        for one in panel.curves:
            _draw_curve(axes, panel, one, drawn[one.arm])
    grid.title(title, CURVE_CAPTION)
    grid.legend(handles, across)
    return grid


def _draw_curve(axes: Axes, panel: CurvePanel, one: QuartileCurve, style: LineStyle) -> None:
    colour, dashes = style
    axes.plot(one.evaluations, one.median, color=colour, linestyle=dashes, linewidth=1.9)
    axes.fill_between(one.evaluations, one.low, one.high, color=colour, alpha=BAND_OPACITY, linewidth=0)
    for sample in one.samples:
        if not all(run.complete for run in sample):
            end = sample_end(sample)
            axes.plot([end], [panel.values(sample, end)], marker="o", markersize=4.5, color=colour,
                      markerfacecolor="white", clip_on=False, zorder=5)  # fmt: skip


def _number_span(numbers: Sequence[int]) -> str:
    low, high = min(numbers, default=0), max(numbers, default=0)
    return f"{low:,}" if low == high else f"{low:,}\u2013{high:,}"


def _method_legend(drawn: Mapping[MethodVariant, LineStyle]) -> tuple[list[Line2D], int]:
    """Arrange methods as a matrix: a column for each prior, in it the families in their order."""
    columns = [
        [arm for f in FAMILIES for arm in drawn if (default_prior(arm[0]), family_of(arm[0])) == (prior, f)]
        for prior in PRIOR_ORDER
    ]
    filled = [column for column in columns if column]
    rows = max(map(len, filled))
    handles = [
        _legend_line(" ".join(column[row]).rstrip(), *drawn[column[row]])
        if row < len(column)
        else _legend_line("", "none", "-")
        for column in filled
        for row in range(rows)
    ]
    return handles, len(filled)


def _legend_line(label: str, colour: str, dashes: Dashes) -> Line2D:
    return Line2D([], [], color=colour, linestyle=dashes, linewidth=1.9, label=label)


NU_TICKS = (("0", 0.0), ("\u03c0/4", 0.25), ("\u03c0/2", 0.5), ("3\u03c0/4", 0.75), ("\u03c0", 1.0))
NU_PANEL_SIZE = (2.9, 1.4)
NU_PRIOR = "contact"
"""The prior that leaves nu free; `approach` bounds it, and antipodal hands lie along their points' line."""


@dataclass(frozen=True)
class NuDistribution:
    """The distribution of nu of a method's successes with one hand, over its objects."""

    hand: str
    method: str
    variant: str
    share: NDArray[np.float64]
    """(24,): mean over runs of the share of successes in each bin."""
    near: tuple[float, ...]
    """Of each run with a success that has a nu, the share below pi / 4."""

    @property
    def words(self) -> str:
        """The mean share below pi / 4, with its interval."""
        interval = mean_interval(self.near)
        span = "" if interval is None else f" ({interval[0]:.0%} to {interval[1]:.0%})"
        return f"{np.mean(self.near):.0%} below \u03c0/4{span}, {counted(len(self.near), 'run')}"


def nu_distributions(groups: Sequence[RunGroup]) -> list[NuDistribution]:
    """Return the distributions of each hand's methods with the contact prior."""
    found = []
    for scene, here in grouped_by(groups, by_object=False).items():
        arms: dict[MethodVariant, list[RunHistory]] = {}
        for group in here:
            if default_prior(group.method) == NU_PRIOR:
                arms.setdefault(group.arm, []).extend(run for run in group.finished_runs if sum(run.nu.bins))
        for arm, runs in arms.items():
            if runs:
                share = np.mean([np.array(run.nu.bins) / sum(run.nu.bins) for run in runs], axis=0)
                near = tuple(run.nu.below_quarter_pi or 0.0 for run in runs)
                found.append(NuDistribution(scene.gripper, *arm, share, near))
    return found


def draw_nu(found: Sequence[NuDistribution]) -> FigureGrid:
    """Draw a row for each hand, a column for each method (the paper's third figure)."""
    hands = list(dict.fromkeys(one.hand for one in found))
    arms = list(dict.fromkeys((one.method, one.variant) for one in found))
    grid = FigureGrid(len(hands), len(arms), NU_PANEL_SIZE, space_above=0.84)
    for number, hand in enumerate(hands):
        grid.row_heading(number, hand)
        here = [one for one in found if one.hand == hand]
        top = max(float(one.share.max()) for one in here)
        for one in here:
            _draw_distribution(grid.axes(number, arms.index((one.method, one.variant))), one, top)
    words = "Share of successes in bins of 7.5\u00b0; each run counts alike. In brackets: 95 % interval."
    grid.title("Lean \u03bd of successes from the surface normal", words)
    return grid


def _draw_distribution(axes: Axes, lean: NuDistribution, top: float) -> None:
    plain_axes(axes)
    edges, hue = np.linspace(0, 1, NU_BINS + 1), hue_of(lean.method)
    for low, high, opacity in ((0, NU_BINS // 4, 0.9), (NU_BINS // 4, NU_BINS, 0.4)):
        axes.stairs(lean.share[low:high], edges[low : high + 1], fill=True, color=hue, alpha=opacity)
    axes.axvline(0.25, color=INK, linewidth=0.9, linestyle=(0, (4, 2)))
    axes.axhline(1 / NU_BINS, color=FAINT, linewidth=0.8, linestyle=(0, (1.5, 1.5)))
    axes.annotate(
        "uniform", (1, 1 / NU_BINS), (0, 3), textcoords="offset points", size=7, color=FAINT, ha="right",
        path_effects=[OUTLINE],
    )  # fmt: skip
    axes.set(xlim=(0, 1), ylim=(0, 1.08 * top))
    axes.set_xticks([place for _, place in NU_TICKS], [word for word, _ in NU_TICKS])
    axes.yaxis.set_major_formatter(lambda y, _: f"{100 * y:g}\u202f%")
    axes.yaxis.set_major_locator(MaxNLocator(3))
    panel_heading(axes, f"{lean.method} {lean.variant}".rstrip(), lean.words, color=hue)


MOST_VOXEL_ROWS = 8  # Scenes whose cells are drawn; of more, those of the object that most hands have
VOXEL_PANEL_INCHES, VOXEL_PIXELS = 2.6, 420
TRIAD_LENGTH = 0.085  # Of the object's axes, as a share of a view's height
LEGEND_ETAS = (0.0, 0.25, 0.5, 0.75, 1.0)  # Etas that are named in the legend of robust runs


@dataclass(frozen=True)
class RunVoxels:
    """The cells of one run with a success, and the most robust success in each."""

    name: SceneName
    run: RunHistory
    scene: Scene
    best: Rows
    """(n,): the fittest success of each cell, of equals the first; `fitness` sums its trials."""
    eta: NDArray[np.float64] | None
    """(n,): share of disturbances survived in all trials; None where the protocol has none."""

    @property
    def places(self) -> NDArray[np.int64]:
        """(n, 3) [cm]: the cells, CoM frame."""
        return cells(self.best["descriptor"][:, :3])

    @property
    def words(self) -> str:
        """Caption: the number of cells, and their robustness."""
        found = counted(len(self.best), "cell", told="{:,}".format)
        if self.eta is None:
            return f"{found}, {int((survival(self.best) == ROBUST).sum()):,} robust"
        return f"{found}, median \u03b7 {np.median(self.eta) if len(self.eta) else 0:.2f}"


def drawn_methods(groups: Sequence[RunGroup]) -> list[str]:
    """Choose those of the compared methods that found anything, else the one with most cells."""
    found: dict[str, int] = {}
    for group in groups:
        found[group.method] = found.get(group.method, 0) + sum(run.cells.end for run in group.runs)
    compared = [method for method in COMPARED_METHODS if found.get(method)]
    best = max(found, key=lambda method: found[method], default="")
    return compared or ([best] if found.get(best) else [])


def run_voxels(
    groups: Sequence[RunGroup], methods: Sequence[str], objects: Sequence[str] = ()
) -> list[list[RunVoxels]]:
    """For each scene, the cells of each method's run with the median number of them.

    Scenes are those of `objects`; without any all, or where there are more than eight, those of the object
    that most hands have. Runs without a scene in their folder, and scenes without a run, are left out.
    """
    chosen: dict[SceneName, dict[str, RunGroup]] = {}
    for group in groups:
        if group.method in methods and group.finished_runs:
            chosen.setdefault(group.scene, {}).setdefault(group.method, group)
    if not objects and len(chosen) > MOST_VOXEL_ROWS:
        names = [scene.object for scene in chosen]
        objects = [max(names, key=names.count)]
    rows = []
    for scene, found in chosen.items():
        if not objects or scene.object in objects:
            runs = [_median_run(found[method]) for method in methods if method in found]
            rows.append([_voxels_of_run(scene, run) for run in runs if RunFolder(run.path).has_bundle()])
    return [row for row in rows if row]


def _median_run(group: RunGroup) -> RunHistory:
    """Return the run with the median number of cells; of an even number, the one below."""
    ordered = sorted(group.finished_runs, key=lambda run: run.cells.end)
    return ordered[(len(ordered) - 1) // 2]


def _voxels_of_run(name: SceneName, run: RunHistory) -> RunVoxels:
    folder, plan = RunFolder(run.path), TrialPlan.of(run.spec)
    best = best_in_cells(folder.successes().scored)
    return RunVoxels(name, run, folder.scene(), best, plan.eta(best["fitness"]) if plan.trials else None)


def draw_voxels(rows: Sequence[Sequence[RunVoxels]], methods: Sequence[str]) -> FigureGrid:
    """Draw a row for each scene, a column for each method (the paper's fourth figure).

    All views of an object have one camera.
    """
    everything = [one for row in rows for one in row]
    drawn = [method for method in methods if any(one.run.spec.method == method for one in everything)]
    handles = _voxel_legend(everything)
    grid = FigureGrid(
        len(rows),
        len(drawn),
        (VOXEL_PANEL_INCHES, VOXEL_PANEL_INCHES),
        legend_rows=1,
        space_above=0.84,
        space_below=0.1,
        space_beside=0.3,
        left=0.3,
        least_width=0.4 + 1.75 * len(handles),
    )
    for number, row in enumerate(rows):
        beside = [one for one in everything if one.name.object == row[0].name.object]
        largest = max(beside, key=lambda one: len(one.best))
        azimuth = best_azimuth(largest.scene, largest.best)
        grid.row_heading(number, row[0].name.words)
        for one in row:
            axes = grid.axes(number, drawn.index(one.run.spec.method))
            _draw_cells(axes, one, azimuth, [other.places for other in beside])
    grid.title("Where methods had successes", "Cells of 1 cm that held the hand, by the most robust success.")
    grid.legend(handles, len(handles), length=1.0)
    return grid


def _draw_cells(axes: Axes, one: RunVoxels, azimuth: float, beside: Sequence[NDArray[np.int64]]) -> None:
    hues = hues_of_survival(survival(one.best)) if one.eta is None else _hues_of_eta(one.eta)
    view = view_of_cells(one.scene, one.best, azimuth, VOXEL_PIXELS, hues, beside)
    found = one.words + ("" if view.is_uncut else "; cut open")
    found += "" if view.block == 1 else f"; blocks of {view.block} cm"
    run = f"seed {one.run.spec.seed}, {one.run.evaluations:,} evaluations"
    show_view(axes, view, "bicubic")
    axes_triad(axes, view, length=TRIAD_LENGTH)
    method = one.run.spec.method
    panel_heading(axes, method, found, run, color=hue_of(method))


def _hues_of_eta(eta: NDArray[np.float64]) -> NDArray[np.float32]:
    return np.asarray(matplotlib.colormaps["viridis_r"](eta)[:, :3], dtype=np.float32)


def _voxel_legend(shown: Sequence[RunVoxels]) -> list[Line2D]:
    fitness = [(to_rgb(hue), words) for hue, words in zip(FITNESS_COLOURS, FITNESS_WORDS, strict=True)]
    etas = [(tuple(_hues_of_eta(np.array([eta]))[0]), f"\u03b7 = {eta:g}") for eta in LEGEND_ETAS]
    kinds = {one.eta is None for one in shown}
    return [
        Line2D([], [], linestyle="none", marker="s", markersize=8, color=hue, label=words)
        for hue, words in [*(fitness if True in kinds else []), *(etas if False in kinds else [])]
    ]
