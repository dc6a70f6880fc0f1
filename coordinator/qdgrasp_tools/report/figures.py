"""Draws the paper's figures: curves of methods, distributions of nu, success cells.

A prior has a hue, a family of searches a line style; sizes are in inches.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import to_hex, to_rgb
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import FuncFormatter, MaxNLocator, PercentFormatter
from numpy.typing import NDArray

from qdgrasp_assets.scene import Scene
from qdgrasp_coordinator.metrics.cells import cells
from qdgrasp_coordinator.metrics.success_metrics import FITNESS_COLOURS, FITNESS_WORDS, NU_BINS
from qdgrasp_coordinator.metrics.successes import ROBUST, survival
from qdgrasp_coordinator.search import registry
from qdgrasp_coordinator.storage.run_folder import RunFolder
from qdgrasp_protocol.rows import GIVEN, Rows
from qdgrasp_protocol.text import counted
from qdgrasp_tools.rendering.drawings import OUTLINE, axes_triad, figure_text, show_view
from qdgrasp_tools.rendering.views import best_in_cells, broad_azimuth, view_of_cells
from qdgrasp_tools.report.run_groups import (
    CurvePanel,
    MethodVariant,
    QuartileCurve,
    RunGroup,
    RunHistory,
    SceneName,
    grouped_by,
    sample_end,
)

Dashes = Literal["-"] | tuple[float, Sequence[float]]
INK, FAINT, RULE = "#22262b", "#69717a", "#d9dde1"
"""Colours of text, of notes beside it, and of rules."""
PRIOR_HUES = {
    "contact": "#0072b2",
    "approach": "#d55e00",
    "antipodal": "#009e73",
    GIVEN: "#cc79a7",
    "spherical": "#4d4d4d",
}
FAMILIES: dict[str, Dashes] = {
    "portfolio": "-",
    "antipodal_cells": (0, (2, 1)),
    "me_scs": "-",
    "me_dns": (0, (3, 1.2, 1.1, 1.2)),
    "cma_mae": (0, (1.1, 1.3)),
    "me_rand": (0, (5, 1.6, 1.1, 1.6)),
    "own": (0, (8, 1.6)),
    "rand": (0, (4.2, 2.2)),
}
"""Line styles: searches are drawn through, dotted or dash-dotted, plain sampling is dashed; `own`: those of
a program's own."""
PALEST_VARIANT = 0.65  # How much white is in the palest of a method's variants


def family_of(method: str) -> str:
    """Return the family of a method: its name without the prior's prefix; `own` for a program's."""
    family = method.removeprefix(registry.PRIORS[registry.method(method).prior][0])
    return family if family in FAMILIES else "own"


def line_styles(arms: Iterable[MethodVariant]) -> dict[MethodVariant, dict[str, Any]]:
    """Choose color and linestyle of each variant, of one method each paler than the last."""
    variants: dict[str, list[MethodVariant]] = {}
    for arm in dict.fromkeys(arms):
        variants.setdefault(arm[0], []).append(arm)
    return {
        arm: {
            "color": hue_of(method, place / max(1, len(same) - 1)),
            "linestyle": FAMILIES[family_of(method)],
        }
        for method, same in variants.items()
        for place, arm in enumerate(same)
    }


def hue_of(method: str, pale: float = 0.0) -> str:
    """Return the colour of a method, from its full hue at 0 to its palest variant at 1."""
    hue = to_rgb(PRIOR_HUES[registry.method(method).prior])
    red, green, blue = (part + (1 - part) * PALEST_VARIANT * pale for part in hue)
    return to_hex((red, green, blue))


FIGURE_DPI = 200
SVG_SALT = "qdgrasp"  # Of the names in an SVG, so that the same figure gives the same bytes


