"""Tables on a terminal: jobs, the runs and workers of one, and its events.

Columns without room are left out, the least important first, and no line is broken. Bars, rules and curves
are drawn with blocks and braille, or with ASCII where there is nothing else.
"""

import os
from collections import Counter
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from datetime import datetime
from typing import Generic, Literal, TypeVar

from rich.cells import cell_len, set_cell_size
from rich.console import Console
from rich.style import Style
from rich.text import Text

from qdgrasp_coordinator.metrics.job_status import JobEvent, ObjectListing, RunStatus, WorkerStatus
from qdgrasp_protocol.text import counted, printable
from qdgrasp_tools.monitor.job_model import OVER, JobView


@dataclass(frozen=True)
class Glyphs:
    """Characters for bars, rules and curves."""

    full: str  # The part of a progress bar that is done
    empty: str  # The part that is not
    rule: str
    between: str  # Separator of phrases in a line
    chosen: str  # Mark of the selected job
    more: str  # Mark of words that are cut off
    stages: str  # Fillings of the parts of a bar, from left to right
    has_braille: bool

    def text(self, words: str) -> str:
        """Return words from messages so that the terminal can print them."""
        shown = printable(words)
        return shown if self.has_braille else shown.encode("ascii", "backslashreplace").decode()


UNICODE = Glyphs("█", "░", "─", " · ", "▸", "…", "·░▒▓▚█", has_braille=True)
ASCII = Glyphs("#", ".", "-", " | ", ">", "~", ".:-=+#", has_braille=False)


def glyphs_of(console: Console, *, ascii_only: bool = False) -> Glyphs:
    """Return the glyphs that a terminal can show; Linux's own console has no braille."""
    has_all = console.encoding.lower().startswith("utf") and os.environ.get("TERM") != "linux"
    return UNICODE if has_all and not ascii_only else ASCII


MAX_SECONDS = 99_999 * 86_400.0  # seconds; longer times are shown as this
SIZES = ("", "k", "M", "G", "T")


def count_text(number: float) -> str:
    """Return a count with its thousands apart: 41 200."""
    return f"{round(number):,}".replace(",", " ")


def short_count(number: float) -> str:
    """Return a count in at most five characters: 0.8, 950, 41.2k, 1.2M."""
    if number < 9_999.5:
        return f"{number:.0f}" if number >= 10 or number == int(number) else f"{number:.1f}"
    number, size = _scaled(number)
    return f"{number:.1f}{SIZES[size]}" if number < 99.95 else f"{number:.0f}{SIZES[size]}"


def percent_text(some: float, total: float) -> str:
    """Return a share in per cent, in at most five characters: 0 %, <1 %, 62 %."""
    share = 100 * some / total if total else 0.0
    return "<1 %" if 0 < share <= 0.5 else f"{share:.0f} %"


def span_text(seconds: float) -> str:
    """Return a time in at most seven characters: 4 s, 12:05, 3:12 h, 2.5 d."""
    whole = max(0, round(min(seconds, MAX_SECONDS)))
    if whole < 60:
        return f"{whole} s"
    if whole < 3600:
        return f"{whole // 60}:{whole % 60:02d}"
    if whole < 86_400:
        return f"{whole // 3600}:{whole // 60 % 60:02d} h"
    days = whole / 86_400
    return f"{days:.1f} d" if days < 99.95 else f"{days:.0f} d"


def size_text(number: float) -> str:
    """Return bytes in at most six characters: 310 MB."""
    number, size = _scaled(number)
    return f"{number:.1f} {SIZES[size]}B" if size and number < 9.95 else f"{number:.0f} {SIZES[size]}B"


def _scaled(number: float) -> tuple[float, int]:
    """Return a number below 1000 and the index of its size, unless it is greater than all sizes."""
    size = 0
    while number >= 999.5 and size < len(SIZES) - 1:
        number, size = number / 1000, size + 1
    return number, size


GAP = 2  # characters between columns
LONG_NAME = 40  # cells: up to this length names of runs come before figures; their ends tell them apart

Row = TypeVar("Row")
Lines = list[Text]


@dataclass(frozen=True)
class TableColumn(Generic[Row]):
    """A column of a table."""

    title: str
    value: Callable[[Row], str]  # Gives the printable text of a row
    width: int  # The least width
    rank: int = 0  # Columns of a greater rank are left out first, those of rank 0 never
    align: Literal["left", "right"] = "right"
    grows: bool = False  # True for a column that takes what it needs of the width that is left


def table_lines(
    columns: Sequence[TableColumn[Row]],
    rows: Sequence[Row],
    width: int,
    glyphs: Glyphs,
    style: Callable[[Row], str] = lambda _: "",
) -> Lines:
    """Return a line with the titles, and one for each row; no line is longer than `width`.

    A column without a title is left out where all of its texts are empty.
    """
    filled = [column for column in columns if column.title or any(column.value(row).strip() for row in rows)]
    shown = fitting_columns(filled, width)
    widths = [column.width for column in shown]
    room = width - _total(shown)
    for number, column in enumerate(shown):
        needed = max([cell_len(column.value(row)) for row in rows], default=0)
        more = max(0, min(room, needed - widths[number])) if column.grows else 0
        widths[number] += more
        room -= more

    def line(values: Sequence[str], style: str) -> Text:
        cells = zip(shown, values, widths, strict=True)
        words = [fit_text(value, wide, glyphs, column.align) for column, value, wide in cells]
        return Text((" " * GAP).join(words).rstrip(), style=style)

    titles = line([column.title for column in shown], "dim")
    return [titles, *(line([column.value(row) for column in shown], style(row)) for row in rows)]


