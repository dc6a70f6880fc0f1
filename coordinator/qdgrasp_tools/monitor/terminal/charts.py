"""Charts of one job on a terminal: progress, outcomes and curves, in characters.

A curve has two by four dots to each character in braille, one mark to each in ASCII.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from rich.text import Text

from qdgrasp_coordinator.metrics.job_status import JobStatus
from qdgrasp_coordinator.metrics.run_stats import CurvePoint
from qdgrasp_protocol.text import counted
from qdgrasp_tools.monitor.job_model import OVER, JobView
from qdgrasp_tools.monitor.terminal.text_tables import (
    Glyphs,
    Lines,
    count_text,
    fit_text,
    percent_text,
    short_count,
    span_text,
    text_line,
)

BRAILLE = 0x2800
DOTS = np.array([(0x01, 0x08), (0x02, 0x10), (0x04, 0x20), (0x40, 0x80)])
"""Bits of the dots of a braille character: four lines of two."""


def plot_curve(
    places: Sequence[float], values: Sequence[float], width: int, height: int, most: float, glyphs: Glyphs
) -> list[str]:
    """Return a curve in `height` lines of `width` characters.

    Its points are given by their positions, in order, and values; the upper edge is the value `most`, the
    lower one 0. Each column is drawn from the value of the column before to its own, without gaps.
    """
    across, up = (2, 4) if glyphs.has_braille else (1, 1)
    rows = height * up
    samples = sample_curve(places, values, width * across)
    levels = [min(rows - 1, int(value / most * rows)) if most > 0 else 0 for value in samples]
    dots = np.zeros((rows, width * across), bool)
    for column, level in enumerate(levels):
        before = levels[column - 1] if column else level
        low, high = sorted((level, before + (level > before) - (level < before)))
        dots[rows - 1 - high : rows - low, column] = True
    if not glyphs.has_braille:
        return ["".join("*" if dot else " " for dot in line) for line in dots]
    bits = np.einsum("yixj,ij->yx", dots.reshape(height, 4, width, 2), DOTS)
    return ["".join(chr(BRAILLE + each) if each else " " for each in line) for line in bits.tolist()]


def sample_curve(places: Sequence[float], values: Sequence[float], columns: int) -> list[float]:
    """Return a curve's values at so many even positions, interpolated between its points."""
    if not places or places[0] == places[-1]:
        return list(values[-1:])
    found: list[float] = np.interp(np.linspace(places[0], places[-1], columns), places, values).tolist()
    return found


COLOURS = ("bright_black", "red", "yellow", "magenta", "cyan", "green")
"""Colours of the stages, in the order of their fillings."""
AXIS = 5  # characters of the numbers beside a curve


class CurveChart(NamedTuple):
    """A curve with its title; `first` and `last` are written below its ends."""

    title: str
    places: Sequence[float]
    values: Sequence[float]
    first: str
    last: str
    colour: str


def progress_line(view: JobView, width: int, glyphs: Glyphs) -> Text:
    """Return the progress of a job as a bar."""
    figures = view.figures
    words = f" {percent_text(figures.done, 1.0)}  {view.state if view.state in OVER else figures.left}"
    room = max(4, width - len(words))
    full = int(figures.done * room)
    bar = Text(glyphs.full * full, style="green", no_wrap=True)
    return bar.append(glyphs.empty * (room - full), style="dim").append(words, style="bold")


def count_lines(view: JobView, width: int, glyphs: Glyphs) -> Lines:
    """Return the counts of a job in two lines, and its obstacle or recorder in a third."""
    one = view.figures
    successes = counted(one.successes, "success", "successes", count_text)
    budget = counted(one.budget, "evaluation", told=count_text)
    runs = f"{one.runs_done} of {one.runs} runs{glyphs.between}" if one.runs > 1 else ""
    runs = f"{one.shapes}{glyphs.between}{runs}" if one.scenes else runs
    lines = [
        f"{runs}{count_text(one.evaluations)} of {budget}{glyphs.between}"
        f"{short_count(view.history.latest_rate)}/s lately, {short_count(one.rate)}/s so far",
        glyphs.between.join((
            f"{successes} ({percent_text(one.successes, one.evaluations)})",
            counted(one.cells, "cell", told=count_text),
            f"{count_text(one.robust)} robust",
            counted(one.errors, "error", told=count_text),
            *([counted(one.trials, "trial", told=count_text)] if one.trials else []),
        )),
    ]  # fmt: skip
    is_bad = view.state in ("gone", "silent", "paused") or one.obstacle or not one.recorders
    style = "bold yellow" if is_bad and view.state not in ("ended", "cancelled") else "dim"
    obstacle = text_line(obstacle_text(view, glyphs), width, glyphs, style)
    return [*(text_line(line, width, glyphs) for line in lines), obstacle]


def outcome_lines(view: JobView, width: int, glyphs: Glyphs) -> Lines:
    """Return the outcomes of evaluations as a bar and its legend."""
    counts = outcome_counts(view.figures)
    bar = Text(no_wrap=True)
    parts = zip(split_width(list(counts.values()), width), glyphs.stages, COLOURS, strict=True)
    for wide, fill, colour in parts:
        bar.append(fill * wide, style=colour)
    return [bar, _legend(counts, width, glyphs)]


