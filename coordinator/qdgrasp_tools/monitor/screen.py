"""Parts of the screen of `qdgrasp-monitor`: counts and lists, as rich draws them.

A list takes the room that it is given, and counts what it leaves out. Columns without room are left out, the
least important first, and no line is broken.
"""

from collections import Counter
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from datetime import datetime
from typing import Any, NamedTuple

import numpy as np
from rich.cells import cell_len
from rich.console import Console, ConsoleOptions, Group, RenderResult
from rich.filesize import decimal
from rich.progress_bar import ProgressBar
from rich.rule import Rule
from rich.table import Table
from rich.text import Text

from qdgrasp_coordinator.metrics.job_status import JobStatus
from qdgrasp_protocol.text import count_text, counted, percent_text, printable, rate_text, span_text
from qdgrasp_tools.monitor.job_model import OVER, JobView

BETWEEN = " · "
STYLES = {
    "starting": "cyan", "running": "green", "paused": "yellow", "ending": "cyan",
    "silent": "bold yellow", "gone": "bold red", "ended": "dim", "cancelled": "dim",
    "idle": "dim", "stuck": "bold yellow", "leaving": "cyan",
    "job": "cyan", "run": "green", "warning": "yellow", "trouble": "bold yellow", "error": "bold red",
}  # fmt: skip
"""Styles of the states of jobs and workers, and of the kinds of events."""


def clock_text(at: datetime) -> str:
    """Return the local time of the day; a date outside the calendar's range stays in its zone."""
    with suppress(OverflowError):
        at = at.astimezone()
    return f"{at:%H:%M:%S}"


def text_line(words: str, style: str = "") -> Text:
    """Return words, maybe of others, as a line that is cut off where there is no room."""
    return Text(printable(words), style, no_wrap=True, overflow="ellipsis")


GAP = 2  # characters between columns


class Column(NamedTuple):
    """A column of a list."""

    title: str
    value: Callable[[Any], str]  # Gives the text of a row
    rank: int = 0  # Columns of a greater rank are left out first, those of rank 0 never
    least: int = 0  # The least width of a text, which is cut off; 0: a number, which is not


@dataclass(frozen=True)
class Listing:
    """Rows below the title of their list and those of the columns.

    A column without a title is left out where all of its texts are empty.
    """

    title: str
    columns: Sequence[Column]
    rows: Sequence[Any]
    style: Callable[[Any], str] = lambda _: ""

    def __rich_console__(self, _console: Console, options: ConsoleOptions) -> RenderResult:
        room = len(self.rows) if options.height is None else max(0, options.height - self.heads)
        shown = self.rows[:room]
        some = f": 1 to {len(shown)} of {len(self.rows)}"
        if self.title:
            yield rule(self.title + (some if 0 < len(shown) < len(self.rows) else ""))
        texts = {column: [printable(column.value(row)) for row in shown] for column in self.columns}
        table = Table(box=None, pad_edge=False, header_style="dim")
        for column, width in column_widths(texts, options.max_width).items():
            align: Any = "left" if column.least else "right"
            table.add_column(column.title, justify=align, no_wrap=True, width=width)
        kept = [texts[column] for column in column_widths(texts, options.max_width)]
        for number, row in enumerate(shown):
            table.add_row(*(Text(column[number]) for column in kept), style=self.style(row))
        yield table

    @property
    def heads(self) -> int:
        """Lines above the first row."""
        return 1 + bool(self.title)


def column_widths(texts: dict[Column, list[str]], width: int) -> dict[Column, int]:
    """Return the columns that fit, with their widths.

    Of those of the greatest rank the last one is left out first.
    """
    needed = {one: max(map(cell_len, [one.title, *found])) for one, found in texts.items()}
    kept = {one: min(wide, one.least or wide) for one, wide in needed.items() if one.title or wide}
    while (room := width - sum(kept.values()) - GAP * (len(kept) - 1)) < 0 and any(one.rank for one in kept):
        del kept[max(reversed(kept), key=lambda one: one.rank)]
    for one in kept:
        more = max(0, min(room, needed[one] - kept[one]))
        kept[one] += more
        room -= more
    return kept


def rule(title: str) -> Rule:
    """Return the title of a part of the screen."""
    return Rule(Text(title, "bold"), align="left", style="")


