"""Figures of curves: what methods reach over evaluations, all together, and prior by prior."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D

from qdgrasp_coordinator.analysis.curves import COVERAGE, Curve, Measure, curve, measure_of
from qdgrasp_coordinator.analysis.entries import Entry, SceneName
from qdgrasp_coordinator.analysis.palette import (
    CONTEXT,
    FAMILIES,
    HUES,
    INK,
    ORDER,
    dashes_of,
    family_of,
    hue_of,
    prior_of,
    words_of,
)  # fmt: skip
from qdgrasp_coordinator.analysis.sheet import Sheet, above, count_evaluations, count_up, heading, plain

BAND = 0.13
"""Opacity of an interquartile range."""
WRAPPED = 4
"""Panels side by side that follow one another."""
FILLED = 0.6
"""The share of hands and objects that must have a panel for these to be rows and columns."""
PANELS = {1: (5.6, 3.3), 2: (4.2, 2.7)}
"""Size of a panel by how many stand side by side [inches]."""
PANEL = (3.1, 2.1)
LETTERS = 17
"""Of a panel's heading, in an inch."""
LABEL = 1.85
"""Width of a label of the legend [inches]."""
HOW = "Median over seeds; shaded: quartiles. Circle: an unfinished run ends; thin: of fewer seeds."


@dataclass(frozen=True)
class Panel:
    """The curves on one scene."""

    scene: SceneName
    measure: Measure
    curves: tuple[Curve, ...]

    @property
    def end(self) -> int:
        """Evaluations of the longest curve."""
        return max(int(one.evaluations[-1]) for one in self.curves)

    @property
    def top(self) -> float:
        """The greatest third quartile."""
        return max(float(np.nanmax(one.high, initial=0.0)) for one in self.curves)


def panels(entries: Sequence[Entry]) -> list[Panel]:
    """The curves of all entries, scene by scene."""
    scenes: dict[SceneName, list[Entry]] = {}
    for entry in entries:
        scenes.setdefault(entry.scene, []).append(entry)
    found = []
    for scene, here in scenes.items():
        measure = measure_of(here)
        found.append(Panel(scene, measure, tuple(curve(entry, measure) for entry in here)))
    return found