def panel_figure(
    rows: int, columns: int, panel: tuple[float, float], title: str, handles: Sequence[Line2D] = ()
) -> tuple[Figure, NDArray[Any]]:
    """Return a figure with a title and a legend, and its hidden panels (rows, columns)."""
    size = max(6.4, columns * panel[0]), 1.0 + rows * panel[1]
    figure = Figure(figsize=size, facecolor="white", layout="constrained")
    figure.suptitle(figure_text(title), x=0.01, ha="left", size=12, weight="bold", color=INK)
    if handles:
        figure.legend(
            handles=handles, loc="outside lower left", ncols=max(1, int(size[0] / 2)), frameon=False,
            fontsize=8.5, handlelength=3.2, labelcolor=INK,
        )  # fmt: skip
    panels = figure.subplots(rows, columns, squeeze=False)
    for axes in panels.flat:
        axes.set_visible(False)
    return figure, panels


def write_figure(figure: Figure, stem: Path) -> None:
    """Write a figure as PNG and SVG."""
    with matplotlib.rc_context({"svg.hashsalt": SVG_SALT, "svg.fonttype": "path"}):
        figure.savefig(stem.with_suffix(".png"), dpi=FIGURE_DPI)
        figure.savefig(stem.with_suffix(".svg"), dpi=FIGURE_DPI, metadata={"Date": None})


def _begin_panel(axes: Axes, *heading: str, colour: str = INK) -> None:
    """Show a panel with faint axes under its heading."""
    axes.set_visible(True)
    axes.set_title(figure_text("\n".join(heading)), loc="left", size=8, color=colour)
    axes.spines[["top", "right", "left"]].set_visible(False)
    axes.spines["bottom"].set_color(FAINT)
    axes.tick_params(colors=FAINT, labelsize=8, length=3, width=0.7)
    axes.grid(axis="y", color=RULE, linewidth=0.6)
    axes.set_axisbelow(True)


BAND_OPACITY = 0.13  # Opacity of an interquartile range
CURVE_COLUMNS = 2  # Panels side by side: the paper's arrangement
CURVE_PANEL = (4.6, 3.0)
CURVE_WORDS = "median over seeds and quartiles; a circle: an unfinished run ends"
COMPARED_METHODS = (
    "contact_rand",
    "approach_rand",
    "antipodal_rand",
    "me_scs",
    "contact_me_scs",
    "portfolio",
)
"""The methods of the paper's first figure of results, and the default of this project."""