def job_list(views: Sequence[JobView]) -> Listing:
    """Return the jobs."""
    columns = (
        Column("job", lambda one: one.job, least=14),
        Column("state", lambda one: state_text(one), least=9),
        Column("runs", lambda one: _runs(one.figures), 5),
        Column("evaluations", lambda one: count_text(one.figures.evaluations), 4),
        Column("done", lambda one: percent_text(one.figures.done, 1.0)),
        Column("left", lambda one: time_left(one), 2),
        Column("eval/s", lambda one: rate_text(one.history.latest_rate), 3),
        Column("cells", lambda one: count_text(one.figures.cells), 6),
        Column("robust", lambda one: count_text(one.figures.robust), 7),
        Column("workers", lambda one: count_text(one.figures.workers), 8),
    )
    return Listing("", columns, views, lambda one: STYLES.get(one.state, ""))


def state_text(view: JobView) -> str:
    """Return the state of a job, with the time since its last message where that is long."""
    return f"{view.state} {span_text(view.silent)}" if view.state in ("silent", "gone") else view.state


def time_left(view: JobView) -> str:
    """Return the time that a job still takes."""
    seconds = None if view.state in OVER else view.figures.seconds_left
    return "-" if seconds is None else span_text(seconds)


def _runs(figures: JobStatus) -> str:
    failed = f"-{figures.runs_failed}" if figures.runs_failed else ""
    return f"{figures.runs_done}{failed}/{figures.runs}"


def run_list(view: JobView) -> Listing:
    """Return a job's runs: those in progress first, then the latest that ended."""
    columns = (
        Column("run", lambda run: run.run, least=20),
        Column("evaluations", lambda run: count_text(run.evaluations), 1),
        Column("done", lambda run: percent_text(run.done, 1.0)),
        Column("eval/s", lambda run: rate_text(run.rate), 5),
        Column("cells", lambda run: count_text(run.cells)),
        Column("contacts", lambda run: count_text(run.contact_niches), 2),
        Column("success", lambda run: percent_text(run.successes, run.evaluations), 4),
        Column("robust", lambda run: count_text(run.robust), 3),
        Column("errors", lambda run: count_text(run.errors), 6),
        Column("", lambda run: run.trouble or run.finished, 7, least=12),
    )
    runs = [run for run in view.runs if not run.finished] + [run for run in view.runs[::-1] if run.finished]
    title = f"runs of {view.job}"
    return Listing(title, columns, runs, lambda run: "bold yellow" if run.trouble else "")


def worker_list(view: JobView) -> Listing:
    """Return a job's workers, those that are in trouble first."""
    workers = view.workers
    columns = (
        Column("host", lambda one: one.host, least=12),
        Column("process", lambda one: str(one.pid), 6),
        Column("state", lambda one: one.state, least=7),
        Column("rows/s", lambda one: rate_text(one.rate)),
        Column("leases", lambda one: str(one.batches), 2),
        Column("seen", lambda one: span_text(one.seen + view.silent)),
        Column("memory", lambda one: decimal(one.memory, precision=0) if one.memory else "-", 1),
        Column("rows", lambda one: count_text(one.rows), 4),
        Column("restarts", lambda one: str(one.restarts), 5),
        Column("here for", lambda one: span_text(one.seconds), 7),
        Column("wid", lambda one: one.wid[:8], 3, least=8),
    )
    states = Counter(worker.state for worker in workers)
    hosts = counted(len({worker.host for worker in workers}), "host")
    counts = ", ".join(f"{n} {printable(state)}" for state, n in states.most_common())
    title = f"workers: {counts} on {hosts}" if counts else "workers: none has joined"
    return Listing(title, columns, workers, lambda one: STYLES.get(one.state, ""))


def event_list(view: JobView) -> Listing:
    """Return a job's events, the latest first."""
    columns = (
        Column("at", lambda one: clock_text(one.at), least=8),
        Column("what", lambda one: one.kind, least=8),
        Column("happened", lambda one: one.words, least=20),
    )
    title = f"events of {view.job}"
    return Listing(title, columns, view.events[::-1], lambda one: STYLES.get(one.kind, ""))