def _legend(counts: dict[str, int], width: int, glyphs: Glyphs) -> Text:
    """Return names and shares of the parts of the bar, as widely spaced as the width allows."""
    total = sum(counts.values())
    for apart, gap in ((" ", "  "), (" ", " "), ("", " ")):
        legend = Text(gap, no_wrap=True).join(
            Text.assemble(
                (f"{fill}{apart}", colour), f"{name} {percent_text(number, total).replace(' ', apart)}"
            )
            for (name, number), fill, colour in zip(counts.items(), glyphs.stages, COLOURS, strict=True)
        )
        if legend.cell_len <= width:
            return legend
    legend.truncate(width)
    return legend


def outcome_counts(figures: JobStatus) -> dict[str, int]:
    """Return the numbers of a job's genomes by the stage that they reached, from worst to best."""
    numbers = {
        "dead end": figures.dead_ends,
        "overlap": figures.overlaps,
        "no contact": figures.simulated - figures.successes,
        "dropped": figures.successes - figures.grasps,
        "shaken": figures.grasps - figures.robust,
        "held": figures.robust,
    }
    return {name: max(0, number) for name, number in numbers.items()}


def split_width(numbers: Sequence[int], width: int) -> list[int]:
    """Split a width in proportion to numbers; a part above 0 gets at least 1, if that fits."""
    total = sum(numbers)
    if not total:
        return [0] * len(numbers)
    parts = [max(number > 0, width * number // total) for number in numbers]
    parts[parts.index(max(parts))] += width - sum(parts)
    return [max(0, wide) for wide in parts]


def curve_charts(view: JobView) -> list[CurveChart]:
    """Return the curves of a job: of a single run over evaluations, of several over time.

    Runs that are resumed one by one have fewer evaluations meanwhile, so several are drawn over time.
    """
    history = view.history
    ago = f"{span_text(history.at[-1] - history.at[0])} ago" if history.at else ""
    curve = view.curves.get(view.runs[-1].run) if view.runs and view.figures.runs == 1 else None
    if curve:
        begun = [CurvePoint(0, 0, 0, 0, 0), *curve.points]
        places: Sequence[float] = [point.evaluations for point in begun]
        cells, successes = [point.cells for point in begun], [point.successes for point in begun]
        ends = ("0", f"{count_text(places[-1])} evaluations")
    else:
        places, cells, successes, ends = history.at, history.cells, history.successes, (ago, "now")
    return [
        CurveChart("cells", places, cells, *ends, "green"),
        CurveChart("successes", places, successes, *ends, "cyan"),
        CurveChart("evaluations/s", history.at, history.rate, ago, "now", "yellow"),
    ]


def curve_lines(view: JobView, width: int, height: int, glyphs: Glyphs) -> Lines:
    """Return the curves side by side, in so many lines."""
    shown = curve_charts(view)
    wide = (width - 2 * (len(shown) - 1)) // len(shown)
    pictures = [_chart_lines(one, wide, height, glyphs) for one in shown]
    return [Text("  ", no_wrap=True).join(line) for line in zip(*pictures, strict=True)]


def _chart_lines(one: CurveChart, width: int, height: int, glyphs: Glyphs) -> Lines:
    """Return a title with the newest value, the curve with its scale, and its ends if tall."""
    most = max(one.values, default=0)
    has_feet = height >= 6  # lines
    room, rows = width - AXIS - 1, max(1, height - 1 - has_feet)
    newest = short_count(one.values[-1]) if len(one.values) else "-"
    lines = [Text(fit_text(f"{' ' * (AXIS + 1)}{one.title} {newest}", width, glyphs), style="bold")]
    for number, line in enumerate(plot_curve(one.places, one.values, room, rows, most, glyphs)):
        scale = short_count(most) if number == 0 else "0" if number == rows - 1 else ""
        axis = Text(f"{fit_text(scale, AXIS, glyphs, 'right')} ", style="dim")
        lines.append(axis.append(fit_text(line, room, glyphs), style=one.colour))
    if has_feet:
        gap = max(1, room - len(one.first) - len(one.last))
        foot = fit_text(f"{' ' * (AXIS + 1)}{one.first}{' ' * gap}{one.last}", width, glyphs)
        lines.append(Text(foot, style="dim"))
    return lines


GO_ON = "`qdgrasp resume DIR` or `campaign DIR` goes on"


def obstacle_text(view: JobView, glyphs: Glyphs) -> str:
    """Return the obstacle of a job and its remedy; without one, the recorder's state."""
    one = view.figures
    words = {
        "gone": f"its coordinator is gone since {span_text(view.silent)}: {GO_ON}",
        "silent": f"nothing was heard of it for {span_text(view.silent)}: "
        "what is shown is what was heard last",
        "ended": "it has ended",
        "cancelled": f"it was ended before it was done: {GO_ON}",
        "paused": f"paused until `qdgrasp continue {view.job}`",
    }
    if view.state in ("silent", *OVER):
        return words[view.state]
    if one.obstacle:
        return f"waits: {glyphs.text(one.obstacle)}"
    waiting = counted(one.waiting, "row", told=count_text)
    on_disk = f"{waiting} not on disk yet" if one.waiting else "all on disk"
    phrases = [
        words.get(view.state, glyphs.text(one.doing)),
        on_disk if one.recorders else "no recorder is there: rows wait for one",
        f"{counted(one.requeued, 'batch', 'batches', count_text)} given again" if one.requeued else "",
        f"{counted(one.strays, 'result', told=count_text)} dropped" if one.strays else "",
    ]
    return glyphs.between.join(filter(None, phrases))
