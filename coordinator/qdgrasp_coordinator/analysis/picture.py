"""`grasps.png`: hands on the object, the cells where it was grasped, and how they were found."""

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator, StrMethodFormatter

from qdgrasp_assets.scene import Scene
from qdgrasp_coordinator.analysis.fitness import COLOURS, WORDS
from qdgrasp_coordinator.analysis.growth import Growth, growth
from qdgrasp_coordinator.analysis.layers import FINE
from qdgrasp_coordinator.analysis.lettering import lettered
from qdgrasp_coordinator.analysis.views import (
    View,
    best_in_cells,
    side_of,
    view_of_cells,
    view_of_hands,
)
from qdgrasp_coordinator.counts.scores import ROBUST
from qdgrasp_protocol.outcome import Outcome
from qdgrasp_protocol.phrases import counted
from qdgrasp_protocol.rows import Rows
from qdgrasp_protocol.spec import RunSpec

SIZE = (16.0, 10.0)  # inches
HANDS, CELLS, GROWTH = (0.01, 0.02, 0.545, 0.872), (0.6, 0.385, 0.294, 0.47), (0.64, 0.085, 0.26, 0.19)
"""Where the three panels stand: left, bottom, width and height as shares of the figure."""
INK, FAINT = "#22262b", "#69717a"
LINES = {"successes": "#8a9199", "cells": "#2a73b9"}
FOUND = {Outcome.DROPPED: "successes", Outcome.SHAKEN: "grasps", Outcome.HELD: "robust"}
LABELS_APART = 0.22
"""Lines that end closer than this, as a share of the panel, have the lower one's label moved down."""
BAR = 0.05
"""Length of the scale bar [m]."""


def draw_grasps(
    scene: Scene, rows: Rows, path: Path, *, spec: RunSpec | None = None, pixels: int = 1040
) -> None:
    """Draw what a run has found.

    Parameters
    ----------
    scene
        The run's scene.
    rows
        Its rows in journal order; there may be no success among them.
    path
        The PNG file to write, in a folder that exists.
    spec
        Names method and seed in the title, and says whether overlaps count as evaluations.
    pixels
        Width of the view of the hands; the picture is 1.8 times as wide.
    """
    nominal = rows[rows["trial"] == 0]
    successes = nominal[nominal["outcome"] >= Outcome.DROPPED]
    best, grown = best_in_cells(successes), growth(nominal, spec.overlaps if spec else "count")
    side = side_of(scene, successes)
    figure = Figure(figsize=SIZE, dpi=pixels / (SIZE[1] * HANDS[3]), facecolor="white")
    _title(figure, scene, spec, _in_words(successes, grown))
    _hands(figure.add_axes(HANDS), view_of_hands(scene, successes, side, pixels), successes)
    _cells(figure.add_axes(CELLS), view_of_cells(scene, best, side, round(pixels * CELLS[3] / HANDS[3])))
    _growth(figure.add_axes(GROWTH), grown)
    figure.savefig(path, format="png")


def _in_words(successes: Rows, grown: Growth) -> str:
    found = [f"{int((successes['outcome'] >= least).sum()):,} {word}" for least, word in FOUND.items()]
    cells = counted(int(grown.cells[-1]), "cell", told="{:,}".format)
    return f"{grown.evaluations[-1]:,} evaluations  \u2192  {', '.join(found)}; {cells}"


def _title(figure: Figure, scene: Scene, spec: RunSpec | None, found: str) -> None:
    made = "" if spec is None else f"{spec.method}, seed {spec.seed}, "
    title = f"{scene.gripper.name}  on  {scene.object.name}"
    figure.text(0.022, 0.951, lettered(title), size=26, weight="bold", color=INK, va="center")
    words = f"{made}protocol {scene.protocol}:   {found}"
    figure.text(0.022, 0.911, words, size=13.5, color=FAINT, va="center")


def _hands(axes: Axes, view: View, successes: Rows) -> None:
    _show(axes, view)
    _caption(axes, _choice_in_words(view.shown, successes))
    scale_bar(axes, view)
    triad(axes, view)


