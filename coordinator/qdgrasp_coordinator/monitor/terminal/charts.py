"""Charts of one job on a terminal: progress, outcomes and curves, in characters.

A curve has two by four dots to each character in braille, one mark to each in ASCII.
"""

from bisect import bisect_right
from collections.abc import Sequence
from typing import NamedTuple

from rich.text import Text

from qdgrasp_coordinator.metrics.job_status import JobStatus
from qdgrasp_coordinator.metrics.run_stats import CurvePoint
from qdgrasp_coordinator.monitor.job_view import OVER, JobView
from qdgrasp_coordinator.monitor.terminal.text_tables import (
    Glyphs,
    Lines,
    count_text,
    current_speed,
    fit_text,
    percent_text,
    short_count,
    span_text,
)
from qdgrasp_protocol.text import counted

BRAILLE = 0x2800
DOTS = ((0x01, 0x08), (0x02, 0x10), (0x04, 0x20), (0x40, 0x80))
"""The bits of the dots of a braille character: four lines of two."""


def plot_curve(
    places: Sequence[float], values: Sequence[float], width: int, height: int, most: float, glyphs: Glyphs
) -> list[str]:
    """A curve in `height` lines of `width` characters.

    Parameters
    ----------
    places, values
        Its points, in order of their places.
    most
        The value at the upper edge; the lower one is 0.
    """
    across, up = (2, 4) if glyphs.has_braille else (1, 1)
    columns = sample_curve(places, values, width * across)
    levels = [min(height * up - 1, int(value / most * height * up)) if most > 0 else 0 for value in columns]
    dots: set[tuple[int, int]] = set()
    for column, level in enumerate(levels):
        before = levels[column - 1] if column else level
        low, high = sorted((level, before + (level > before) - (level < before)))
        dots |= {(column, height * up - 1 - at) for at in range(low, high + 1)}
    if not glyphs.has_braille:
        return ["".join("*" if (x, y) in dots else " " for x in range(width)) for y in range(height)]
    return ["".join(_braille(dots, 2 * x, 4 * y) for x in range(width)) for y in range(height)]


def sample_curve(places: Sequence[float], values: Sequence[float], columns: int) -> list[float]:
    """The values of a curve at so many even places, on straight lines between its points."""
    if not places:
        return []
    if len(places) == 1 or places[0] == places[-1]:
        return [values[-1]]
    first, wide = places[0], places[-1] - places[0]
    return [
        _interpolated(places, values, first + wide * column / max(1, columns - 1))
        for column in range(columns)
    ]


def _interpolated(places: Sequence[float], values: Sequence[float], place: float) -> float:
    after = min(len(places) - 1, max(1, bisect_right(places, place)))
    wide = places[after] - places[after - 1]
    share = min(1.0, (place - places[after - 1]) / wide) if wide > 0 else 1.0
    return values[after - 1] + share * (values[after] - values[after - 1])


def _braille(dots: set[tuple[int, int]], left: int, top: int) -> str:
    bits = sum(DOTS[y][x] for y in range(4) for x in range(2) if (left + x, top + y) in dots)
    return chr(BRAILLE + bits) if bits else " "


COLOURS = ("bright_black", "red", "yellow", "magenta", "cyan", "green")
"""Of the stages, beside what fills them."""
AXIS = 5  # characters that the numbers beside a curve take


class CurveChart(NamedTuple):
    """A curve that is to be drawn."""

    title: str
    places: Sequence[float]
    values: Sequence[float]
    first: str
    """What stands below its beginning."""
    last: str
    colour: str


def progress_line(view: JobView, width: int, glyphs: Glyphs) -> Text:
    """How far the job is, as a bar."""
    figures = view.figures
    words = f" {percent_text(figures.done, 1.0)}  {view.state if view.state in OVER else figures.left}"
    room = max(4, width - len(words))
    full = int(figures.done * room)
    bar = Text(glyphs.full * full, style="green", no_wrap=True)
    return bar.append(glyphs.empty * (room - full), style="dim").append(words, style="bold")


def count_lines(view: JobView, width: int, glyphs: Glyphs) -> Lines:
    """What was evaluated and found, in two lines, and what is in the way, in a third."""
    one = view.figures
    successes = counted(one.successes, "success", "successes", count_text)
    runs = f"{one.runs_done} of {one.runs} runs{glyphs.between}" if one.runs > 1 else ""
    lines = [
        f"{runs}{count_text(one.evaluations)} of "
        f"{counted(one.budget, 'evaluation', told=count_text)}{glyphs.between}"
        f"{short_count(current_speed(view.history))}/s lately, {short_count(one.rate)}/s so far",
        glyphs.between.join((
            f"{successes} ({percent_text(one.successes, one.evaluations)})",
            counted(one.cells, "cell", told=count_text),
            f"{count_text(one.robust)} robust",
            counted(one.errors, "error", told=count_text),
            *([counted(one.trials, "trial", told=count_text)] if one.trials else []),
        )),
    ]  # fmt: skip
    told = [Text(fit_text(line, width, glyphs).rstrip()) for line in lines]
    return [
        *told,
        Text(fit_text(*_obstacle_cells(view, width, glyphs)).rstrip(), style=_obstacle_style(view)),
    ]


