"""`qdgrasp-monitor` on a terminal: drawn again and again until a key or a signal ends it.

A screen has exactly the lines and columns of its terminal. Keys select the job and the list that are shown.
"""

import os
import re
import select
import sys
import termios
import tty
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from datetime import datetime
from queue import Empty, SimpleQueue
from typing import Literal

from rich.console import Console, Group, RenderableType
from rich.layout import Layout
from rich.live import Live
from rich.table import Table
from rich.text import Text

from qdgrasp_protocol.process import Stop
from qdgrasp_protocol.text import printable
from qdgrasp_tools.monitor import screen
from qdgrasp_tools.monitor.feed import Feed, summary_lines
from qdgrasp_tools.monitor.job_model import JobView, end_state
from qdgrasp_tools.monitor.screen import Listing, text_line

ListName = Literal["", "runs", "workers", "events"]
LIST_KEYS: dict[str, ListName] = {"r": "runs", "w": "workers", "e": "events"}
LISTS: dict[str, Callable[[JobView, int], Listing]] = {
    "runs": screen.run_list,
    "workers": screen.worker_list,
    "events": screen.event_list,
}
BACK_KEYS = frozenset({"a", "escape"})
STEP_KEYS = {"up": -1, "down": 1}
JOB_KEYS = {**STEP_KEYS, "tab": 1, "right": 1, "backtab": -1, "left": -1}
QUIT_KEYS = frozenset({"q", "Q"})


@dataclass(frozen=True)
class ScreenSelection:
    """The selected job and list."""

    job: str = ""  # Its name; where there is no such job, the first one is selected
    list: ListName = ""  # The list that has all the room; empty: each has some
    top: int = 0  # The number of the first row of that list

    def index(self, jobs: Sequence[str]) -> int:
        """Return the index of the selected job among these names."""
        return jobs.index(self.job) if self.job in jobs else 0

    def after_key(self, key: str, jobs: Sequence[str], page: int) -> "ScreenSelection":
        """Return the selection after a key; `page` is the number of rows that a list shows."""
        if key in LIST_KEYS:
            return replace(self, list="" if self.list == LIST_KEYS[key] else LIST_KEYS[key], top=0)
        if key in BACK_KEYS:
            return replace(self, list="", top=0)
        moves = {**STEP_KEYS, "pageup": -page, "pagedown": page, " ": page}
        if self.list and key in moves:
            return replace(self, top=max(0, self.top + moves[key]))
        if not jobs:
            return self
        index, step = self.index(jobs), JOB_KEYS.get(key, 0)
        if key.isdecimal() and key.isascii() and 1 <= int(key) <= len(jobs):
            index = int(key) - 1
        return replace(self, job=jobs[(index + step) % len(jobs)], top=self.top if not step else 0)

    @property
    def help(self) -> str:
        """The keys that have an effect now."""
        keys = "q quit  tab job  r runs  w workers  e events  arrows scroll"
        return f"{keys}  a all" if self.list else keys


@dataclass(frozen=True)
class ScreenState:
    """All data that the screen can show."""

    views: Sequence[JobView]
    endpoint: str
    at: datetime  # Local time
    is_linked: bool = True  # False while the router cannot be reached

    @property
    def names(self) -> list[str]:
        """Names of the jobs."""
        return [view.job for view in self.views]

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
WIDE_COLUMNS = 160  # columns from which two lists stand side by side
SUMMARY_ROWS = 7  # lines of the summary of a job
LEAST_ROWS = 4  # lines of a list at least
MOST_RATIO = 12  # lines by which room is shared at most
PARTS = ("workers", "events", "runs")  # Parts below the summary, the most important first


