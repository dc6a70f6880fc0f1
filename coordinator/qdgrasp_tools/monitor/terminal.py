"""`qdgrasp-monitor` on a terminal: drawn again and again until a signal ends it.

A screen has exactly the lines and columns of its terminal.
"""

import time
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime

from rich.console import Console, Group, RenderableType
from rich.layout import Layout
from rich.live import Live
from rich.table import Table
from rich.text import Text

from qdgrasp_protocol.process import Stop
from qdgrasp_tools.monitor import screen
from qdgrasp_tools.monitor.feed import Feed
from qdgrasp_tools.monitor.job_model import OVER, JobView, end_state
from qdgrasp_tools.monitor.screen import text_line


@dataclass(frozen=True)
class ScreenState:
    """All data that the screen can show."""

    views: Sequence[JobView]  # Those that are over at the end; the first one is shown in full
    endpoint: str
    at: datetime  # Local time
    is_linked: bool = True  # False while the router cannot be reached

    @property
    def is_over(self) -> bool:
        """True where all jobs are over: the router of a job on one machine ends with it."""
        return bool(self.views) and all(end_state(view.figures) for view in self.views)

    @property
    def link(self) -> str:
        """Message about a router that is away; else empty."""
        if self.is_linked:
            return ""
        if self.is_over:
            return "The router has left, as all jobs are over; what begins there is shown."
        return "The router is away; it is sought until it is back."

    @property
    def advice(self) -> str:
        """Advice for when there is no job; empty where there is one, or no router."""
        if self.views or not self.is_linked:
            return ""
        return (
            f"No job is at {self.endpoint}: the router answers, but no coordinator does.\n"
            "Begin one with `qdgrasp run --gripper panda --object mug`, or name another router with "
            "--connect.\nIt is shown here as soon as it begins."
        )

    @property
    def head(self) -> list[RenderableType]:
        """The endpoint and the time, and below it what is wrong with the connection, a line each."""
        bar = Table.grid(expand=True)
        bar.add_column(ratio=1)
        bar.add_row(
            text_line(f"qdgrasp-monitor · {self.endpoint}"), f"{self.at:%H:%M:%S}", style="bold reverse"
        )
        lines: list[RenderableType] = [bar]
        if self.link:
            lines.append(text_line(self.link, "" if self.is_over else "bold red"))
        return lines


MIN_SIZE = (40, 12)  # The least columns and lines in which something can be shown
SUMMARY_ROWS = 7  # lines of the summary of a job
LEAST_ROWS = 4  # lines of a list at least
MOST_RATIO = 12  # lines by which room is shared at most
PARTS = ("workers", "events", "runs")  # Parts below the summary, the most important first
FOOT = "Ctrl-C leaves  --job NAME shows another job"


def screen_layout(shown: ScreenState, width: int, height: int) -> RenderableType:
    """Return the screen, in `height` lines of `width` cells."""
    if width < MIN_SIZE[0] or height < MIN_SIZE[1]:
        return Text(f"{MIN_SIZE[0]} columns, {MIN_SIZE[1]} lines", no_wrap=True)
    head, foot = shown.head, text_line(f"{FOOT:{width}}", "reverse")
    body = _body(shown.views, height - len(head) - 1) if shown.views else [Layout(shown.advice or " ")]
    layout = Layout()
    layout.split_column(Layout(Group(*head), size=len(head)), *body, Layout(foot, size=1))
    return layout


def _body(views: Sequence[JobView], room: int) -> list[Layout]:
    view, rows = views[0], 1 + min(len(views), max(2, room // 7))
    summary = Layout(Group(screen.rule(view.job), screen.job_summary(view)), size=SUMMARY_ROWS)
    return [Layout(screen.job_list(views), size=rows), summary, *_below(view, room - rows - SUMMARY_ROWS)]


def _below(view: JobView, room: int) -> list[Layout]:
    """Return runs, workers and events: the most important ones that have room."""
    lists = {"runs": screen.run_list(view)} if view.figures.runs > 1 else {}
    lists |= {"workers": screen.worker_list(view), "events": screen.event_list(view)}
    kept = [found for name, found in lists.items() if PARTS.index(name) < room // LEAST_ROWS]
    lengths = [len(found.rows) + found.heads for found in kept]
    fit = sum(lengths) <= room
    return [
        Layout(
            found,
            ratio=min(length, MOST_RATIO),
            minimum_size=LEAST_ROWS,
            size=length if fit else None,
        )
        for found, length in zip(kept, lengths, strict=True)
    ] or [Layout(" ")]


DRAW_INTERVAL = 0.5  # seconds between two pictures


def watch_jobs(feed: Feed, endpoint: str, console: Console, stop: Stop) -> None:
    """Draw the whole terminal twice a second until a signal ends it."""
    live = Live(
        console=console, screen=True, auto_refresh=False, redirect_stderr=False, redirect_stdout=False
    )
    with live:
        while not stop.is_set:
            views = sorted(feed.views(), key=lambda view: view.state in OVER)
            shown = ScreenState(views, endpoint, datetime.now().astimezone(), feed.is_linked)
            live.update(screen_layout(shown, *console.size), refresh=True)
            time.sleep(DRAW_INTERVAL)
