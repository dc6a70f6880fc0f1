"""The lists: jobs, the runs and workers of one, and what happened to it."""

from collections import Counter
from collections.abc import Sequence
from contextlib import suppress
from datetime import datetime

from rich.text import Text

from qdgrasp_coordinator.counts.events import Event
from qdgrasp_coordinator.counts.figures import Figures
from qdgrasp_coordinator.counts.team import WorkerFigures
from qdgrasp_coordinator.monitor.series import Series
from qdgrasp_coordinator.monitor.terminal.glyphs import Glyphs
from qdgrasp_coordinator.monitor.terminal.table import Column, Lines, fit, table
from qdgrasp_coordinator.monitor.terminal.words import count, part, short, size, span
from qdgrasp_coordinator.monitor.view import OVER, JobView

STYLES = {
    "starting": "cyan", "running": "green", "paused": "yellow", "ending": "cyan",
    "silent": "bold yellow", "gone": "bold red", "ended": "dim", "cancelled": "dim",
    "working": "", "idle": "dim", "stuck": "bold yellow", "leaving": "cyan",
    "job": "cyan", "run": "green", "trouble": "bold yellow", "error": "bold red",
}  # fmt: skip
"""How the states of jobs and workers and the kinds of events look, beside what their words say."""


def job_list(views: Sequence[JobView], chosen: int, width: int, rows: int, glyphs: Glyphs) -> Lines:
    """The jobs, in at most so many rows, among them the one that is chosen."""
    first = window(len(views), rows, chosen - rows // 2)
    numbered = list(enumerate(views))[first : first + rows]
    columns: list[Column[tuple[int, JobView]]] = [
        Column("", lambda one: glyphs.chosen if one[0] == chosen else " ", 1),
        Column("", lambda one: str(one[0] + 1) if one[0] < 9 else "", 1, rank=1),
        Column("job", lambda one: glyphs.text(one[1].job), 14, align="left", grows=True),
        Column("state", lambda one: glyphs.text(state(one[1])), 12, align="left"),
        Column("runs", lambda one: _runs(one[1]), 7, rank=5),
        Column("evaluations", lambda one: count(one[1].figures.evaluations), 11, rank=4),
        Column("done", lambda one: part(one[1].figures.done, 1.0), 5),
        Column("left", lambda one: left(one[1]), 7, rank=2),
        Column("eval/s", lambda one: short(latest(one[1].history)), 6, rank=3),
        Column("cells", lambda one: count(one[1].figures.cells), 8, rank=6),
        Column("robust", lambda one: count(one[1].figures.robust), 8, rank=7),
        Column("workers", lambda one: count(one[1].figures.workers), 7, rank=8),
    ]
    return table(columns, numbered, width, glyphs, lambda one: STYLES.get(one[1].state, ""))


def state(view: JobView) -> str:
    """The state of a job, with how long nothing was heard of it."""
    return f"{view.state} {span(view.silent)}" if view.state in ("silent", "gone") else view.state


def left(view: JobView) -> str:
    """The time that a job still takes, at its speed so far."""
    figures = view.figures
    if figures.rate <= 0 or view.state in OVER:
        return "-"
    return span(figures.remaining / figures.rate)


def latest(series: Series) -> float:
    """The speed lately."""
    return series.rate[-1] if series.rate else 0.0


def run_list(view: JobView, width: int, glyphs: Glyphs) -> Lines:
    """The runs of a job that were heard of: those in progress first, then the latest that ended."""
    runs = [run for run in view.runs if not run.finished] + [run for run in view.runs[::-1] if run.finished]
    columns: list[Column[Figures]] = [
        Column("run", lambda run: glyphs.text(run.run), 16, align="left", grows=True),
        Column("evaluations", lambda run: count(run.evaluations), 11, rank=1),
        Column("done", lambda run: part(run.done, 1.0), 5),
        Column("eval/s", lambda run: _speed(view, run), 6, rank=5),
        Column("cells", lambda run: count(run.cells), 8),
        Column("success", lambda run: part(run.successes, run.evaluations), 7, rank=4),
        Column("robust", lambda run: count(run.robust), 8, rank=3),
        Column("errors", lambda run: count(run.errors), 6, rank=6),
        Column("", lambda run: glyphs.text(run.trouble or run.finished), 12, rank=7, align="left"),
    ]
    return table(columns, runs, width, glyphs, _run_style)


def worker_list(view: JobView, width: int, glyphs: Glyphs) -> Lines:
    """The workers of a job; those that are in trouble first."""
    rank = {"gone": 0, "stuck": 1, "leaving": 2}
    workers = sorted(view.workers, key=lambda worker: (rank.get(worker.state, 3), worker.host, worker.pid))
    columns: list[Column[WorkerFigures]] = [
        Column("host", lambda one: glyphs.text(one.host), 12, align="left", grows=True),
        Column("process", lambda one: str(one.pid), 7, rank=6),
        Column("state", lambda one: glyphs.text(one.state), 7, align="left"),
        Column("rows/s", lambda one: short(one.rate), 6),
        Column("leases", lambda one: str(one.batches), 6, rank=2),
        Column("seen", lambda one: span(one.seen + view.silent), 6),
        Column("memory", lambda one: size(one.memory) if one.memory else "-", 6, rank=1),
        Column("rows", lambda one: count(one.rows), 9, rank=4),
        Column("restarts", lambda one: str(one.restarts), 8, rank=5),
        Column("here for", lambda one: span(one.seconds), 8, rank=7),
        Column("wid", lambda one: glyphs.text(one.wid[:8]), 8, rank=3, align="left"),
    ]
    return table(columns, workers, width, glyphs, lambda one: STYLES.get(one.state, ""))


def worker_words(view: JobView, glyphs: Glyphs) -> str:
    """How many workers are in which state, and on how many hosts."""
    states = Counter(worker.state for worker in view.workers)
    hosts = len({worker.host for worker in view.workers})
    how = ", ".join(f"{n} {glyphs.text(state)}" for state, n in states.most_common())
    return f"{how} on {hosts} host{'s' * (hosts != 1)}" if how else "none has joined"


def event_list(events: Sequence[Event], width: int, glyphs: Glyphs) -> Lines:
    """What happened, the latest first."""
    head = Text(fit("at       what     happened", width, glyphs).rstrip(), style="dim")
    return [
        head,
        *(Text(_event(one, width, glyphs), style=STYLES.get(one.kind, "")) for one in reversed(events)),
    ]


def window(total: int, rows: int, first: int) -> int:
    """The first of `rows` lines that are shown of a list, where `first` is asked for."""
    return max(0, min(first, total - rows))


def _event(one: Event, width: int, glyphs: Glyphs) -> str:
    return fit(f"{_clock(one.at)} {one.kind:8} {glyphs.text(one.words)}", width, glyphs).rstrip()


def _clock(at: datetime) -> str:
    """What time it was for whoever sits here; a day that no calendar has is left as it came."""
    with suppress(OverflowError):
        at = at.astimezone()
    return f"{at:%H:%M:%S}"


def _runs(view: JobView) -> str:
    figures = view.figures
    failed = f"-{figures.runs_failed}" if figures.runs_failed else ""
    return f"{figures.runs_done}{failed}/{figures.runs}"


def _speed(view: JobView, run: Figures) -> str:
    return "" if run.finished or run.run not in view.histories else short(latest(view.histories[run.run]))


def _run_style(run: Figures) -> str:
    return "bold yellow" if run.trouble else "dim" if run.finished else ""
