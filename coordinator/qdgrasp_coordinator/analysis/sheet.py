"""Sheets: figures of equal panels in rows and columns, measured in inches, and how they are written."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import matplotlib
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import FuncFormatter, MaxNLocator, NullFormatter

from qdgrasp_coordinator.analysis.lettering import lettered
from qdgrasp_coordinator.analysis.palette import FAINT, INK, RULE

DPI = 200
SALT = "qdgrasp"
"""Of the names in an SVG, so that the same figure gives the same bytes."""


@dataclass
class Sheet:
    """A figure with `rows` x `columns` panels."""

    rows: int
    columns: int
    panel: tuple[float, float]
    """Width and height of a panel [inches]."""
    legend_rows: int = 0
    least: float = 6.4
    """The figure is at least so wide [inches]."""
    over: float = 0.62
    """Room above each panel for its heading [inches]."""
    below: float = 0.5
    """Room below each panel for its axis [inches]."""
    aside: float = 0.6
    """Room between panels side by side [inches]."""
    left: float = 0.7
    figure: Figure = field(init=False)

    def __post_init__(self) -> None:
        width = self.left + self.columns * (self.panel[0] + self.aside) - self.aside + 0.35
        height = self._top(self.rows) - self.over + 0.08
        self.size = max(width, self.least), height
        self.figure = Figure(figsize=self.size, facecolor="white")
        FigureCanvasAgg(self.figure)

    def _top(self, row: int) -> float:
        """How far below the figure's upper edge the panels of a row begin [inches]."""
        head = 0.9 + 0.19 * self.legend_rows
        return head + self.over + row * (self.panel[1] + self.below + self.over)

    def axes(self, row: int, column: int) -> Axes:
        """The panel in a row and a column, from the upper left."""
        width, height = self.size
        x = self.left + column * (self.panel[0] + self.aside)
        y = height - self._top(row) - self.panel[1]
        return self.figure.add_axes((x / width, y / height, self.panel[0] / width, self.panel[1] / height))

    def title(self, title: str, words: str) -> None:
        """What the figure shows, and under it how."""
        width, height = self.size
        x = 0.3 / width
        self.figure.text(
            x, 1 - 0.32 / height, lettered(title), size=14, weight="bold", color=INK, va="center"
        )
        self.figure.text(x, 1 - 0.6 / height, lettered(words), size=8.5, color=FAINT, va="center")

    def legend(self, handles: list[Line2D], columns: int, length: float = 3.2) -> None:
        """Name the lines, drawn `length` letters long, `columns` side by side, filled column by column."""
        width, height = self.size
        self.figure.legend(
            handles=handles, loc="upper left", bbox_to_anchor=(0.3 / width, 1 - 0.8 / height), ncols=columns,
            frameon=False, fontsize=8.5, handlelength=length, columnspacing=2.2, borderaxespad=0, borderpad=0,
            labelcolor=INK, labelspacing=0.45,
        )  # fmt: skip

    def write(self, stem: Path) -> list[Path]:
        """Write it as PNG and SVG."""
        paths = [stem.with_suffix(".png"), stem.with_suffix(".svg")]
        with matplotlib.rc_context({"svg.hashsalt": SALT, "svg.fonttype": "path"}):
            self.figure.savefig(paths[0], dpi=DPI)
            self.figure.savefig(paths[1], dpi=DPI, metadata={"Date": None})
        return paths


def plain(axes: Axes) -> None:
    """Two faint axes, faint rules behind the data, few ticks."""
    axes.spines[["top", "right", "left"]].set_visible(False)
    axes.spines["bottom"].set_color(FAINT)
    axes.tick_params(colors=FAINT, labelsize=8, length=3, width=0.7)
    axes.tick_params(axis="y", which="both", length=0)
    axes.tick_params(axis="x", which="minor", length=1.5, width=0.5, color=FAINT)
    axes.grid(axis="y", color=RULE, linewidth=0.6)
    axes.set_axisbelow(True)


def heading(axes: Axes, words: str, *under: str, color: str = INK) -> None:
    """A panel's heading, and fainter lines under it, all above the panel."""
    for line, text in enumerate(reversed(under)):
        above(axes, text, 5 + 10.5 * line, size=7.5, color=FAINT)
    above(axes, words, 6 + 10.5 * len(under), size=10, weight="bold", color=color)


def above(axes: Axes, words: str, height: float, **style: Any) -> None:
    """Words above a panel, `height` points over its upper left corner."""
    axes.annotate(lettered(words), (0, 1), (0, height), xycoords="axes fraction", textcoords="offset points",
                  annotation_clip=False, **style)  # fmt: skip


def count_evaluations(axes: Axes, end: int, *, log: bool) -> None:
    """Make x count evaluations up to `end`: from 0, or from a hundredth of it on a logarithmic axis."""
    if log:
        axes.set_xscale("log")
        axes.xaxis.set_minor_formatter(NullFormatter())
    else:
        axes.xaxis.set_major_locator(MaxNLocator(4, integer=True, steps=[1, 2, 5, 10]))
    axes.set_xlim(max(end, 1) / 100 if log else 0, max(end, 1))
    axes.xaxis.set_major_formatter(FuncFormatter(lambda x, _: short(x)))
    axes.set_xlabel("evaluations", size=8, color=FAINT, labelpad=2)


def count_up(axes: Axes, top: float, *, share: bool, log: bool) -> None:
    """Make y a share or a count up to a little more than `top`: from 0, or over three decades."""
    if log:
        axes.set_yscale("log")
        axes.yaxis.set_minor_formatter(NullFormatter())
    else:
        axes.yaxis.set_major_locator(MaxNLocator(4, integer=not share, steps=[1, 2, 2.5, 5, 10]))
    end = top if top > 0 else 1.0
    axes.set_ylim(end / 1000 if log else 0, (1.3 if log else 1.06) * end)
    axes.yaxis.set_major_formatter(FuncFormatter(lambda y, _: f"{100 * y:g}\u202f%" if share else f"{y:,g}"))


def short(number: float) -> str:
    """A number of evaluations in little room: 500, 2k, 10M."""
    units: Mapping[str, float] = {"M": 1e6, "k": 1e3}
    for unit, size in units.items():
        if number >= size:
            return f"{number / size:g}{unit}"
    return f"{number:g}"
