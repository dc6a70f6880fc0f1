"""Figure of the calibration study: survival by eta, by disturbance, and its prediction."""

import textwrap
from collections.abc import Sequence

import numpy as np
from benchmarks.physics.calibration.study import DISTURBANCES, UNSEEN
from benchmarks.physics.calibration.survival import (
    PREDICTORS,
    Interval,
    Rows,
    by_hand,
    by_scene,
    drawn,
    eta_bins,
    mean_interval,
    of_group,
    predicted,
    survival,
)
from matplotlib.axes import Axes
from matplotlib.lines import Line2D

from qdgrasp_tools.report.figure_grid import CONTEXT, FAINT, INK, FigureGrid, panel_heading, plain_axes

HUES = ("#0072b2", "#d55e00", "#009e73", "#cc79a7")
"""Colours of hands, in their order; of Okabe and Ito."""
APART = 0.3
"""Distance of the marks of two hands on a line of a panel [lines]."""
PANEL = 2.9, 2.9  # inches
LABEL = 30  # Letters on a line of a label, at most
TITLE = "Grasps under disturbances that did not rank them"
WORDS = "In simulation; no robot was used. Left and right: 95 % bootstrap intervals over grasps."


def draw(rows: Rows) -> FigureGrid:
    """Draw three panels, with one colour for each hand."""
    colours = {hand: HUES[place % len(HUES)] for place, hand in enumerate(by_hand(rows))}
    grid = FigureGrid(1, 3, PANEL, legend_rows=1, space_above=0.45, space_beside=1.9, left=0.55)
    _reliability(grid.axes(0, 0), rows, colours)
    _disturbances(grid.axes(0, 1), rows, colours)
    _predictors(grid.axes(0, 2), rows, colours)
    grid.title(TITLE, WORDS)
    grid.legend([_mark(colour, hand) for hand, colour in colours.items()], len(colours), length=1.0)
    return grid


def _mark(colour: str, label: str) -> Line2D:
    return Line2D([], [], color=colour, marker="o", ms=5, lw=0, label=label)


def _reliability(axes: Axes, rows: Rows, colours: dict[str, str]) -> None:
    """Survival of grasps drawn at random over their eta, with the number of grasps at each mark."""
    plain_axes(axes)
    axes.plot([0, 1], [0, 1], color=CONTEXT, lw=1, zorder=1)
    for place, (hand, some) in enumerate(by_hand(drawn(rows)).items()):
        bins, colour = eta_bins(some), colours[hand]
        points = [(each.eta, each.unseen) for each in bins]
        _bars(axes, points, colour)
        is_left = place % 2 == 0
        for each, (x, y) in zip(bins, points, strict=True):
            axes.annotate(
                str(len(each.rows)), (x, y.value), (-5, 4) if is_left else (5, -9),
                textcoords="offset points", ha="right" if is_left else "left", size=7, color=colour,
            )  # fmt: skip
    axes.set(xlim=(-0.03, 1.03), ylim=(-0.03, 1.03))
    axes.set_xlabel("eta, mean of the bin", size=8, color=FAINT)
    panel_heading(axes, "Survival by eta", "grasps drawn at random, and how many")


def _bars(axes: Axes, points: Sequence[tuple[float, Interval]], colour: str) -> None:
    for x, found in points:
        axes.plot([x, x], [found.low, found.high], color=colour, lw=1, alpha=0.6)
    axes.plot([x for x, _ in points], [y.value for _, y in points], "-o", color=colour, ms=5, lw=1.2)


def _disturbances(axes: Axes, rows: Rows, colours: dict[str, str]) -> None:
    """Shares held under each disturbance: the best-ranked, and random ones that hold undisturbed."""
    names = [textwrap.fill(each.label, LABEL) for each in DISTURBANCES]
    _lines_of(axes, names)
    axes.axhline(len(UNSEEN) - 0.5, color=FAINT, lw=0.7)
    for (hand, colour), offset in zip(colours.items(), _offsets(len(colours)), strict=True):
        for line, each in enumerate(DISTURBANCES):
            scenes = by_scene(by_hand(rows)[hand]).values()
            best, held = (
                mean_interval([survival(of_group(some, group), [each]) for some in scenes]).value
                for group in ("best", "held")
            )
            axes.plot([held, best], [line + offset] * 2, color=colour, lw=1, alpha=0.6)
            axes.plot(held, line + offset, "o", color=colour, ms=8, mfc="white")
            axes.plot(best, line + offset, "o", color=colour, ms=4.5)
    axes.set_xlim(-0.03, 1.03)
    panel_heading(
        axes,
        "Share held by disturbance",
        "full: best-ranked, hollow: random held;",
        "under the line: of the ranking's kind",
    )


def _predictors(axes: Axes, rows: Rows, colours: dict[str, str]) -> None:
    """Concordance of each predictor with survival, of random grasps that hold undisturbed."""
    names = [name for name in PREDICTORS if name != "pushes in MuJoCo"]  # those that hold have all
    _lines_of(axes, names)
    axes.axvline(0.5, color=CONTEXT, lw=1, zorder=1)
    holding = by_hand([row for row in drawn(rows) if row.holds])
    for (hand, colour), offset in zip(colours.items(), _offsets(len(colours)), strict=True):
        for line, name in enumerate(names):
            found = predicted(holding.get(hand, []), name)
            axes.plot([found.low, found.high], [line + offset] * 2, color=colour, lw=1, alpha=0.6)
            axes.plot(found.value, line + offset, "o", color=colour, ms=5)
    axes.set_xlim(-0.03, 1.03)
    panel_heading(axes, "Concordance with survival", "random grasps that hold; 0.5: chance")


def _lines_of(axes: Axes, names: Sequence[str]) -> None:
    plain_axes(axes)
    axes.set_ylim(len(names) - 0.5, -0.5)
    axes.set_yticks(range(len(names)), names)
    axes.tick_params(axis="y", labelcolor=INK, labelsize=7.5)


def _offsets(n: int) -> list[float]:
    """Offsets of the marks of n hands from a line."""
    offsets: list[float] = (APART * (np.arange(n) - (n - 1) / 2)).tolist()
    return offsets