def job_rows(shown: ScreenState, choice: ScreenSelection, height: int) -> int:
    """Return the number of lines of the list of jobs."""
    return 1 + min(len(shown.views), 2 if choice.list else max(2, height // 7))


def list_rows(shown: ScreenState, choice: ScreenSelection, height: int) -> int:
    """Return the number of rows that a list with all the room shows at a time."""
    return max(1, height - len(shown.head) - job_rows(shown, choice, height) - 3)


def screen_layout(shown: ScreenState, choice: ScreenSelection, width: int, height: int) -> RenderableType:
    """Return the screen, in `height` lines of `width` cells."""
    if width < MIN_SIZE[0] or height < MIN_SIZE[1]:
        return Text(f"{MIN_SIZE[0]} columns, {MIN_SIZE[1]} lines", no_wrap=True)
    head, foot = shown.head, text_line(f"{choice.help:{width}}", "reverse")
    layout = Layout()
    body = (
        _body(shown, choice, width, height - len(head) - 1) if shown.views else [Layout(shown.advice or " ")]
    )
    layout.split_column(Layout(Group(*head), size=len(head)), *body, Layout(foot, size=1))
    return layout


def _body(shown: ScreenState, choice: ScreenSelection, width: int, room: int) -> list[Layout]:
    chosen = choice.index(shown.names)
    view, rows = shown.views[chosen], job_rows(shown, choice, room)
    jobs = Layout(screen.job_list(shown.views, chosen), size=rows)
    if choice.list:
        return [jobs, Layout(LISTS[choice.list](view, choice.top))]
    summary = Layout(Group(screen.rule(view.job), screen.job_summary(view)), size=SUMMARY_ROWS)
    return [jobs, summary, *_below(view, width, room - rows - SUMMARY_ROWS)]


def _below(view: JobView, width: int, room: int) -> list[Layout]:
    """Return runs, workers and events: the most important ones that have room.

    On a wide terminal runs and workers stand side by side.
    """
    runs, workers, events = screen.run_list(view), screen.worker_list(view), screen.event_list(view)
    lists: dict[str, Listing] = {"runs": runs, "workers": workers, "events": events}
    lengths = {name: len(found.rows) + found.heads for name, found in lists.items()}
    parts: dict[str, RenderableType] = {**lists}
    if view.figures.runs > 1 and width >= WIDE_COLUMNS:
        beside = Layout()
        beside.split_row(Layout(runs), Layout(workers))
        parts["workers"], lengths["workers"] = beside, max(lengths["runs"], lengths["workers"])
    if view.figures.runs < 2 or width >= WIDE_COLUMNS:
        del parts["runs"]
    kept = [name for name in parts if PARTS.index(name) < room // LEAST_ROWS]
    fit = sum(lengths[name] for name in kept) <= room
    return [
        Layout(
            parts[name],
            ratio=min(lengths[name], MOST_RATIO),
            minimum_size=LEAST_ROWS,
            size=lengths[name] if fit else None,
        )
        for name in kept
    ] or [Layout(" ")]


KEYS = {
    b"\x1b[A": "up", b"\x1b[B": "down", b"\x1b[C": "right", b"\x1b[D": "left", b"\x1b[5~": "pageup",
    b"\x1b[6~": "pagedown", b"\x1b[Z": "backtab", b"\x1b": "escape", b"\t": "tab",
}  # fmt: skip
"""Bytes that terminals send for keys that are no characters, the longest first."""
KEY = re.compile(b"|".join([*map(re.escape, KEYS), b"[ -~]"]))


def parse_keys(data: bytes) -> list[str]:
    """Return the keys in the bytes from a terminal; unknown ones are left out."""
    return [KEYS.get(key) or key.decode() for key in KEY.findall(data)]


@contextmanager
def keyboard() -> Iterator[Callable[[float], list[str]]]:
    """Give a function that waits some seconds for keys, and returns those that were pressed.

    Meanwhile keys are read at once, without echo, and Ctrl-Z has no effect. There are none where standard
    input is no terminal.
    """
    source = sys.stdin.fileno()
    sources = [source] if sys.stdin.isatty() else []

    def wait(seconds: float) -> list[str]:
        if not select.select(sources, [], [], seconds)[0]:
            return []
        if not (data := os.read(source, 64)):
            sources.clear()  # the terminal is gone
        return parse_keys(data)

    if not sources:
        yield wait
        return
    before = termios.tcgetattr(source)
    try:
        tty.setcbreak(source)
        modes = termios.tcgetattr(source)
        modes[6][termios.VSUSP] = b"\0"
        termios.tcsetattr(source, termios.TCSANOW, modes)
        yield wait
    finally:
        termios.tcsetattr(source, termios.TCSADRAIN, before)


DRAW_INTERVAL = 0.5  # seconds between two pictures
PRINT_INTERVAL = 5.0  # seconds between two reports where nothing can be drawn


def watch_jobs(feed: Feed, endpoint: str, console: Console, stop: Stop) -> None:
    """Show jobs until a key or a signal ends it."""
    if console.is_terminal and not console.is_dumb_terminal:
        draw_screen(feed, endpoint, console, stop)
        return
    feed.wait(DRAW_INTERVAL)
    for _ in intervals(PRINT_INTERVAL, stop):
        for line in status_lines(screen_state(feed, endpoint)):
            console.print(line, highlight=False, markup=False, soft_wrap=True)


def draw_screen(feed: Feed, endpoint: str, console: Console, stop: Stop) -> None:
    """Draw the whole terminal twice a second, and after each key."""
    choice = ScreenSelection()
    live = Live(
        console=console, screen=True, auto_refresh=False, redirect_stderr=False, redirect_stdout=False
    )
    with keyboard() as keys, live:
        while not stop.is_set:
            shown, (width, height) = screen_state(feed, endpoint), console.size
            live.update(screen_layout(shown, choice, width, height), refresh=True)
            for key in keys(DRAW_INTERVAL):
                if key in QUIT_KEYS:
                    return
                choice = choice.after_key(key, shown.names, list_rows(shown, choice, height))


def intervals(seconds: float, stop: Stop) -> Iterator[None]:
    """Yield now and after each so many seconds, until this process is asked to stop."""
    ended: SimpleQueue[None] = SimpleQueue()
    stop.tell(lambda: ended.put(None))
    while not stop.is_set:
        yield
        with suppress(Empty):
            ended.get(timeout=seconds)


def status_lines(shown: ScreenState) -> list[str]:
    """Return all jobs in lines of words."""
    link = [shown.link] if shown.link else []
    if link and not shown.is_over:
        return link
    if not shown.views:
        return shown.advice.splitlines()
    return [printable(line) for view in shown.views for line in summary_lines(view)] + link


def screen_state(feed: Feed, endpoint: str) -> ScreenState:
    """Return the state of a feed as the screen shows it now."""
    return ScreenState(feed.views(), endpoint, datetime.now().astimezone(), feed.is_linked)