def fitting_columns(columns: Sequence[TableColumn[Row]], width: int) -> list[TableColumn[Row]]:
    """Return the columns that fit; of the greatest rank the last one is left out first."""
    kept = list(columns)
    while _total(kept) > width and any(column.rank for column in kept):
        kept.remove(max(reversed(kept), key=lambda column: column.rank))
    return kept


def _total(columns: Sequence[TableColumn[Row]]) -> int:
    return sum(column.width for column in columns) + GAP * max(0, len(columns) - 1)


def fit_text(words: str, width: int, glyphs: Glyphs, align: str = "left") -> str:
    """Return words in exactly so many cells: filled up, or cut off with a mark."""
    if cell_len(words) > width:
        return set_cell_size(words, max(0, width - 1)) + glyphs.more if width > 0 else ""
    return " " * (width - cell_len(words)) + words if align == "right" else set_cell_size(words, width)


def text_line(words: str, width: int, glyphs: Glyphs, style: str | Style = "") -> Text:
    """Return words as a line of at most so many cells."""
    return Text(fit_text(words, width, glyphs).rstrip(), style=style)


STYLES = {
    "starting": "cyan", "running": "green", "paused": "yellow", "ending": "cyan",
    "silent": "bold yellow", "gone": "bold red", "ended": "dim", "cancelled": "dim",
    "working": "", "idle": "dim", "stuck": "bold yellow", "leaving": "cyan",
    "job": "cyan", "run": "green", "warning": "yellow", "trouble": "bold yellow", "error": "bold red",
}  # fmt: skip
"""Styles of the states of jobs and workers, and of the kinds of events."""


