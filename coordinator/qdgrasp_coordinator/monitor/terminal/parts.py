"""The parts of what is shown of one job: how far it is, what it found, where evaluations end, its curves."""

from collections.abc import Sequence
from typing import NamedTuple

from rich.text import Text

from qdgrasp_coordinator.counts.curve import Point
from qdgrasp_coordinator.counts.figures import JobFigures
from qdgrasp_coordinator.monitor.terminal.glyphs import Glyphs
from qdgrasp_coordinator.monitor.terminal.lists import latest
from qdgrasp_coordinator.monitor.terminal.plot import plot
from qdgrasp_coordinator.monitor.terminal.table import Lines, fit
from qdgrasp_coordinator.monitor.terminal.words import count, part, short, span
from qdgrasp_coordinator.monitor.view import OVER, JobView
from qdgrasp_protocol.phrases import counted

COLOURS = ("bright_black", "red", "yellow", "magenta", "cyan", "green")
"""Of the stages, beside what fills them."""
AXIS = 5  # characters that the numbers beside a curve take


class Drawing(NamedTuple):
    """A curve that is to be drawn."""

    title: str
    places: Sequence[float]
    values: Sequence[float]
    first: str
    """What stands below its beginning."""
    last: str
    colour: str


def progress(view: JobView, width: int, glyphs: Glyphs) -> Text:
    """How far the job is, as a bar."""
    figures = view.figures
    words = f" {part(figures.done, 1.0)}  {view.state if view.state in OVER else figures.left}"
    room = max(4, width - len(words))
    full = int(figures.done * room)
    bar = Text(glyphs.full * full, style="green", no_wrap=True)
    return bar.append(glyphs.empty * (room - full), style="dim").append(words, style="bold")


def found(view: JobView, width: int, glyphs: Glyphs) -> Lines:
    """What was evaluated and found, in two lines, and what is in the way, in a third."""
    one = view.figures
    successes = counted(one.successes, "success", "successes", count)
    runs = f"{one.runs_done} of {one.runs} runs{glyphs.between}" if one.runs > 1 else ""
    lines = [
        f"{runs}{count(one.evaluations)} of {counted(one.budget, 'evaluation', told=count)}{glyphs.between}"
        f"{short(latest(view.history))}/s lately, {short(one.rate)}/s so far",
        glyphs.between.join((
            f"{successes} ({part(one.successes, one.evaluations)})",
            counted(one.cells, "cell", told=count),
            f"{count(one.robust)} robust",
            counted(one.errors, "error", told=count),
            *([counted(one.trials, "trial", told=count)] if one.trials else []),
        )),
    ]  # fmt: skip
    told = [Text(fit(line, width, glyphs).rstrip()) for line in lines]
    return [*told, Text(fit(*_hindrance(view, width, glyphs)).rstrip(), style=_hindrance_style(view))]


def stages(view: JobView, width: int, glyphs: Glyphs) -> Lines:
    """Where evaluations end: a bar, and what its parts mean."""
    shares = [(name, number) for name, number in ends(view.figures).items()]
    total = sum(number for _, number in shares)
    bar = Text(no_wrap=True)
    for wide, fill, colour in zip(
        parted([number for _, number in shares], width), glyphs.stages, COLOURS, strict=True
    ):
        bar.append(fill * wide, style=colour)
    return [bar, _legend(shares, total, width, glyphs)]


def _legend(shares: Sequence[tuple[str, int]], total: int, width: int, glyphs: Glyphs) -> Text:
    """What the parts of the bar mean, as widely spaced as there is room for."""
    for apart, gap in ((" ", "  "), (" ", " "), ("", " ")):
        legend = Text(gap, no_wrap=True).join(
            Text.assemble((f"{fill}{apart}", colour), f"{name} {part(number, total).replace(' ', apart)}")
            for (name, number), fill, colour in zip(shares, glyphs.stages, COLOURS, strict=True)
        )
        if legend.cell_len <= width:
            return legend
    legend.truncate(width)
    return legend


def ends(figures: JobFigures) -> dict[str, int]:
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