def outcome_lines(view: JobView, width: int, glyphs: Glyphs) -> Lines:
    """Where evaluations end: a bar, and what its parts mean."""
    shares = [(name, number) for name, number in outcome_counts(view.figures).items()]
    total = sum(number for _, number in shares)
    bar = Text(no_wrap=True)
    for wide, fill, colour in zip(
        split_width([number for _, number in shares], width), glyphs.stages, COLOURS, strict=True
    ):
        bar.append(fill * wide, style=colour)
    return [bar, _legend(shares, total, width, glyphs)]


def _legend(shares: Sequence[tuple[str, int]], total: int, width: int, glyphs: Glyphs) -> Text:
    """What the parts of the bar mean, as widely spaced as there is room for."""
    for apart, gap in ((" ", "  "), (" ", " "), ("", " ")):
        legend = Text(gap, no_wrap=True).join(
            Text.assemble(
                (f"{fill}{apart}", colour), f"{name} {percent_text(number, total).replace(' ', apart)}"
            )
            for (name, number), fill, colour in zip(shares, glyphs.stages, COLOURS, strict=True)
        )
        if legend.cell_len <= width:
            return legend
    legend.truncate(width)
    return legend


def outcome_counts(figures: JobStatus) -> dict[str, int]:
    """How many of a job's genomes got how far, from worst to best."""
    numbers = {
        "no pose": figures.dead_ends,
        "overlap": figures.overlaps,
        "no contact": figures.simulated - figures.successes,
        "dropped": figures.successes - figures.grasps,
        "shaken": figures.grasps - figures.robust,
        "held": figures.robust,
    }
    return {name: max(0, number) for name, number in numbers.items()}


def split_width(numbers: Sequence[int], width: int) -> list[int]:
    """A width in parts that are as the numbers; whatever is not nothing has one at least, if that fits."""
    total = sum(numbers)
    if not total:
        return [0] * len(numbers)
    parts = [max(number > 0, width * number // total) for number in numbers]
    parts[parts.index(max(parts))] += width - sum(parts)
    return [max(0, wide) for wide in parts]


def curve_charts(view: JobView) -> list[CurveChart]:
    """The curves of a job: of its one run from the beginning on, of many since somebody watches.

    Runs that are opened again one by one have fewer evaluations meanwhile: many are drawn over time.
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
    """The curves side by side, in so many lines."""
    shown = curve_charts(view)
    wide = (width - 2 * (len(shown) - 1)) // len(shown)
    pictures = [_chart_lines(one, wide, height, glyphs) for one in shown]
    return [Text("  ", no_wrap=True).join(line) for line in zip(*pictures, strict=True)]


def _chart_lines(one: CurveChart, width: int, height: int, glyphs: Glyphs) -> Lines:
    """A title with the newest value, the curve with its scale, and from where to where it goes."""
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


def _obstacle_cells(view: JobView, width: int, glyphs: Glyphs) -> tuple[str, int, Glyphs]:
    return obstacle_text(view, glyphs), width, glyphs


def obstacle_text(view: JobView, glyphs: Glyphs) -> str:
    """What keeps a job from going on and what to do; where nothing does, how far the recorder is."""
    one = view.figures
    words = {
        "gone": f"its coordinator is gone since {span_text(view.silent)}: `qdgrasp resume DIR` goes on",
        "silent": f"nothing was heard of it for {span_text(view.silent)}: what is shown is "
        "what was heard last",
        "ended": "it has ended",
        "cancelled": "it was ended before it was done: `qdgrasp resume DIR` goes on",
        "paused": f"paused until `qdgrasp continue {view.job}`",
    }
    if view.state in ("silent", *OVER):
        return words[view.state]
    if one.obstacle:
        return f"waits: {glyphs.text(one.obstacle)}"
    recorder = (
        f"{counted(one.waiting, 'row', told=count_text)} not on disk yet" if one.waiting else "all on disk"
    )
    told = [
        words.get(view.state, ""),
        recorder if one.recorders else "no recorder is there: rows wait for one",
    ]
    told += [f"{counted(one.requeued, 'batch', 'batches', count_text)} given again"] if one.requeued else []
    told += [f"{counted(one.strays, 'result', told=count_text)} dropped"] if one.strays else []
    return glyphs.between.join(filter(None, told))


def _obstacle_style(view: JobView) -> str:
    is_bad = view.state in ("gone", "silent", "paused") or view.figures.obstacle or not view.figures.recorders
    return "bold yellow" if is_bad and view.state not in ("ended", "cancelled") else "dim"
