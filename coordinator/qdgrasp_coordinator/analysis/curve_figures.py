"""Figures of curves: what methods reach over evaluations, all together, and prior by prior."""

from collections.abc import Mapping, Sequence

from matplotlib.axes import Axes
from matplotlib.lines import Line2D

from qdgrasp_coordinator.analysis.curves import COVERAGE, Curve
from qdgrasp_coordinator.analysis.entries import SceneName
from qdgrasp_coordinator.analysis.palette import (
    CONTEXT,
    FAMILIES,
    HUES,
    INK,
    ORDER,
    Arm,
    Dashes,
    Look,
    family_of,
    looks,
    prior_of,
    words_of,
)
from qdgrasp_coordinator.analysis.panels import Panel, measure_words, run_words
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
LABEL = 1.85
"""Width of a label of the legend [inches]."""
HOW = "Median over seeds; shaded: quartiles. Circle: an unfinished run ends; thin: of fewer seeds."


def draw_curves(shown: Sequence[Panel], *, log: bool = False) -> Sheet:
    """Every method on every scene: a row for each hand, or one scene after the other."""
    places = _places([panel.scene for panel in shown])
    rows, columns = (1 + max(place[axis] for place in places) for axis in (0, 1))
    drawn = _looks(shown)
    handles, across = _legend(drawn)
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
        for one in panel.curves:
            draw(axes, one, drawn[one.entry.arm])
    sheet.title(_what(shown), HOW)
    sheet.legend(handles, across)
    return sheet


def draw_matrix(shown: Sequence[Panel], *, log: bool = False) -> Sheet:
    """A row for each scene, a column for each prior; in it the searches with that prior."""
    drawn = _looks(shown)
    present = {prior_of(one.entry.method) for panel in shown for one in panel.curves}
    priors = [prior for prior in ORDER if prior in present]
    families = {family_of(one.entry.method) for panel in shown for one in panel.curves}
    sheet = Sheet(len(shown), len(priors), (2.5, 1.9), legend_rows=1, over=0.84, least=8.8)
    for row, panel in enumerate(shown):
        for column, prior in enumerate(priors):
            axes = sheet.axes(row, column)
            _dress(axes, panel, log)
            _draw_prior(axes, panel, prior, drawn)
            mine = [one.entry for one in panel.curves if prior_of(one.entry.method) == prior]
            words = (panel.scene.words, measure_words(panel)) if column == 0 else ("", "")
            heading(axes, words[0], words[1], run_words(mine, 2.5) if mine else "not in this campaign")
            if row == 0:
                above(axes, words_of(prior), 44, size=10.5, weight="bold", color=HUES[prior])
    sheet.title("Searches with each prior", f"{HOW} Grey: the other priors.")
    lines = [_line(family, INK, dashes) for family, dashes in FAMILIES.items() if family in families]
    sheet.legend(lines, len(lines))
    return sheet


def draw(axes: Axes, one: Curve, look: Look) -> None:
    """Draw a curve: thick where all its runs are in it, thin beyond."""
    if not one.runs.any():
        return
    colour, dashes, whole = look.colour, look.dashes, one.whole
    for part, width in ((slice(None, whole), 1.9), (slice(whole - 1, None), 0.8)):
        axes.plot(one.evaluations[part], one.median[part], color=colour, linestyle=dashes, linewidth=width)
    axes.fill_between(one.evaluations, one.low, one.high, color=colour, alpha=BAND, linewidth=0)
    for run in one.entry.runs:
        if run.evaluations and not run.complete:
            end = one.measure.of(run, run.evaluations)
            axes.plot([run.evaluations], [end], marker="o", markersize=4.5, markerfacecolor="white",
                      color=colour, clip_on=False, zorder=5)  # fmt: skip


def _draw_prior(axes: Axes, panel: Panel, prior: str, drawn: Mapping[Arm, Look]) -> None:
    for one in panel.curves:
        if prior_of(one.entry.method) == prior:
            draw(axes, one, drawn[one.entry.arm])
        else:
            axes.plot(one.evaluations, one.median, color=CONTEXT, linewidth=0.8, zorder=1)


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
    if len(hands) == 1 or len(objects) == 1 or len(scenes) < FILLED * len(hands) * len(objects):
        return [divmod(number, WRAPPED) for number in range(len(scenes))]
    return [(hands.index((scene.gripper, scene.protocol)), objects.index(scene.object)) for scene in scenes]


def _looks(shown: Sequence[Panel]) -> dict[Arm, Look]:
    return looks(one.entry.arm for panel in shown for one in panel.curves)


def _legend(drawn: Mapping[Arm, Look]) -> tuple[list[Line2D], int]:
    """Methods as a matrix: a column for each prior, in it the families in their order."""
    columns = [[arm for f in FAMILIES for arm in drawn if _is(arm, prior, f)] for prior in ORDER]
    filled = [column for column in columns if column]
    rows = max(map(len, filled))
    empty = _line("", "none", "-")
    handles = [
        _line(" ".join(column[row]).rstrip(), *drawn[column[row]]) if row < len(column) else empty
        for column in filled
        for row in range(rows)
    ]
    return handles, len(filled)


def _is(arm: Arm, prior: str, family: str) -> bool:
    return (prior_of(arm[0]), family_of(arm[0])) == (prior, family)


def _line(label: str, colour: str, dashes: Dashes) -> Line2D:
    return Line2D([], [], color=colour, linestyle=dashes, linewidth=1.9, label=label)
