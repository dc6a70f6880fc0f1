"""The figure of the curves: utilisation by runs, batches and crews, and the age of the search's state."""

from collections.abc import Sequence
from pathlib import Path

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from tests.simulation.curves import BATCHES, CREWS, LINES, RUNS, SIZES, Panel, Point, points, read, write

from qdgrasp_coordinator.analysis.palette import FAINT, INK, RULE

TITLES = {
    "runs": "Share of time that counts, by what is in flight",
    "batches": "64 runs, by rows in a batch",
    "crews": "1 run of 2 x 500, and 64 runs, where workers differ or freeze",
    "age": "From the ask of a generation to its tell (colours: both)",
}
PLACES = {"batches": "upper right", "crews": "center right", "age": "upper right"}
HUES = ("#0072b2", "#56b4e9", "#009e73", "#4d4d4d", "#e69f00", "#d55e00", "#cc79a7")
"""Of Okabe and Ito."""


def make(folder: Path) -> int:
    """Measure all points that are not in the folder's table, and draw them."""
    folder.mkdir(parents=True, exist_ok=True)
    table = folder / "curves.csv"
    if not table.exists():
        found: list[Point] = []
        for point in points():
            found.append(point)
            write(found, table)
    draw(read(table)).savefig(folder / "curves.png", dpi=130)
    return 0


def draw(found: Sequence[Point]) -> Figure:
    """Four panels."""
    figure = Figure(figsize=(11, 7.6), layout="constrained")
    (runs, age), (batches, crews) = figure.subplots(2, 2)
    _share(runs, RUNS, found)
    _age(age, found)
    _share(batches, BATCHES, found)
    _share(crews, CREWS, found)
    return figure


def _share(axes: Axes, panel: Panel, found: Sequence[Point]) -> None:
    _lines(axes, panel, found, "utilisation", 100.0)
    axes.set_ylim(0, 103)
    axes.set_ylabel("share of the workers' time that counts [%]", color=FAINT)
    _dress(axes, panel.name)


def _age(axes: Axes, found: Sequence[Point]) -> None:
    _lines(axes, RUNS, found, "age", 1.0)
    axes.set_yscale("log")
    axes.set_ylabel("seconds", color=FAINT)
    _dress(axes, "age")


def _lines(axes: Axes, panel: Panel, found: Sequence[Point], figure: str, scale: float) -> None:
    names = [line.name for line in LINES if line.panel == panel]
    for place, name in enumerate(names):
        of_line = [point for point in found if (point.panel, point.line) == (panel.name, name)]
        sizes = [point.workers for point in of_line]
        values = [scale * getattr(point.figures, figure) for point in of_line]
        is_second = panel == CREWS and place >= len(names) // 2
        colour = HUES[place % (len(names) // 2)] if panel == CREWS else HUES[place]
        axes.plot(sizes, values, "--" if is_second else "-", color=colour, marker="o", ms=3.5, label=name)


def _dress(axes: Axes, what: str) -> None:
    axes.set_xscale("log")
    axes.set_xlim(SIZES[0] * 0.85, SIZES[-1] * 1.18)
    axes.set_xticks(SIZES, [f"{size:,}".replace(",", " ") for size in SIZES])
    axes.minorticks_off()
    axes.set_xlabel("workers", color=FAINT)
    axes.set_title(TITLES[what], loc="left", fontsize=10.5, color=INK)
    axes.grid(color=RULE, lw=0.6)
    axes.spines[["top", "right"]].set_visible(False)
    axes.tick_params(colors=FAINT, labelsize=8.5)
    if what != "runs":  # the lines are those of the panel beside it
        axes.legend(loc=PLACES[what], frameon=False, fontsize=8, labelcolor=INK)