def draw_curves(shown: Sequence[CurvePanel], title: str) -> Figure:
    """Draw a panel for each hand, with a curve for each method (the paper's first two figures)."""
    drawn = line_styles(one.arm for panel in shown for one in panel.curves)
    handles = [
        Line2D([], [], **style, linewidth=1.9, label=" ".join(arm).rstrip()) for arm, style in drawn.items()
    ]
    rows, columns = -(-len(shown) // CURVE_COLUMNS), min(len(shown), CURVE_COLUMNS)
    figure, panels = panel_figure(rows, columns, CURVE_PANEL, f"{title}: {CURVE_WORDS}", handles)
    for axes, panel in zip(panels.flat, shown, strict=False):
        seeds = _number_span([len(one.samples) for one in panel.curves])
        ends = _number_span([sample_end(sample) for one in panel.curves for sample in one.samples])
        _begin_panel(axes, panel.scene.words, panel.measure, f"{seeds} seeds \u00d7 {ends} evaluations")
        for one in panel.curves:
            _draw_curve(axes, panel, one, drawn[one.arm])
        axes.set(xlim=(0, max(panel.end, 1)), xlabel="evaluations")
        axes.set_ylim(bottom=0)
        axes.xaxis.set_major_locator(MaxNLocator(4, integer=True))
        axes.xaxis.set_major_formatter(FuncFormatter(lambda x, _: f"{x:,g}"))
        if panel.is_share:
            axes.yaxis.set_major_formatter(PercentFormatter(1.0))
    return figure


def _draw_curve(axes: Axes, panel: CurvePanel, one: QuartileCurve, style: dict[str, Any]) -> None:
    colour = style["color"]
    axes.plot(one.evaluations, one.median, **style, linewidth=1.9)
    axes.fill_between(one.evaluations, one.low, one.high, color=colour, alpha=BAND_OPACITY, linewidth=0)
    for sample in one.samples:
        if not all(run.complete for run in sample):
            end = sample_end(sample)
            axes.plot([end], [panel.values(sample, end)], marker="o", markersize=4.5, color=colour,
                      markerfacecolor="white", clip_on=False, zorder=5)  # fmt: skip


def _number_span(numbers: Sequence[int]) -> str:
    low, high = min(numbers, default=0), max(numbers, default=0)
    return f"{low:,}" if low == high else f"{low:,}\u2013{high:,}"


NU_TICKS = (("0", 0.0), ("\u03c0/4", 0.25), ("\u03c0/2", 0.5), ("3\u03c0/4", 0.75), ("\u03c0", 1.0))
NU_PANEL = (3.2, 2.1)
NU_PRIOR = "contact"
"""The prior that leaves nu free; `approach` bounds it, and antipodal hands lie along their points' line."""


@dataclass(frozen=True)
class NuDistribution:
    """The distribution of nu of a method's successes with one hand, over its objects."""

    hand: str
    arm: MethodVariant
    share: NDArray[np.float64]
    """(24,): mean over runs of the share of successes in each bin."""
    runs: int
    """Runs with a success that has a nu."""

    @property
    def words(self) -> str:
        """The mean share below pi / 4."""
        near = self.share[: NU_BINS // 4].sum()
        return f"{near:.0%} below \u03c0/4, {counted(self.runs, 'run')}"


def nu_distributions(groups: Sequence[RunGroup]) -> list[NuDistribution]:
    """Return the distributions of each hand's methods with the contact prior."""
    found = []
    for scene, here in grouped_by(groups, by_object=False).items():
        arms: dict[MethodVariant, list[NDArray[np.float64]]] = {}
        for group in here:
            if registry.method(group.method).prior == NU_PRIOR:
                bins = [np.array(run.summary.nu.bins) for run in group.finished_runs]
                arms.setdefault(group.arm, []).extend(each / each.sum() for each in bins if each.any())
        for arm, shares in arms.items():
            if shares:
                found.append(NuDistribution(scene.gripper, arm, np.mean(shares, axis=0), len(shares)))
    return found


def draw_nu(found: Sequence[NuDistribution]) -> Figure:
    """Draw a row for each hand, a column for each method (the paper's third figure)."""
    hands = list(dict.fromkeys(one.hand for one in found))
    arms = list(dict.fromkeys(one.arm for one in found))
    title = "Lean \u03bd of successes from the surface normal: shares in bins of 7.5\u00b0"
    figure, panels = panel_figure(len(hands), len(arms), NU_PANEL, title)
    for one in found:
        _draw_distribution(panels[hands.index(one.hand), arms.index(one.arm)], one)
    return figure


def _draw_distribution(axes: Axes, lean: NuDistribution) -> None:
    edges, hue = np.linspace(0, 1, NU_BINS + 1), hue_of(lean.arm[0])
    _begin_panel(axes, lean.hand, " ".join(lean.arm).rstrip(), lean.words, colour=hue)
    for low, high, opacity in ((0, NU_BINS // 4, 0.9), (NU_BINS // 4, NU_BINS, 0.4)):
        axes.stairs(lean.share[low:high], edges[low : high + 1], fill=True, color=hue, alpha=opacity)
    axes.axvline(0.25, color=INK, linewidth=0.9, linestyle=(0, (4, 2)))
    axes.axhline(1 / NU_BINS, color=FAINT, linewidth=0.8, linestyle=(0, (1.5, 1.5)))
    axes.annotate(
        "uniform", (1, 1 / NU_BINS), (0, 3), textcoords="offset points", size=7, color=FAINT, ha="right",
        path_effects=[OUTLINE],
    )  # fmt: skip
    axes.set(xlim=(0, 1))
    axes.set_xticks([place for _, place in NU_TICKS], [word for word, _ in NU_TICKS])
    axes.yaxis.set_major_formatter(PercentFormatter(1.0))
    axes.yaxis.set_major_locator(MaxNLocator(3))


MOST_VOXEL_ROWS = 8  # Scenes whose cells are drawn; of more, those of the object that most hands have
VOXEL_PANEL, VOXEL_PIXELS = (2.8, 3.1), 420
TRIAD_LENGTH = 0.085  # Of the object's axes, as a share of a view's height


@dataclass(frozen=True)
class RunVoxels:
    """The cells of one run with a success, and the most robust success in each."""

    name: SceneName
    run: RunHistory
    scene: Scene
    best: Rows
    """(n,): the fittest success of each cell, of equals the first; `fitness` sums its trials."""

    @property
    def places(self) -> NDArray[np.int64]:
        """(n, 3) [cm]: the cells, CoM frame."""
        return cells(self.best["descriptor"][:, :3])

    @property
    def words(self) -> str:
        """Caption: the number of cells, and their robustness."""
        found = counted(len(self.best), "cell", told="{:,}".format)
        return f"{found}, {int((survival(self.best) == ROBUST).sum()):,} robust"


def drawn_methods(groups: Sequence[RunGroup]) -> list[str]:
    """Choose those of the compared methods that found anything, else the one with most cells."""
    found: dict[str, int] = {}
    for group in groups:
        found[group.method] = found.get(group.method, 0) + sum(run.cells.end for run in group.runs)
    compared = [method for method in COMPARED_METHODS if found.get(method)]
    best = max(found, key=lambda method: found[method], default="")
    return compared or ([best] if found.get(best) else [])


def run_voxels(groups: Sequence[RunGroup], methods: Sequence[str]) -> list[list[RunVoxels]]:
    """For each scene, the cells of each method's run with the median number of them.

    Of more than eight scenes, those of the object that most hands have. Runs without a scene in their folder,
    and scenes without a run, are left out.
    """
    chosen: dict[SceneName, dict[str, RunGroup]] = {}
    for group in groups:
        if group.method in methods and group.finished_runs:
            chosen.setdefault(group.scene, {}).setdefault(group.method, group)
    names = [scene.object for scene in chosen]
    most = max(names, key=names.count) if len(chosen) > MOST_VOXEL_ROWS else ""
    rows = []
    for scene, found in chosen.items():
        if most in ("", scene.object):
            there = [found[method] for method in methods if method in found]
            ordered = [sorted(group.finished_runs, key=lambda run: run.cells.end) for group in there]
            runs = [each[(len(each) - 1) // 2] for each in ordered]
            folders = [(RunFolder(run.path), run) for run in runs if RunFolder(run.path).has_bundle()]
            rows.append(
                [
                    RunVoxels(scene, run, folder.scene(), best_in_cells(folder.successes().scored))
                    for folder, run in folders
                ]
            )
    return [row for row in rows if row]


def draw_voxels(rows: Sequence[Sequence[RunVoxels]], methods: Sequence[str]) -> Figure:
    """Draw a row for each scene, a column for each method (the paper's fourth figure).

    All views of an object have one camera.
    """
    everything = [one for row in rows for one in row]
    drawn = [method for method in methods if any(one.run.spec.method == method for one in everything)]
    title = "Where methods had successes: cells of 1 cm, by the most robust success"
    legend = [
        Line2D([], [], linestyle="none", marker="s", markersize=8, color=to_rgb(hue), label=words)
        for hue, words in zip(FITNESS_COLOURS, FITNESS_WORDS, strict=True)
    ]
    figure, panels = panel_figure(len(rows), len(drawn), VOXEL_PANEL, title, legend)
    for row, row_panels in zip(rows, panels, strict=True):
        beside = [one for one in everything if one.name.object == row[0].name.object]
        azimuth = broad_azimuth(row[0].scene)
        for one in row:
            axes = row_panels[drawn.index(one.run.spec.method)]
            _draw_cells(axes, one, azimuth, [other.places for other in beside])
    return figure


def _draw_cells(axes: Axes, one: RunVoxels, azimuth: float, beside: Sequence[NDArray[np.int64]]) -> None:
    view = view_of_cells(one.scene, one.best, azimuth, VOXEL_PIXELS, beside)
    found = one.words + ("" if view.is_uncut else "; cut open")
    run = f"seed {one.run.spec.seed}, {one.run.evaluations:,} evaluations"
    axes.set_visible(True)
    show_view(axes, view, "bicubic")
    axes_triad(axes, view, length=TRIAD_LENGTH)
    method = one.run.spec.method
    heading = figure_text(f"{one.name.words}\n{method}\n{found}\n{run}")
    axes.set_title(heading, loc="left", size=8, color=hue_of(method))
