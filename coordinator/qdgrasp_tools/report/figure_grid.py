"""Figures of equal panels in rows and columns, and the colours and lines of methods.

A prior has a hue, a family of searches a line style; sizes are in inches.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal, NamedTuple

import matplotlib
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import to_hex, to_rgb
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import FuncFormatter, MaxNLocator

from qdgrasp_coordinator.search import registry
from qdgrasp_tools.rendering.drawings import figure_text

Dashes = Literal["-"] | tuple[float, Sequence[float]]
INK, FAINT, RULE = "#22262b", "#69717a", "#d9dde1"
"""Colours of text, of notes beside it, and of rules."""
PRIOR_HUES = {
    "contact": "#0072b2",
    "approach": "#d55e00",
    "antipodal": "#009e73",
    "valued": "#cc79a7",
    "spherical": "#4d4d4d",
}
FAMILIES: dict[str, Dashes] = {
    "aimed": "-",
    "me_scs": "-",
    "cma_mae": (0, (1.1, 1.3)),
    "me_rand": (0, (5, 1.6, 1.1, 1.6)),
    "own": (0, (8, 1.6)),
    "rand": (0, (4.2, 2.2)),
}
"""Line styles: searches are drawn through, dotted or dash-dotted, plain sampling is dashed; `own`: those of
a program's own."""
PALEST_VARIANT = 0.65  # How much white is in the palest of a method's variants
PRIOR_ORDER = ("valued", "contact", "approach", "antipodal", "spherical")
"""The priors as they stand in legends and side by side: the default method's leads."""
MethodVariant = tuple[str, str]  # A method, and the words that tell its variant from others


class LineStyle(NamedTuple):
    """Colour and dashes of a method's variant."""

    colour: str
    dashes: Dashes


def default_prior(method: str) -> str:
    """Return the prior of a method, as runs have it unless their spec says otherwise."""
    return registry.method(method).prior


def family_of(method: str) -> str:
    """Return the family of a method: its name without the prior's prefix; `own` for a program's."""
    family = method.removeprefix(registry.PRIORS[default_prior(method)].prefix)
    return family if family in FAMILIES else "own"


def line_styles(arms: Iterable[MethodVariant]) -> dict[MethodVariant, LineStyle]:
    """Choose the style of each variant; of one method, each is paler than the one before."""
    variants: dict[str, list[MethodVariant]] = {}
    for arm in dict.fromkeys(arms):
        variants.setdefault(arm[0], []).append(arm)
    return {
        arm: LineStyle(hue_of(method, place / max(1, len(same) - 1)), FAMILIES[family_of(method)])
        for method, same in variants.items()
        for place, arm in enumerate(same)
    }


def hue_of(method: str, pale: float = 0.0) -> str:
    """Return the colour of a method, from its full hue at 0 to its palest variant at 1."""
    red, green, blue = (
        part + (1 - part) * PALEST_VARIANT * pale for part in to_rgb(PRIOR_HUES[default_prior(method)])
    )
    return to_hex((red, green, blue))


FIGURE_DPI = 200
SVG_SALT = "qdgrasp"  # Of the names in an SVG, so that the same figure gives the same bytes