def _choice_in_words(shown: Rows, successes: Rows) -> str:
    if not len(shown):
        return "no grasp to show"
    least = max(kind for kind in FOUND if (shown["outcome"] >= kind).all())
    noun = "robust grasps" if least is Outcome.HELD else FOUND[least]
    return f"{len(shown)} of {int((successes['outcome'] >= least).sum()):,} {noun}"


def _cells(axes: Axes, view: View) -> None:
    _show(axes, view)
    scale_bar(axes, view)
    cells = counted(len(view.shown), "cell", told="{:,}".format)
    heading = f"{cells} of 1 cm where the hand had a success"
    axes.set_title(heading + ("" if view.whole else ", cut open"), size=13, color=INK, loc="left", pad=4)
    fitness = np.clip(view.shown["fitness"], 0, ROBUST).astype(int)
    for best, (colour, word) in enumerate(zip(COLOURS, WORDS, strict=True)):
        height = -0.03 - 0.055 * (ROBUST - best)
        axes.text(0.0, height, "\u25a0", color=colour, size=15, transform=axes.transAxes, va="center")
        words = f"{int((fitness == best).sum()):,}  {word}"
        axes.text(0.045, height, words, color=FAINT, size=12, transform=axes.transAxes, va="center")


def _growth(axes: Axes, grown: Growth) -> None:
    most, end = max(int(grown.successes[-1]), 1), int(grown.evaluations[-1])
    apart = (grown.successes[-1] - grown.cells[-1]) / most > LABELS_APART
    for word, series, shift in (
        ("successes", grown.successes, 0),
        ("cells", grown.cells, 0 if apart else -34),
    ):
        axes.plot(grown.evaluations, series, color=LINES[word], linewidth=2.4)
        axes.annotate(
            f"{series[-1]:,}\n{word}", (end, int(series[-1])), (8, shift), textcoords="offset points",
            color=LINES[word], size=12, weight="bold", va="center", annotation_clip=False,
        )  # fmt: skip
    axes.set(xlim=(0, max(end, 1)), ylim=(0, 1.04 * most))
    axes.spines[["top", "right"]].set_visible(False)
    axes.spines[["left", "bottom"]].set_color(FAINT)
    axes.tick_params(colors=FAINT, labelsize=11)
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_major_locator(MaxNLocator(4, integer=True))
        axis.set_major_formatter(StrMethodFormatter("{x:,.0f}"))
    axes.set_xlabel("evaluations", size=12, color=FAINT)


def _show(axes: Axes, view: View) -> None:
    axes.imshow(view.image, interpolation="none")
    axes.set_axis_off()


def _caption(axes: Axes, words: str) -> None:
    axes.text(0.5, 0.0, words, transform=axes.transAxes, size=13, color=FAINT, ha="center", va="bottom")


def scale_bar(axes: Axes, view: View) -> None:
    """A bar of 5 cm in the lower right corner."""
    rows, columns, _ = view.image.shape
    length = BAR / (view.camera.step * FINE)
    right, low = 0.985 * columns, 0.985 * rows
    axes.plot([right - length, right], [low, low], color=FAINT, linewidth=2, solid_capstyle="butt")
    axes.text(right - length / 2, low - 0.012 * rows, "5 cm", size=11, color=FAINT, ha="center", va="bottom")


def triad(axes: Axes, view: View) -> None:
    """The axes of the object's frame in the lower left corner."""
    rows, columns, _ = view.image.shape
    x, y, length = 0.075 * columns, 0.93 * rows, 0.05 * rows
    for name, (right, up, _) in zip("xyz", view.camera.axes.T.tolist(), strict=True):
        end = (x + length * right, y - length * up)
        axes.annotate("", end, (x, y), arrowprops={"arrowstyle": "-|>", "color": FAINT, "linewidth": 1.4})
        beyond = (x + 1.32 * length * right, y - 1.32 * length * up)
        axes.text(*beyond, name, size=11, color=FAINT, ha="center", va="center")