def job_list(views: Sequence[JobView], chosen: int, width: int, rows: int, glyphs: Glyphs) -> Lines:
    """Return the table of the jobs, in at most so many rows, among them the selected one."""
    first = first_row(len(views), rows, chosen - rows // 2)
    numbered = list(enumerate(views))[first : first + rows]
    columns: list[TableColumn[tuple[int, JobView]]] = [
        TableColumn("", lambda one: glyphs.chosen if one[0] == chosen else " ", 1),
        TableColumn("", lambda one: str(one[0] + 1) if one[0] < 9 else "", 1, rank=1),
        TableColumn("job", lambda one: glyphs.text(one[1].job), 14, align="left", grows=True),
        TableColumn("state", lambda one: glyphs.text(state_text(one[1])), 12, align="left"),
        TableColumn("runs", lambda one: _runs(one[1]), 7, rank=5),
        TableColumn("evaluations", lambda one: count_text(one[1].figures.evaluations), 11, rank=4),
        TableColumn("done", lambda one: percent_text(one[1].figures.done, 1.0), 5),
        TableColumn("left", lambda one: time_left(one[1]), 7, rank=2),
        TableColumn("eval/s", lambda one: short_count(one[1].history.latest_rate), 6, rank=3),
        TableColumn("cells", lambda one: count_text(one[1].figures.cells), 8, rank=6),
        TableColumn("robust", lambda one: count_text(one[1].figures.robust), 8, rank=7),
        TableColumn("workers", lambda one: count_text(one[1].figures.workers), 7, rank=8),
    ]
    return table_lines(columns, numbered, width, glyphs, lambda one: STYLES.get(one[1].state, ""))


def state_text(view: JobView) -> str:
    """Return the state of a job, with the time since its last message where that is long."""
    return f"{view.state} {span_text(view.silent)}" if view.state in ("silent", "gone") else view.state


def time_left(view: JobView) -> str:
    """Return the time that a job still takes."""
    seconds = None if view.state in OVER else view.figures.seconds_left
    return "-" if seconds is None else span_text(seconds)


def _end(run: RunStatus) -> str:
    return run.trouble or run.finished


def run_list(view: JobView, width: int, glyphs: Glyphs) -> Lines:
    """Return the table of a job's runs: those in progress first, then the latest that ended."""
    runs = [run for run in view.runs if not run.finished] + [run for run in view.runs[::-1] if run.finished]
    longest = max([cell_len(glyphs.text(run.run)) for run in runs], default=0)
    name = max(16, min(longest, LONG_NAME, width - 17))  # beside it stand at least two columns
    columns: list[TableColumn[RunStatus]] = [
        TableColumn("run", lambda run: glyphs.text(run.run), name, align="left", grows=True),
        TableColumn("evaluations", lambda run: count_text(run.evaluations), 11, rank=1),
        TableColumn("done", lambda run: percent_text(run.done, 1.0), 5),
        TableColumn("eval/s", lambda run: _speed(view, run), 6, rank=5),
        TableColumn("cells", lambda run: count_text(run.cells), 8),
        TableColumn("success", lambda run: percent_text(run.successes, run.evaluations), 7, rank=4),
        TableColumn("robust", lambda run: count_text(run.robust), 8, rank=3),
        TableColumn("errors", lambda run: count_text(run.errors), 6, rank=6),
        TableColumn("", lambda run: glyphs.text(_end(run)), 12, rank=7, align="left", grows=True),
    ]
    return table_lines(columns, runs, width, glyphs, _run_style)


def object_list(objects: Sequence[ObjectListing], width: int, glyphs: Glyphs) -> Lines:
    """Return the table of objects in their order."""
    columns: list[TableColumn[ObjectListing]] = [
        TableColumn("object", lambda one: glyphs.text(one.object), 18, align="left"),
        TableColumn("state", lambda one: glyphs.text(one.state), 8, align="left"),
        TableColumn("runs", lambda one: f"{one.runs_done}/{one.runs}" if one.runs else "-", 5),
        TableColumn("evaluations", lambda one: count_text(one.evaluations), 11, rank=4),
        TableColumn("success", lambda one: percent_text(one.successes, one.evaluations), 7, rank=3),
        TableColumn("cells", lambda one: count_text(one.cells), 6),
        TableColumn("grasps", lambda one: count_text(one.grasps), 7),
        TableColumn("errors", lambda one: count_text(one.errors), 6, rank=5),
        TableColumn("note", lambda one: glyphs.text(one.note), 12, rank=2, align="left", grows=True),
    ]
    return table_lines(columns, objects, width, glyphs, _object_style)


def _object_style(one: ObjectListing) -> str:
    if one.state in ("failed", "skipped") or one.note:
        return "yellow"
    return "dim" if one.state == "waiting" else ""


def worker_list(view: JobView, width: int, glyphs: Glyphs) -> Lines:
    """Return the table of a job's workers; those that are in trouble first."""
    rank = {"gone": 0, "stuck": 1, "leaving": 2}
    workers = sorted(view.workers, key=lambda worker: (rank.get(worker.state, 3), worker.host, worker.pid))
    columns: list[TableColumn[WorkerStatus]] = [
        TableColumn("host", lambda one: glyphs.text(one.host), 12, align="left", grows=True),
        TableColumn("process", lambda one: str(one.pid), 7, rank=6),
        TableColumn("state", lambda one: glyphs.text(one.state), 7, align="left"),
        TableColumn("rows/s", lambda one: short_count(one.rate), 6),
        TableColumn("leases", lambda one: str(one.batches), 6, rank=2),
        TableColumn("seen", lambda one: span_text(one.seen + view.silent), 6),
        TableColumn("memory", lambda one: size_text(one.memory) if one.memory else "-", 6, rank=1),
        TableColumn("rows", lambda one: count_text(one.rows), 9, rank=4),
        TableColumn("restarts", lambda one: str(one.restarts), 8, rank=5),
        TableColumn("here for", lambda one: span_text(one.seconds), 8, rank=7),
        TableColumn("wid", lambda one: glyphs.text(one.wid[:8]), 8, rank=3, align="left"),
    ]
    return table_lines(columns, workers, width, glyphs, lambda one: STYLES.get(one.state, ""))


def worker_words(view: JobView, glyphs: Glyphs) -> str:
    """Return the number of workers in each state, and of their hosts."""
    states = Counter(worker.state for worker in view.workers)
    hosts = len({worker.host for worker in view.workers})
    counts = ", ".join(f"{n} {glyphs.text(state)}" for state, n in states.most_common())
    return f"{counts} on {counted(hosts, 'host')}" if counts else "none has joined"


def event_list(events: Sequence[JobEvent], width: int, glyphs: Glyphs) -> Lines:
    """Return the table of events, the latest first."""
    lines = [text_line("at       what     happened", width, glyphs, "dim")]
    for one in reversed(events):
        words = f"{_clock(one.at)} {one.kind:8} {glyphs.text(one.words)}"
        lines.append(text_line(words, width, glyphs, STYLES.get(one.kind, "")))
    return lines


def first_row(total: int, rows: int, first: int) -> int:
    """Return the first of `rows` shown lines of a list that is scrolled to `first`."""
    return max(0, min(first, total - rows))


def _clock(at: datetime) -> str:
    """Return the local time of the day; a date outside the calendar's range stays in its zone."""
    with suppress(OverflowError):
        at = at.astimezone()
    return f"{at:%H:%M:%S}"


def _runs(view: JobView) -> str:
    figures = view.figures
    failed = f"-{figures.runs_failed}" if figures.runs_failed else ""
    return f"{figures.runs_done}{failed}/{figures.runs}"


def _speed(view: JobView, run: RunStatus) -> str:
    is_known = not run.finished and run.run in view.histories
    return short_count(view.histories[run.run].latest_rate) if is_known else ""


def _run_style(run: RunStatus) -> str:
    return "bold yellow" if run.trouble else "dim" if run.finished else ""