def draw_curves(shown: Sequence[Panel], *, log: bool = False) -> Sheet:
    """Every method on every scene: a row for each hand, or one scene after the other."""
    places = _places([panel.scene for panel in shown])
    rows, columns = (1 + max(place[axis] for place in places) for axis in (0, 1))
    methods = list(dict.fromkeys(one.entry.method for panel in shown for one in panel.curves))
    handles, across = _legend(methods)
    size = PANELS.get(columns, PANEL)
    sheet = Sheet(rows, columns, size, legend_rows=len(handles) // across, least=0.4 + LABEL * across)
    for panel, (row, column) in zip(shown, places, strict=True):
        axes = sheet.axes(row, column)
        _dress(axes, panel, log)
        heading(
            axes,
            panel.scene.words,
            measure_words(panel),
            run_words([one.entry for one in panel.curves], size[0]),
        )
        for one, variant in _numbered(panel.curves):
            draw(axes, one, hue_of(one.entry.method, variant))
    sheet.title(_what(shown), HOW)
    sheet.legend(handles, across)
    return sheet


def draw_matrix(shown: Sequence[Panel], *, log: bool = False) -> Sheet:
    """A row for each scene, a column for each prior; in it the searches with that prior."""
    present = {prior_of(one.entry.method) for panel in shown for one in panel.curves}
    priors = [prior for prior in (*ORDER[-1:], *ORDER[:-1]) if prior in present]
    families = {family_of(one.entry.method) for panel in shown for one in panel.curves}
    sheet = Sheet(len(shown), len(priors), (2.5, 1.9), legend_rows=1, over=0.84)
    for row, panel in enumerate(shown):
        for column, prior in enumerate(priors):
            axes = sheet.axes(row, column)
            _dress(axes, panel, log)
            _draw_prior(axes, panel, prior)
            mine = [one.entry for one in panel.curves if prior_of(one.entry.method) == prior]
            words = (panel.scene.words, measure_words(panel)) if column == 0 else ("", "")
            heading(axes, words[0], words[1], run_words(mine, 2.5) if mine else "not in this campaign")
            if row == 0:
                above(axes, words_of(prior), 44, size=10.5, weight="bold", color=HUES[prior])
    sheet.title("Searches with each prior", f"{HOW} Grey: the other priors.")
    lines = [_line(family, INK, dashes) for family, dashes in FAMILIES.items() if family in families]
    sheet.legend(lines, len(lines))
    return sheet


def draw(axes: Axes, one: Curve, colour: str, *, band: bool = True) -> None:
    """Draw a curve: thick where all its runs are in it, thin beyond."""
    whole, dashes = one.whole, dashes_of(one.entry.method)
    if not one.runs.any():
        return
    axes.plot(one.evaluations[:whole], one.median[:whole], color=colour, linestyle=dashes, linewidth=1.9)
    axes.plot(
        one.evaluations[whole - 1 :], one.median[whole - 1 :], color=colour, linestyle=dashes, linewidth=0.8
    )
    if band:
        axes.fill_between(one.evaluations, one.low, one.high, color=colour, alpha=BAND, linewidth=0)
    for run in one.entry.runs:
        if run.evaluations and not run.complete:
            end = one.measure.of(run, run.evaluations)
            axes.plot([run.evaluations], [end], marker="o", markersize=4.5, markerfacecolor="white",
                      color=colour, clip_on=False, zorder=5)  # fmt: skip


def _draw_prior(axes: Axes, panel: Panel, prior: str) -> None:
    for one, variant in _numbered(panel.curves):
        if prior_of(one.entry.method) == prior:
            draw(axes, one, hue_of(one.entry.method, variant))
        else:
            axes.plot(one.evaluations, one.median, color=CONTEXT, linewidth=0.8, zorder=1)


def measure_words(panel: Panel) -> str:
    """What is measured on a scene, and how far it can be compared."""
    target = panel.curves[0].entry.target
    if panel.measure is COVERAGE:
        return f"{panel.measure.words}{', on a stand-in for the scan' if target.stand_in else ''}"
    return f"{panel.measure.words}: {target.why or 'not all runs have an S_G'}"


def run_words(entries: Sequence[Entry], room: float) -> str:
    """How many seeds of how many evaluations there are, in `room` inches: which methods have others."""
    kinds: dict[str, list[str]] = {}
    for entry in entries:
        kinds.setdefault(_runs([entry]), []).append(entry.name)
    usual, *others = sorted(kinds, key=lambda kind: -len(kinds[kind]))
    words = "; ".join([usual, *(f"{', '.join(kinds[kind])}: {kind}" for kind in others)])
    return words if len(words) <= LETTERS * room else _runs(entries)


def _runs(entries: Sequence[Entry]) -> str:
    seeds = _span([len(entry.runs) for entry in entries])
    ends = _span([run.evaluations for entry in entries for run in entry.runs])
    unfinished = sum(entry.unfinished for entry in entries)
    mark = f", {unfinished} unfinished" if unfinished else ""
    return f"{seeds} seed{'' if seeds == '1' else 's'} \u00d7 {ends} evaluations{mark}"


def _span(numbers: Sequence[int]) -> str:
    low, high = min(numbers), max(numbers)
    return f"{low:,}" if low == high else f"{low:,}\u2013{high:,}"


def _dress(axes: Axes, panel: Panel, log: bool) -> None:
    plain(axes)
    count_evaluations(axes, panel.end, log=log)
    count_up(axes, panel.top, share=panel.measure is COVERAGE, log=log)


def _what(shown: Sequence[Panel]) -> str:
    covered = [panel.measure is COVERAGE for panel in shown]
    if all(covered):
        return "Coverage of S_G over evaluations"
    return f"{'Coverage of S_G, or success cells,' if any(covered) else 'Success cells'} over evaluations"


def _places(scenes: Sequence[SceneName]) -> list[tuple[int, int]]:
    """Row and column of each scene's panel: its hand's and its object's, unless that leaves many holes."""
    hands = list(dict.fromkeys((scene.gripper, scene.protocol) for scene in scenes))
    objects = sorted({scene.object for scene in scenes})
    if len(hands) == 1 or len(scenes) < FILLED * len(hands) * len(objects):
        return [divmod(number, WRAPPED) for number in range(len(scenes))]
    return [(hands.index((scene.gripper, scene.protocol)), objects.index(scene.object)) for scene in scenes]


def _numbered(curves: Sequence[Curve]) -> list[tuple[Curve, int]]:
    """Each curve with its number among the variants of its method."""
    methods = [one.entry.method for one in curves]
    return [(one, methods[:place].count(one.entry.method)) for place, one in enumerate(curves)]


def _legend(methods: Sequence[str]) -> tuple[list[Line2D], int]:
    """Methods as a matrix: a column for each prior, in it the families in their order."""
    columns = [
        [m for f in FAMILIES for m in methods if prior_of(m) == p and family_of(m) == f] for p in ORDER
    ]
    filled = [column for column in columns if column]
    rows = max(map(len, filled))
    empty = _line("", "none", "-")
    handles = [
        _line(column[row], hue_of(column[row]), dashes_of(column[row])) if row < len(column) else empty
        for column in filled
        for row in range(rows)
    ]
    return handles, len(filled)


def _line(label: str, colour: str, dashes: object) -> Line2D:
    return Line2D([], [], color=colour, linestyle=dashes, linewidth=1.9, label=label)  # type: ignore[arg-type]