@dataclass
class FigureGrid:
    """A figure with `rows` x `columns` panels."""

    rows: int
    columns: int
    panel: tuple[float, float]
    """Width and height of a panel [inches]."""
    legend_rows: int = 0
    caption_rows: int = 1
    least_width: float = 6.4
    """The figure is at least so wide [inches]."""
    space_above: float = 0.62
    """Room above each panel for its heading [inches]."""
    space_below: float = 0.5
    """Room below each panel for its axis [inches]."""
    space_beside: float = 0.6
    """Room between panels side by side [inches]."""
    left: float = 0.7
    figure: Figure = field(init=False)

    def __post_init__(self) -> None:
        width = self.left + self.columns * (self.panel[0] + self.space_beside) - self.space_beside + 0.35
        height = self._top(self.rows) - self.space_above + 0.08
        self.size = max(width, self.least_width), height
        self.figure = Figure(figsize=self.size, facecolor="white")
        FigureCanvasAgg(self.figure)

    def _top(self, row: int) -> float:
        """Return the distance of a row's panels from the figure's upper edge [inches]."""
        head = 0.7 + 0.2 * self.caption_rows + 0.19 * self.legend_rows
        return head + self.space_above + row * (self.panel[1] + self.space_below + self.space_above)

    def axes(self, row: int, column: int) -> Axes:
        """Add the panel in a row and a column, from the upper left."""
        width, height = self.size
        x = self.left + column * (self.panel[0] + self.space_beside)
        y = height - self._top(row) - self.panel[1]
        return self.figure.add_axes((x / width, y / height, self.panel[0] / width, self.panel[1] / height))

    def title(self, title: str, *caption: str) -> None:
        """Write a title, and lines of words under it."""
        self._write(0.3, 0.32, title, size=14, weight="bold", color=INK)
        for number, words in enumerate(caption):
            self._write(0.3, 0.6 + 0.2 * number, words, size=8.5, color=FAINT)

    def row_heading(self, row: int, words: str) -> None:
        """Write words over the headings of a row's panels."""
        self._write(self.left, self._top(row) - 0.66, words, size=11, weight="bold", color=INK)

    def _write(self, right: float, down: float, words: str, **style: Any) -> None:
        """Write words at a distance from the figure's upper left corner [inches]."""
        width, height = self.size
        self.figure.text(right / width, 1 - down / height, figure_text(words), va="center", **style)

    def legend(self, handles: list[Line2D], columns: int, length: float = 3.2) -> None:
        """Name the lines, drawn `length` letters long, in `columns` columns."""
        (width, height), top = self.size, 0.6 + 0.2 * self.caption_rows
        self.figure.legend(
            handles=handles, loc="upper left", bbox_to_anchor=(0.3 / width, 1 - top / height), ncols=columns,
            frameon=False, fontsize=8.5, handlelength=length, columnspacing=2.2, borderaxespad=0, borderpad=0,
            labelcolor=INK, labelspacing=0.45,
        )  # fmt: skip

    def write(self, stem: Path) -> list[Path]:
        """Write it as PNG and SVG."""
        paths = [stem.with_suffix(".png"), stem.with_suffix(".svg")]
        with matplotlib.rc_context({"svg.hashsalt": SVG_SALT, "svg.fonttype": "path"}):
            self.figure.savefig(paths[0], dpi=FIGURE_DPI)
            self.figure.savefig(paths[1], dpi=FIGURE_DPI, metadata={"Date": None})
        return paths


def plain_axes(axes: Axes) -> None:
    """Draw two faint axes, faint rules behind the data, few ticks."""
    axes.spines[["top", "right", "left"]].set_visible(False)
    axes.spines["bottom"].set_color(FAINT)
    axes.tick_params(colors=FAINT, labelsize=8, length=3, width=0.7)
    axes.tick_params(axis="y", which="both", length=0)
    axes.grid(axis="y", color=RULE, linewidth=0.6)
    axes.set_axisbelow(True)


def panel_heading(axes: Axes, words: str, *under: str, color: str = INK) -> None:
    """Write a panel's heading, and fainter lines under it, all above the panel."""
    lines = [(text, 5 + 10.5 * line, 7.5, "normal", FAINT) for line, text in enumerate(reversed(under))]
    for text, height, size, weight, hue in (*lines, (words, 6 + 10.5 * len(under), 10, "bold", color)):
        axes.annotate(
            figure_text(text), (0, 1), (0, height), xycoords="axes fraction", textcoords="offset points",
            annotation_clip=False, size=size, weight=weight, color=hue,
        )  # fmt: skip


def evaluation_axis(axes: Axes, end: int) -> None:
    """Make x count evaluations from 0."""
    axes.xaxis.set_major_locator(MaxNLocator(4, integer=True, steps=[1, 2, 5, 10]))
    axes.set_xlim(0, max(end, 1))
    axes.xaxis.set_major_formatter(FuncFormatter(lambda x, _: short_number(x)))
    axes.set_xlabel("evaluations", size=8, color=FAINT, labelpad=2)


def value_axis(axes: Axes, top: float, *, share: bool) -> None:
    """Make y a share or a count, from 0 up to little more than `top`."""
    axes.yaxis.set_major_locator(MaxNLocator(4, integer=not share, steps=[1, 2, 2.5, 5, 10]))
    axes.set_ylim(0, 1.06 * (top if top > 0 else 1.0))
    axes.yaxis.set_major_formatter(FuncFormatter(lambda y, _: f"{100 * y:g}\u202f%" if share else f"{y:,g}"))


def short_number(number: float) -> str:
    """Write a number of evaluations in little room: 500, 2k, 10M."""
    for unit, size in (("M", 1e6), ("k", 1e3)):
        if number >= size:
            return f"{number / size:g}{unit}"
    return f"{number:g}"
