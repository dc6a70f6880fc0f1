"""Screen of `qdgrasp-monitor`, drawn repeatedly until a key or a signal ends it.

A screen has exactly the lines and columns of its terminal. Keys select the job and the list that are shown.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from datetime import datetime
from textwrap import wrap
from typing import Literal

from rich.cells import cell_len
from rich.console import Console, Group
from rich.live import Live
from rich.text import Text

from qdgrasp_coordinator.metrics.job_status import ObjectListing, utc_now
from qdgrasp_protocol.process import Stop
from qdgrasp_tools.campaign.object_table import SORT_KEYS, select_objects
from qdgrasp_tools.monitor.feed import Feed, ObjectFeed, summary_lines
from qdgrasp_tools.monitor.job_model import JobView, end_state
from qdgrasp_tools.monitor.terminal import text_tables as tables
from qdgrasp_tools.monitor.terminal.charts import count_lines, curve_lines, outcome_lines, progress_line
from qdgrasp_tools.monitor.terminal.keyboard import Keyboard, keyboard
from qdgrasp_tools.monitor.terminal.text_tables import Glyphs, Lines, fit_text, text_line

ListName = Literal["", "objects", "runs", "workers", "events"]
LIST_KEYS: dict[str, ListName] = {"o": "objects", "r": "runs", "w": "workers", "e": "events"}
BACK_KEYS = frozenset({"a", "escape"})
STEP_KEYS = {"up": -1, "down": 1}
JOB_KEYS = {**STEP_KEYS, "tab": 1, "right": 1, "backtab": -1, "left": -1}
QUIT_KEYS = frozenset({"q", "Q"})
OBJECT_KEYS = frozenset({"s", "S", "/"})


@dataclass(frozen=True)
class ScreenSelection:
    """The selected job and list."""

    job: str = ""  # Its name; where there is no such job, the first one is selected
    list: ListName = ""  # The list that has all the room; empty: each has some
    top: int = 0  # The number of the first row of that list
    sort: str = ""  # The key by which objects are sorted; empty: the order of their runs
    down: bool = False  # Whether the greatest object comes first
    search: str = ""  # Words of the objects that are shown
    is_typing: bool = False  # Whether keys are letters of the search

    def index(self, jobs: Sequence[str]) -> int:
        """Return the index of the selected job among these names."""
        return jobs.index(self.job) if self.job in jobs else 0

    def after_key(self, key: str, jobs: Sequence[str], page: int) -> "ScreenSelection":
        """Return the selection after a key; `page` is the number of rows that a list shows."""
        if self.is_typing:
            return self._after_letter(key)
        if self.list == "objects" and key in OBJECT_KEYS:
            return self._after_object_key(key)
        if key in LIST_KEYS:
            return replace(self, list="" if self.list == LIST_KEYS[key] else LIST_KEYS[key], top=0)
        if key in BACK_KEYS:
            return replace(self, list="", top=0)
        moves = {**STEP_KEYS, "pageup": -page, "pagedown": page, " ": page, "home": -self.top, "end": 1 << 30}
        if self.list and key in moves:
            return replace(self, top=max(0, self.top + moves[key]))
        if not jobs:
            return self
        index, step = self.index(jobs), JOB_KEYS.get(key, 0)
        if key.isdecimal() and key.isascii() and 1 <= int(key) <= len(jobs):
            index = int(key) - 1
        return replace(self, job=jobs[(index + step) % len(jobs)], top=self.top if not step else 0)

    def _after_object_key(self, key: str) -> "ScreenSelection":
        """Return the selection after a key that sorts or searches objects."""
        if key == "/":
            return replace(self, is_typing=True, top=0)
        if key == "S":
            return replace(self, down=not self.down, top=0)
        orders = ["", *SORT_KEYS]
        return replace(self, sort=orders[(orders.index(self.sort) + 1) % len(orders)], top=0)

    def _after_letter(self, key: str) -> "ScreenSelection":
        """Return the selection after a key while a search is typed."""
        if key == "enter":
            return replace(self, is_typing=False)
        if key == "escape":
            return replace(self, is_typing=False, search="", top=0)
        if key == "backspace":
            return replace(self, search=self.search[:-1], top=0)
        return replace(self, search=self.search + key, top=0) if len(key) == 1 else self


MIN_SIZE = (40, 12)  # The least columns and lines in which something can be shown
WIDE_COLUMNS = 160  # columns from which two lists stand side by side
MAX_CURVE_ROWS = 30  # The most lines of the curves
ROUTER_AWAY = "The router is away; it is sought until it is back."
ROUTER_LEFT = "The router has left, as all jobs are over; what begins there is shown."
KEY_HELP = "q quit  tab job  o objects  r runs  w workers  e events  arrows scroll"
OBJECT_HELP = "q quit  a all  s sort  S turn the order  / search  arrows scroll"
SEARCH_HELP = "letters search  enter keep the search  escape end it"


@dataclass(frozen=True)
class ScreenState:
    """All data that the screen can show."""

    views: Sequence[JobView]
    endpoint: str
    at: datetime  # Local time
    is_linked: bool = True  # False while the router cannot be reached
    foreign_jobs: Sequence[str] = ()  # Jobs of another version
    objects: Sequence[ObjectListing] | None = None  # Of the selected job; None: they are not known

    @property
    def names(self) -> list[str]:
        """Names of the jobs."""
        return [view.job for view in self.views]

    @property
    def is_over(self) -> bool:
        """True where all jobs are over: the router of a job on one machine ends with it."""
        return bool(self.views) and all(end_state(view.figures) for view in self.views)

    @property
    def link(self) -> Text:
        """Message about a router that is away; else empty."""
        if self.is_linked:
            return Text()
        return Text(ROUTER_LEFT) if self.is_over else Text(ROUTER_AWAY, style="bold red")


def screen_lines(
    shown: ScreenState, choice: ScreenSelection, width: int, height: int, glyphs: Glyphs
) -> Lines:
    """Return the screen in `height` lines of at most `width` cells."""
    if width < MIN_SIZE[0] or height < MIN_SIZE[1]:
        return [text_line(f"{MIN_SIZE[0]} columns, {MIN_SIZE[1]} lines", width, glyphs)]
    head = _head(shown, width, glyphs)
    foot = Text(fit_text(_key_help(choice), width, glyphs), style="reverse")
    room = height - len(head) - 1
    body = _body(shown, choice, width, room, glyphs) if shown.views else no_job_lines(shown, width, glyphs)
    filled = [*body[:room], *([Text()] * (room - len(body)))]
    return [*head, *filled, foot]


def _key_help(choice: ScreenSelection) -> str:
    if choice.is_typing:
        return SEARCH_HELP
    if choice.list == "objects":
        return OBJECT_HELP
    return f"{KEY_HELP}  a all" if choice.list else KEY_HELP


def report_lines(shown: ScreenState, width: int, glyphs: Glyphs) -> Lines:
    """Return everything about all jobs, in as many lines as that takes."""
    if not shown.views:
        return no_job_lines(shown, width, glyphs)[1:]
    lines = _head(shown, width, glyphs)
    for view in shown.views:
        lists = {
            "runs": tables.run_list(view, width, glyphs),
            f"workers: {tables.worker_words(view, glyphs)}": tables.worker_list(view, width, glyphs),
            "events": tables.event_list(view.events, width, glyphs),
        }
        lines += _job_lines(f"{view.job}: {glyphs.text(tables.state_text(view))}", view, width, glyphs)
        lines += curve_lines(view, width, 8, glyphs) if view.figures.evaluations else []
        for title, rows in lists.items():
            lines += [_rule(title, width, glyphs), *rows] if len(rows) > 1 else []
    return lines


def list_rows(shown: ScreenState, width: int, height: int, glyphs: Glyphs) -> int:
    """Return the number of rows that a list with all the room shows at a time."""
    return max(1, height - len(_head(shown, width, glyphs)) - 4 - min(2, len(shown.views)))


def no_job_lines(shown: ScreenState, width: int, glyphs: Glyphs) -> Lines:
    """Return advice for when there is no job."""
    if not shown.is_linked:
        return []
    sentences = [
        f"No job is at {shown.endpoint}: the router answers, but no coordinator does.",
        "Begin one with `qdgrasp run --gripper panda --object mug`, or name another router with --connect.",
        "It is shown here as soon as it begins.",
    ]
    lines = [line for words in sentences for line in wrap(words, width, break_on_hyphens=False)]
    return [Text(), *map(Text, lines)]


def _head(shown: ScreenState, width: int, glyphs: Glyphs) -> Lines:
    """Return the endpoint and the time, and below it what is wrong with the connection."""
    clock = f"{shown.at:%H:%M:%S}"
    words = f"qdgrasp-monitor{glyphs.between}{glyphs.text(shown.endpoint)}"
    line = f"{fit_text(words, width - len(clock) - 1, glyphs)} {clock}"
    lines = [Text(line, style="bold reverse")]
    if link := shown.link:
        lines.append(text_line(link.plain, width, glyphs, link.style))
    if shown.foreign_jobs:
        names = ", ".join(map(glyphs.text, shown.foreign_jobs))
        words = f"Watch with their own version of qdgrasp-monitor: {names}"
        lines.append(text_line(words, width, glyphs, "bold yellow"))
    return lines


def _job_lines(title: str, view: JobView, width: int, glyphs: Glyphs) -> Lines:
    lines = [_rule(title, width, glyphs), progress_line(view, width, glyphs)]
    return [*lines, *count_lines(view, width, glyphs), *outcome_lines(view, width, glyphs)]


def _body(shown: ScreenState, choice: ScreenSelection, width: int, room: int, glyphs: Glyphs) -> Lines:
    chosen = choice.index(shown.names)
    view = shown.views[chosen]
    rows = min(len(shown.views), max(2, room // 7))
    if choice.list:
        jobs = tables.job_list(shown.views, chosen, width, min(2, rows), glyphs)
        if choice.list == "objects":
            return [*jobs, *_object_lines(shown, view, choice, width, room - len(jobs), glyphs)]
        return [*jobs, *_long_list(view, choice, width, room - len(jobs), glyphs)]
    jobs = tables.job_list(shown.views, chosen, width, rows, glyphs)
    above = [*jobs, *_job_lines(view.job, view, width, glyphs)]
    return [*above, *_below(view, width, room - len(above), glyphs)]


def _below(view: JobView, width: int, room: int, glyphs: Glyphs) -> Lines:
    """Return curves, runs, workers and events, each with a part of the room.

    On a wide terminal runs and workers stand side by side.
    """
    has_many = view.figures.runs > 1
    is_beside = has_many and width >= WIDE_COLUMNS
    wide = (width - 2) // 2 if is_beside else width
    runs = tables.run_list(view, wide, glyphs) if has_many else []
    workers, events = tables.worker_list(view, wide, glyphs), tables.event_list(view.events, width, glyphs)
    tallest = max(len(runs), len(workers)) if is_beside else len(workers)
    wishes = [
        (4, tallest + 1),
        (4, MAX_CURVE_ROWS),
        (3, len(events) + 1),
        (0 if is_beside else 4, len(runs) + 1),
    ]
    worker_rows, curve_rows, event_rows, run_rows = share_rows(room, wishes)
    title = f"workers: {tables.worker_words(view, glyphs)}"
    curves = curve_lines(view, width, curve_rows, glyphs) if curve_rows else []
    left = _titled_list("runs", runs, wide, worker_rows if is_beside else run_rows, glyphs) if runs else []
    right = _titled_list(title, workers, wide, worker_rows, glyphs)
    lists = _beside(left, right, wide) if is_beside else [*left, *right]
    return [*curves, *lists, *_titled_list(f"events of {view.job}", events, width, event_rows, glyphs)]


def share_rows(room: int, wishes: Sequence[tuple[int, int]]) -> list[int]:
    """Share `room` lines among parts, given the least and the most lines of each.

    The most important part comes first; one that cannot have its least gets none.
    """
    given = []
    for least, _ in wishes:
        given.append(least if least <= room else 0)
        room -= given[-1]
    while room > 0 and (hungry := [n for n, (_, most) in enumerate(wishes) if 0 < given[n] < most]):
        for number in hungry[:room]:
            given[number] += 1
        room -= min(room, len(hungry))
    return given


def _long_list(view: JobView, choice: ScreenSelection, width: int, room: int, glyphs: Glyphs) -> Lines:
    """Return the selected list with all the room, from the row that it is scrolled to."""
    lists: dict[ListName, Callable[[], Lines]] = {
        "runs": lambda: tables.run_list(view, width, glyphs),
        "workers": lambda: tables.worker_list(view, width, glyphs),
        "events": lambda: tables.event_list(view.events, width, glyphs),
    }
    head, *rows = lists[choice.list]()
    first = tables.first_row(len(rows), room - 2, choice.top)
    last = min(len(rows), first + room - 2)
    title = f"{choice.list} of {view.job}: {first + 1} to {last} of {len(rows)}" if rows else choice.list
    return [_rule(title, width, glyphs), head, *rows[first:last]]


def _object_lines(
    shown: ScreenState, view: JobView, choice: ScreenSelection, width: int, room: int, glyphs: Glyphs
) -> Lines:
    """Return the objects of a job with all the room, as they are sorted and searched."""
    if shown.objects is None:
        words = (
            "No recorder has told of the objects yet." if view.figures.recorders else "There is no recorder."
        )
        return [_rule(f"objects of {view.job}", width, glyphs), text_line(words, width, glyphs)]
    found = select_objects(shown.objects, choice.search, choice.sort, down=choice.down)
    first = tables.first_row(len(found), room - 2, choice.top)
    rows = found[first : first + room - 2]
    parts = [f"{first + 1} to {first + len(rows)} of {len(found)}" if rows else "none"]
    parts += [f"by {choice.sort}{', greatest first' if choice.down else ''}"] if choice.sort else []
    parts += (
        [f"search: {choice.search}{'_' if choice.is_typing else ''}"]
        if choice.search or choice.is_typing
        else []
    )
    title = f"objects of {view.job}: {glyphs.text('; '.join(parts))}"
    return [_rule(title, width, glyphs), *tables.object_list(rows, width, glyphs)]


def _titled_list(title: str, lines: Lines, width: int, room: int, glyphs: Glyphs) -> Lines:
    """Return a list below its title, in exactly so many lines; the title counts those left out."""
    if room < 2:
        return [Text()] * room
    hidden = len(lines) - (room - 1)
    title = f"{title} ({hidden} more)" if hidden > 0 else title
    kept = lines[: room - 1]
    return [_rule(title, width, glyphs), *kept, *([Text()] * (room - 1 - len(kept)))]


def _rule(title: str, width: int, glyphs: Glyphs) -> Text:
    words = fit_text(f"{glyphs.rule * 2} {title} ", min(width, cell_len(title) + 4), glyphs)
    return Text(words + glyphs.rule * (width - cell_len(words)), style="bold")


def _beside(left: Lines, right: Lines, width: int) -> Lines:
    """Return two lists of one length side by side; the left one has so many cells."""
    lines = []
    for one, other in zip(left, right, strict=True):
        line = one.copy()
        line.truncate(width, pad=True)
        lines.append(Text.assemble(line, "  ", other))
    return lines


DRAW_INTERVAL = 0.5  # seconds between two pictures
PRINT_INTERVAL = 5.0  # seconds between two reports where nothing can be drawn


def watch_jobs(
    feed: Feed, objects: ObjectFeed, endpoint: str, console: Console, glyphs: Glyphs, stop: Stop
) -> None:
    """Show jobs until a key or a signal ends it."""
    if console.is_terminal and not console.is_dumb_terminal:
        with keyboard(stop) as keys:
            draw_screen(feed, objects, endpoint, console, glyphs, keys, stop)
    else:
        print_status(feed, endpoint, console, glyphs, Keyboard(stop, None), stop)


def draw_screen(
    feed: Feed,
    objects: ObjectFeed,
    endpoint: str,
    console: Console,
    glyphs: Glyphs,
    keys: Keyboard,
    stop: Stop,
) -> None:
    """Draw the whole terminal twice a second, and after each key."""
    choice = ScreenSelection()
    while not stop.is_set:
        screen = Live(
            console=console, screen=True, auto_refresh=False, redirect_stderr=False, redirect_stdout=False
        )
        with screen:
            while not (stop.is_set or keys.is_suspended):
                shown, (width, height) = screen_state(feed, endpoint), console.size
                if choice.list == "objects" and shown.views:
                    view = shown.views[choice.index(shown.names)]
                    shown = replace(shown, objects=objects.objects(view))
                screen.update(Group(*screen_lines(shown, choice, width, height, glyphs)), refresh=True)
                rows = list_rows(shown, width, height, glyphs)
                for key in keys.wait(DRAW_INTERVAL):
                    if key in QUIT_KEYS and not choice.is_typing:
                        return
                    choice = choice.after_key(key, shown.names, rows)
        if keys.is_suspended:
            keys.suspend()


def print_status(
    feed: Feed, endpoint: str, console: Console, glyphs: Glyphs, keys: Keyboard, stop: Stop
) -> None:
    """Print the progress of the jobs every few seconds: for dumb terminals, and for files."""
    keys.wait(DRAW_INTERVAL)  # until messages came
    while not stop.is_set:
        for line in status_lines(screen_state(feed, endpoint), console.width, glyphs):
            console.print(line, highlight=False, markup=False, soft_wrap=True)
        keys.wait(PRINT_INTERVAL)


def status_lines(shown: ScreenState, width: int, glyphs: Glyphs) -> list[str]:
    """Return all jobs in lines of words."""
    link = [shown.link.plain] if shown.link else []
    if link and not shown.is_over:
        return link
    if not shown.views:
        return [line.plain for line in no_job_lines(shown, width, glyphs)]
    return [glyphs.text(line) for view in shown.views for line in summary_lines(view, utc_now())] + link


def screen_state(feed: Feed, endpoint: str) -> ScreenState:
    """Return the state of a feed as the screen shows it now."""
    return ScreenState(feed.views(), endpoint, local_time(), feed.is_linked, feed.foreign_jobs)


def local_time() -> datetime:
    """Return the time in the local zone."""
    return utc_now().astimezone()