def parted(numbers: Sequence[int], width: int) -> list[int]:
    """A width in parts that are as the numbers; whatever is not nothing has one at least, if that fits."""
    total = sum(numbers)
    if not total:
        return [0] * len(numbers)
    parts = [max(number > 0, width * number // total) for number in numbers]
    parts[parts.index(max(parts))] += width - sum(parts)
    return [max(0, wide) for wide in parts]


def drawings(view: JobView) -> list[Drawing]:
    """The curves of a job: of its one run from the beginning on, of many since somebody watches.

    Runs that are opened again one by one have fewer evaluations meanwhile: many are drawn over time.
    """
    history = view.history
    ago = f"{span(history.at[-1] - history.at[0])} ago" if history.at else ""
    curve = view.curves.get(view.runs[-1].run) if view.runs and view.figures.runs == 1 else None
    if curve:
        begun = [Point(0, 0, 0, 0, 0), *curve.points]
        places: Sequence[float] = [point.evaluations for point in begun]
        cells, successes = [point.cells for point in begun], [point.successes for point in begun]
        ends = ("0", f"{count(places[-1])} evaluations")
    else:
        places, cells, successes, ends = history.at, history.cells, history.successes, (ago, "now")
    return [
        Drawing("cells", places, cells, *ends, "green"),
        Drawing("successes", places, successes, *ends, "cyan"),
        Drawing("evaluations/s", history.at, history.rate, ago, "now", "yellow"),
    ]


def curves(view: JobView, width: int, height: int, glyphs: Glyphs) -> Lines:
    """The curves side by side, in so many lines."""
    shown = drawings(view)
    wide = (width - 2 * (len(shown) - 1)) // len(shown)
    pictures = [_picture(one, wide, height, glyphs) for one in shown]
    return [Text("  ", no_wrap=True).join(line) for line in zip(*pictures, strict=True)]


def _picture(one: Drawing, width: int, height: int, glyphs: Glyphs) -> Lines:
    """A title with the newest value, the curve with its scale, and from where to where it goes."""
    most = max(one.values, default=0)
    has_feet = height >= 6  # lines
    room, rows = width - AXIS - 1, max(1, height - 1 - has_feet)
    newest = short(one.values[-1]) if len(one.values) else "-"
    lines = [Text(fit(f"{' ' * (AXIS + 1)}{one.title} {newest}", width, glyphs), style="bold")]
    for number, line in enumerate(plot(one.places, one.values, room, rows, most, glyphs)):
        scale = short(most) if number == 0 else "0" if number == rows - 1 else ""
        axis = Text(f"{fit(scale, AXIS, glyphs, 'right')} ", style="dim")
        lines.append(axis.append(fit(line, room, glyphs), style=one.colour))
    if has_feet:
        gap = max(1, room - len(one.first) - len(one.last))
        foot = fit(f"{' ' * (AXIS + 1)}{one.first}{' ' * gap}{one.last}", width, glyphs)
        lines.append(Text(foot, style="dim"))
    return lines


def _hindrance(view: JobView, width: int, glyphs: Glyphs) -> tuple[str, int, Glyphs]:
    return hindrance(view, glyphs), width, glyphs


def hindrance(view: JobView, glyphs: Glyphs) -> str:
    """What keeps a job from going on and what to do; where nothing does, how far the recorder is."""
    one = view.figures
    words = {
        "gone": f"its coordinator is gone since {span(view.silent)}: `qdgrasp resume DIR` goes on",
        "silent": f"nothing was heard of it for {span(view.silent)}: what is shown is what was heard last",
        "ended": "it has ended",
        "cancelled": "it was ended before it was done: `qdgrasp resume DIR` goes on",
        "paused": f"paused until `qdgrasp continue {view.job}`",
    }
    if view.state in ("silent", *OVER):
        return words[view.state]
    if one.obstacle:
        return f"waits: {glyphs.text(one.obstacle)}"
    recorder = f"{counted(one.waiting, 'row', told=count)} not on disk yet" if one.waiting else "all on disk"
    told = [
        words.get(view.state, ""),
        recorder if one.recorders else "no recorder is there: rows wait for one",
    ]
    told += [f"{counted(one.requeued, 'batch', 'batches', count)} given again"] if one.requeued else []
    told += [f"{counted(one.strays, 'result', told=count)} dropped"] if one.strays else []
    return glyphs.between.join(filter(None, told))


def _hindrance_style(view: JobView) -> str:
    is_bad = view.state in ("gone", "silent", "paused") or view.figures.obstacle or not view.figures.recorders
    return "bold yellow" if is_bad and view.state not in ("ended", "cancelled") else "dim"