def job_summary(view: JobView) -> Group:
    """Return the progress of a job, its counts, what is in its way, and how evaluations end."""
    one = view.figures
    progress = Table.grid(padding=(0, 1), expand=True)
    progress.add_column(ratio=1)
    words = f"{percent_text(one.done, 1.0)}  {view.state if view.state in OVER else one.left}"
    bar = ProgressBar(total=1.0, completed=one.done, complete_style="green", finished_style="green")
    progress.add_row(bar, Text(words, "bold", no_wrap=True))
    budget = counted(one.budget, "evaluation", told=count_text)
    counts = (
        one.shapes if one.scenes else "",
        f"{one.runs_done} of {one.runs} runs" if one.runs > 1 else "",
        f"{count_text(one.evaluations)} of {budget}",
        f"{rate_text(view.history.latest_rate)}/s lately, {rate_text(one.rate)}/s so far",
    )
    successes = counted(one.successes, "success", "successes", count_text)
    finds = (
        f"{successes} ({percent_text(one.successes, one.evaluations)})",
        counted(one.cells, "cell", told=count_text),
        counted(one.contact_niches, "contact niche", told=count_text),
        f"{count_text(one.robust)} robust",
        counted(one.errors, "error", told=count_text),
        counted(one.trials, "trial", told=count_text) if one.trials else "",
    )
    is_bad = view.state in ("gone", "silent", "paused") or one.obstacle or not one.recorders
    style = "bold yellow" if is_bad and view.state not in ("ended", "cancelled") else "dim"
    lines = [text_line(BETWEEN.join(filter(None, parts))) for parts in (counts, finds)]
    return Group(progress, *lines, text_line(obstacle_text(view), style), OutcomeBar(one))


CONTINUE = "`qdgrasp resume DIR` or `campaign DIR` continues"


def obstacle_text(view: JobView) -> str:
    """Return the obstacle of a job and its remedy; without one, the recorder's state."""
    one = view.figures
    words = {
        "gone": f"its coordinator is gone since {span_text(view.silent)}: {CONTINUE}",
        "silent": f"nothing was heard of it for {span_text(view.silent)}: "
        "what is shown is what was heard last",
        "ended": "it has ended",
        "cancelled": f"it was ended before it was done: {CONTINUE}",
        "paused": f"paused until `qdgrasp continue {view.job}`",
    }
    if view.state in ("silent", *OVER):
        return words[view.state]
    if one.obstacle:
        return f"waits: {one.obstacle}"
    waiting = counted(one.waiting, "row", told=count_text)
    on_disk = f"{waiting} not on disk yet" if one.waiting else "all on disk"
    phrases = [
        words.get(view.state, one.doing),
        on_disk if one.recorders else "no recorder is there: rows wait for one",
        f"{counted(one.requeued, 'batch', 'batches', count_text)} given again" if one.requeued else "",
        f"{counted(one.strays, 'result', told=count_text)} dropped" if one.strays else "",
    ]
    return BETWEEN.join(filter(None, phrases))


OUTCOMES = {
    "dead end": ("·", "bright_black"), "overlap": ("░", "red"), "no contact": ("▒", "yellow"),
    "dropped": ("▓", "magenta"), "shaken": ("▚", "cyan"), "held": ("█", "green"),
}  # fmt: skip
"""Fillings and colours of the outcomes, from worst to best."""


class OutcomeBar(NamedTuple):
    """The outcomes of a job's evaluations as a bar and its legend."""

    figures: JobStatus

    def __rich_console__(self, _console: Console, options: ConsoleOptions) -> RenderResult:
        one = self.figures
        counts = (one.dead_ends, one.overlaps, one.simulated - one.successes,
                  one.successes - one.grasps, one.grasps - one.robust, one.robust)  # fmt: skip
        total = sum(counts) or 1
        bar, legend = text_line(""), text_line("")
        ends = np.cumsum([max(0, count) for count in counts]) * options.max_width // total
        starts = [0, *ends[:-1]]
        for (name, (fill, colour)), count, start, end in zip(
            OUTCOMES.items(), counts, starts, ends, strict=True
        ):
            bar.append(fill * int(end - start), colour)
            share = percent_text(max(0, count), total).replace(" ", "")
            legend.append(fill, colour).append(f"{name} {share}  ")
        yield bar
        yield legend
