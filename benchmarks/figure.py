"""Figure of `make bench`: time by stage, a bar for each hand, object and regime."""

from collections.abc import Mapping, Sequence

from benchmarks.evaluation_speed import ORDER, STEPS
from benchmarks.measure import Figure, duration_text
from matplotlib.axes import Axes
from matplotlib.patches import Patch
from matplotlib.ticker import FuncFormatter

from qdgrasp_tools.report.figure_grid import FAINT, INK, RULE, FigureGrid, panel_heading, plain_axes

NAME = "where-the-time-goes"
COLOURS = {
    "decode": "#4d4d4d",
    "overlap filter": "#009e73",
    "features": "#cc79a7",
    "never-touch filter": "#f0e442",
    "place, overlap": "#56b4e9",
    "closing": "#0072b2",
    "shake z": "#d55e00",
    "shake x": "#e69f00",
    "rest": "#9aa2aa",
}
"""Colour of each stage; the hues of Okabe and Ito, as in the figures of campaigns."""
PALE = 0.45
"""Opacity of the part of a stage outside the simulator's own steps, if it has some."""
BAR, PITCH = 0.66, 0.235
"""Height of a bar, of the room for it; and that room [inches]."""
ROOM = 1.2
"""Length of the axis in bars: each bar is followed by its time in words."""
HOW = (
    "Share of an evaluation's CPU time, and how long it takes. "
    "Full colour: the simulator's steps; pale: what the same stage does besides."
)


def draw(figures: Sequence[Figure]) -> FigureGrid:
    """A column for each regime, a row for each hand and object."""
    bars = {tuple(figure.name.split(", ", 1)): figure for figure in figures if figure.stages}
    pairs, regimes = (list(dict.fromkeys(name[i] for name in bars)) for i in (0, 1))
    size = (3.2, PITCH * len(pairs))
    grid = FigureGrid(
        1, len(regimes), size, legend_rows=1, space_above=0.3, space_beside=0.1, left=2.15, least_width=9.0
    )
    for column, regime in enumerate(regimes):
        axes = grid.axes(0, column)
        _style_axes(axes, regime, pairs if column == 0 else [""] * len(pairs))
        for row, pair in enumerate(pairs):
            if figure := bars.get((pair, regime)):
                _bar(axes, row, figure)
    grid.title("Where does the time go", HOW)
    present = {name.removesuffix(STEPS) for figure in bars.values() for name in figure.stages}
    handles = [Patch(color=COLOURS[stage], label=stage) for stage in ORDER if stage in present]
    grid.legend(handles, len(handles), length=1.0)
    return grid


def _style_axes(axes: Axes, regime: str, names: Sequence[str]) -> None:
    plain_axes(axes)
    axes.grid(visible=False, axis="y")
    axes.grid(axis="x", color=RULE, linewidth=0.6)
    axes.set_xlim(0, ROOM)
    axes.set_xticks([0, 0.25, 0.5, 0.75, 1])
    axes.set_ylim(len(names) - 0.5, -0.5)
    axes.set_yticks(range(len(names)), names)
    axes.tick_params(axis="y", labelcolor=INK)
    axes.xaxis.set_major_formatter(FuncFormatter(lambda x, _: f"{100 * x:.0f}\u202f%"))
    panel_heading(axes, regime)


def _bar(axes: Axes, row: int, figure: Figure) -> None:
    stages: Mapping[str, float] = figure.stages
    whole, left = sum(stages.values()), 0.0
    for stage in ORDER:
        steps = stages.get(stage + STEPS, 0.0)
        for time, opacity in ((steps, 1.0), (stages.get(stage, 0.0), PALE if steps else 1.0)):
            width = time / whole
            axes.barh(row, width, BAR, left, color=COLOURS[stage], alpha=opacity, linewidth=0)
            left += width
    words = duration_text(figure.microseconds)
    axes.annotate(words, (1, row), (4, 0), textcoords="offset points", va="center", size=7.5, color=FAINT,
                  annotation_clip=False)  # fmt: skip
