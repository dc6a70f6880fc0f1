"""The paper's Figures 1 and 2 and its choice of sigma, drawn from the table: coverage at milestones."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from benchmarks.results.comparison import COVERAGE, Arm, changed
from benchmarks.results.paper_claims import sigma_of
from benchmarks.results.table import MILESTONES
from matplotlib.ticker import FuncFormatter, NullFormatter

from qdgrasp_protocol.text import counted
from qdgrasp_tools.report.figure_grid import (
    FigureGrid,
    evaluation_axis,
    line_styles,
    panel_heading,
    plain_axes,
    value_axis,
)
from qdgrasp_tools.report.figures import COMPARED_METHODS, legend_width, method_legend

FIGURE = "paper-figures"
BUDGET = 5000
"""Evaluations of the runs that are drawn: those of the claims' campaigns, a twentieth of the paper's."""
PANEL, COLUMNS = (3.3, 2.2), 3


@dataclass(frozen=True)
class FigurePanel:
    """A panel: for each method its places along x, and its coverage of S_G there."""

    heading: str
    objects: Sequence[str]
    seeds: Sequence[int]
    """Numbers of runs behind a point."""
    lines: Mapping[str, tuple[Sequence[float], Sequence[float]]]
    is_of_sigma: bool = False

    @property
    def words(self) -> str:
        """Objects and seeds behind it."""
        least, most = min(self.seeds), max(self.seeds)
        seeds = counted(most, "seed") if least == most else f"{least} to {most} seeds"
        return f"{' and '.join(name.removeprefix('ycb_') for name in self.objects)}, {seeds}"


def figure_panels(claimed: Sequence[Arm], sigma: Sequence[Arm]) -> Iterator[FigurePanel]:
    """The panels of Figure 1 by hand, of Figure 2 for hands with all of it, and of sigma by object."""
    by_hand: dict[str, dict[str, dict[str, Arm]]] = {}
    for arm in claimed:
        if arm.key.budget == BUDGET and not changed(arm.key) and len(arm.values(COVERAGE.name)):
            objects = by_hand.setdefault(arm.key.gripper, {})
            objects.setdefault(arm.key.object, {})[arm.key.method] = arm
    for hand, objects in by_hand.items():
        yield from _curve_panel(f"Figure 1, {hand}", objects, set(COMPARED_METHODS))
    for hand, objects in by_hand.items():
        whole = set().union(*objects.values())
        if whole - set(COMPARED_METHODS):
            yield from _curve_panel(f"Figure 2, {hand}", objects, whole - {"me_scs"})
    by_object: dict[str, dict[str, list[Arm]]] = {}
    for arm in sigma:
        if len(arm.values(COVERAGE.name)):
            by_object.setdefault(arm.key.object, {}).setdefault(arm.key.method, []).append(arm)
    for name, methods in by_object.items():
        lines = {method: _over_sigma(arms) for method, arms in methods.items()}
        seeds = [len(arm.rows) for arms in methods.values() for arm in arms]
        yield FigurePanel("Sigma, panda", (name,), seeds, lines, is_of_sigma=True)


def _curve_panel(
    heading: str, objects: Mapping[str, Mapping[str, Arm]], methods: set[str]
) -> Iterator[FigurePanel]:
    """Curves of those methods that are there, over the objects that all of these have."""
    there = methods & set().union(*objects.values())
    whole = {name: arms for name, arms in objects.items() if there <= arms.keys()}
    if not whole:
        return
    at = {budget: f"coverage_{name}" for name, budget in MILESTONES.items() if budget < BUDGET}
    columns = {**at, BUDGET: COVERAGE.name}

    def covered(method: str, column: str) -> float:
        return float(np.mean([np.median(arms[method].values(column)) for arms in whole.values()]))

    lines = {
        method: ([0, *columns], [0.0, *(covered(method, column) for column in columns.values())])
        for method in sorted(there)
    }
    seeds = [len(arms[method].rows) for arms in whole.values() for method in there]
    yield FigurePanel(heading, list(whole), seeds, lines)


def _over_sigma(arms: Sequence[Arm]) -> tuple[list[float], list[float]]:
    ordered = sorted(arms, key=sigma_of)
    return [*map(sigma_of, ordered)], [float(np.median(arm.values(COVERAGE.name))) for arm in ordered]


def draw(claimed: Sequence[Arm], sigma: Sequence[Arm]) -> FigureGrid | None:
    """Draw the panels, three in a row; None without a run."""
    panels = list(figure_panels(claimed, sigma))
    if not panels:
        return None
    styles = line_styles((method, "") for panel in panels for method in panel.lines)
    handles, across = method_legend(styles)
    rows = -(-len(panels) // COLUMNS)
    grid = FigureGrid(
        rows, COLUMNS, PANEL, caption_rows=2, legend_rows=len(handles) // across,
        least_width=legend_width(handles, across),
    )  # fmt: skip
    for number, panel in enumerate(panels):
        axes = grid.axes(*divmod(number, COLUMNS))
        plain_axes(axes)
        value_axis(axes, max(max(found) for _, found in panel.lines.values()), share=True, log=False)
        if panel.is_of_sigma:
            ticks = next(iter(panel.lines.values()))[0]
            axes.set_xscale("log")
            axes.set_xticks(ticks)
            axes.xaxis.set_major_formatter(FuncFormatter(lambda x, _: f"{x:g}"))
            axes.xaxis.set_minor_formatter(NullFormatter())
        else:
            evaluation_axis(axes, BUDGET, log=False)
        panel_heading(axes, panel.heading, "coverage of S_G", panel.words)
        for method, (at, found) in panel.lines.items():
            style = styles[method, ""]
            axes.plot(at, found, color=style.colour, linestyle=style.dashes, marker="o", markersize=2.5)
    grid.title(
        "The paper's Figures 1 and 2, and its choice of sigma",
        "Solid: searches for quality and diversity; dashed: standard sampling schemes. Protocol paper, "
        "every pose counted.",
        f"Median over seeds, mean over objects, at milestones up to {BUDGET:,} evaluations.",
    )
    grid.legend(handles, across)
    return grid
