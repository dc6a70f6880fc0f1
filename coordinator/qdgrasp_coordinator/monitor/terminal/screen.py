"""Draws the screen of `qdgrasp-monitor` again and again until it is left.

A screen has exactly the lines and columns of its terminal. Keys change which job and which list is shown.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from typing import Literal, Protocol

from rich.cells import cell_len
from rich.console import Console, Group
from rich.live import Live
from rich.text import Text

from qdgrasp_coordinator.monitor.feed import summary_lines, utc_now
from qdgrasp_coordinator.monitor.job_view import JobView, last_word
from qdgrasp_coordinator.monitor.terminal.charts import count_lines, curve_lines, outcome_lines, progress_line
from qdgrasp_coordinator.monitor.terminal.keyboard import Keyboard, keyboard
from qdgrasp_coordinator.monitor.terminal.text_tables import (
    Glyphs,
    Lines,
    event_list,
    first_row,
    fit_text,
    job_list,
    run_list,
    state_text,
    worker_list,
    worker_words,
)
from qdgrasp_protocol.process import Stop

ListName = Literal["", "runs", "workers", "events"]
LIST_KEYS: dict[str, ListName] = {"r": "runs", "w": "workers", "e": "events"}
BACK_KEYS = frozenset({"a", "escape"})
NEXT_KEYS, PREVIOUS_KEYS = frozenset({"tab", "right"}), frozenset({"backtab", "left"})
STEP_KEYS = {"up": -1, "down": 1}
QUIT_KEYS = frozenset({"q", "Q"})


@dataclass(frozen=True)
class ScreenSelection:
    """What is to be seen.

    Attributes
    ----------
    job
        The name of a job; where there is none of that name, the first one is meant.
    long
        The list that has all the room; empty: each has some.
    top
        The number of the first row of that list.
    """

    job: str = ""
    long: ListName = ""
    top: int = 0

    def place(self, jobs: Sequence[str]) -> int:
        """Which of some jobs is meant."""
        return jobs.index(self.job) if self.job in jobs else 0

    def pressed(self, key: str, jobs: Sequence[str], page: int) -> "ScreenSelection":
        """What is to be seen after a key was pressed.

        Parameters
        ----------
        jobs
            The names of those that there are.
        page
            How many rows of a list are seen at a time.
        """
        if key in LIST_KEYS:
            return replace(self, long="" if self.long == LIST_KEYS[key] else LIST_KEYS[key], top=0)
        if key in BACK_KEYS:
            return replace(self, long="", top=0)
        if self.long and (to := self._scrolled(key, page)) is not None:
            return replace(self, top=max(0, to))
        return self._another(key, jobs)

    def _scrolled(self, key: str, page: int) -> int | None:
        moves = {**STEP_KEYS, "pageup": -page, "pagedown": page, " ": page, "home": -self.top, "end": 1 << 30}
        return self.top + moves[key] if key in moves else None

    def _another(self, key: str, jobs: Sequence[str]) -> "ScreenSelection":
        """With another job, if the key names one."""
        if not jobs:
            return self
        place = self.place(jobs)
        step = STEP_KEYS.get(key, (key in NEXT_KEYS) - (key in PREVIOUS_KEYS))
        if key.isdecimal() and key.isascii() and 1 <= int(key) <= len(jobs):
            place = int(key) - 1
        return replace(self, job=jobs[(place + step) % len(jobs)], top=self.top if not step else 0)


MIN_SIZE = (40, 12)  # The least columns and lines in which something can be shown
WIDE_COLUMNS = 160  # columns from which two lists stand side by side
MAX_CURVE_ROWS = 30  # The most lines of the curves
ROUTER_AWAY = "The router is away; it is sought until it is back."
ROUTER_LEFT = "The router has left, as all jobs are over; what begins there is shown."
KEY_HELP = "q quit  tab job  r runs  w workers  e events  arrows scroll"


@dataclass(frozen=True)
class ScreenState:
    """What there is to see."""

    views: Sequence[JobView]
    endpoint: str
    at: datetime
    """When; in the zone of whoever watches."""
    is_linked: bool = True
    """False while there is no way to the router."""
    strangers: Sequence[str] = field(default=())
    """Jobs of another version."""

    @property
    def names(self) -> list[str]:
        """The names of the jobs."""
        return [view.job for view in self.views]

    @property
    def is_over(self) -> bool:
        """Whether all jobs are: the router of a job on one machine ends with it."""
        return bool(self.views) and all(last_word(view.figures) for view in self.views)

    @property
    def link(self) -> Text:
        """What there is to say about the way to the router; nothing while there is one."""
        if self.is_linked:
            return Text()
        return Text(ROUTER_LEFT) if self.is_over else Text(ROUTER_AWAY, style="bold red")


def screen_lines(
    shown: ScreenState, choice: ScreenSelection, width: int, height: int, glyphs: Glyphs
) -> Lines:
    """What is shown, in `height` lines of at most `width` cells."""
    if width < MIN_SIZE[0] or height < MIN_SIZE[1]:
        return [Text(fit_text(f"{MIN_SIZE[0]} columns, {MIN_SIZE[1]} lines", width, glyphs).rstrip())]
    head, foot = _head(shown, width, glyphs), _foot(choice, width, glyphs)
    room = height - len(head) - 1
    body = _body(shown, choice, width, room, glyphs) if shown.views else no_job_lines(shown, width, glyphs)
    filled = [*body[:room], *([Text()] * (room - len(body)))]
    return [*head, *filled, foot]


def report_lines(shown: ScreenState, width: int, glyphs: Glyphs) -> Lines:
    """All that there is to see of all jobs, in as many lines as that takes."""
    if not shown.views:
        return no_job_lines(shown, width, glyphs)[1:]
    lines = _head(shown, width, glyphs)
    for view in shown.views:
        lists = {
            "runs": run_list(view, width, glyphs),
            f"workers: {worker_words(view, glyphs)}": worker_list(view, width, glyphs),
            "events": event_list(view.events, width, glyphs),
        }
        title = f"{view.job}: {glyphs.text(state_text(view))}"
        lines += [
            _rule(title, width, glyphs),
            progress_line(view, width, glyphs),
            *count_lines(view, width, glyphs),
        ]
        lines += outcome_lines(view, width, glyphs)
        lines += curve_lines(view, width, 8, glyphs) if view.figures.evaluations else []
        for title, rows in lists.items():
            lines += [_rule(title, width, glyphs), *rows] if len(rows) > 1 else []
    return lines


def list_rows(shown: ScreenState, width: int, height: int, glyphs: Glyphs) -> int:
    """How many rows of a long list are seen at a time."""
    return max(1, height - len(_head(shown, width, glyphs)) - 4 - min(2, len(shown.views)))


def no_job_lines(shown: ScreenState, width: int, glyphs: Glyphs) -> Lines:
    """What to do where there is no job."""
    if not shown.is_linked:
        return []
    sentences = [
        f"No job is at {shown.endpoint}: the router answers, but no coordinator does.",
        "Begin one with `qdgrasp run --gripper panda --object mug`, or name another router with --connect.",
        "It is shown here as soon as it begins.",
    ]
    return [Text(), *(line for words in sentences for line in wrapped_lines(words, width))]


def wrapped_lines(words: str, width: int) -> Lines:
    """A sentence in as many lines as it needs."""
    lines = [""]
    for word in words.split():
        if len(lines[-1]) + len(word) + 1 > width:
            lines.append("")
        lines[-1] += f" {word}" if lines[-1] else word
    return [Text(line[:width]) for line in lines]


def _head(shown: ScreenState, width: int, glyphs: Glyphs) -> Lines:
    """Where this is, what time it is, and whether the router is there."""
    clock = f"{shown.at:%H:%M:%S}"
    words = f"qdgrasp-monitor{glyphs.between}{glyphs.text(shown.endpoint)}"
    line = f"{fit_text(words, width - len(clock) - 1, glyphs)} {clock}"
    lines = [Text(line, style="bold reverse")]
    if link := shown.link:
        lines.append(Text(fit_text(link.plain, width, glyphs).rstrip(), style=link.style))
    if shown.strangers:
        names = ", ".join(map(glyphs.text, shown.strangers))
        words = f"Watch with their own version of qdgrasp-monitor: {names}"
        lines.append(Text(fit_text(words, width, glyphs).rstrip(), style="bold yellow"))
    return lines


def _foot(choice: ScreenSelection, width: int, glyphs: Glyphs) -> Text:
    return Text(fit_text(f"{KEY_HELP}  a all" if choice.long else KEY_HELP, width, glyphs), style="reverse")


def _body(shown: ScreenState, choice: ScreenSelection, width: int, room: int, glyphs: Glyphs) -> Lines:
    """The jobs, and the one that is chosen."""
    chosen = choice.place(shown.names)
    view = shown.views[chosen]
    rows = min(len(shown.views), max(2, room // 7))
    if choice.long:
        jobs = job_list(shown.views, chosen, width, min(2, rows), glyphs)
        return [*jobs, *_long_list(view, choice, width, room - len(jobs), glyphs)]
    jobs = job_list(shown.views, chosen, width, rows, glyphs)
    about = [
        _rule(view.job, width, glyphs),
        progress_line(view, width, glyphs),
        *count_lines(view, width, glyphs),
    ]
    above = [*jobs, *about, *outcome_lines(view, width, glyphs)]
    return [*above, *_below(view, width, room - len(above), glyphs)]


def _below(view: JobView, width: int, room: int, glyphs: Glyphs) -> Lines:
    """Curves, runs, workers and events, each with a part of the room."""
    has_many, wide = view.figures.runs > 1, (width - 2) // 2
    runs = run_list(view, wide if width >= WIDE_COLUMNS else width, glyphs) if has_many else []
    workers = worker_list(view, wide if has_many and width >= WIDE_COLUMNS else width, glyphs)
    events = event_list(view.events, width, glyphs)
    is_beside = has_many and width >= WIDE_COLUMNS
    staff = max(len(runs), len(workers)) if is_beside else len(workers)
    some, tall, happened, below = share_rows(
        room,
        [(4, staff + 1), (4, MAX_CURVE_ROWS), (3, len(events) + 1), (0 if is_beside else 4, len(runs) + 1)],
    )
    title = f"workers: {worker_words(view, glyphs)}"
    drawn = curve_lines(view, width, tall, glyphs) if tall else []
    feed = _titled_list(f"events of {view.job}", events, width, happened, glyphs)
    if is_beside:
        pair = (
            _titled_list("runs", runs, wide, some, glyphs),
            _titled_list(title, workers, wide, some, glyphs),
        )
        return [*drawn, *_beside(*pair, wide), *feed]
    table = _titled_list(title, workers, width, some, glyphs)
    return [*drawn, *(_titled_list("runs", runs, width, below, glyphs) if runs else []), *table, *feed]


def share_rows(room: int, wishes: Sequence[tuple[int, int]]) -> list[int]:
    """How many of `room` lines each of some parts gets.

    Parameters
    ----------
    wishes
        The least and the most lines of each part, the most important first; one that cannot have its least
        gets none.
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
    """One list with all the room there is, from where it is scrolled to."""
    lists = {
        "runs": lambda: run_list(view, width, glyphs),
        "workers": lambda: worker_list(view, width, glyphs),
        "events": lambda: event_list(view.events, width, glyphs),
    }
    head, *rows = lists[choice.long]()
    first = first_row(len(rows), room - 2, choice.top)
    last = min(len(rows), first + room - 2)
    title = f"{choice.long} of {view.job}: {first + 1} to {last} of {len(rows)}" if rows else choice.long
    return [_rule(title, width, glyphs), head, *rows[first:last]]


def _titled_list(title: str, lines: Lines, width: int, room: int, glyphs: Glyphs) -> Lines:
    """A list below its title, in exactly so many lines; how many are left out is said."""
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
    """Two lists of one length side by side; the left one has so many cells."""
    lines = []
    for one, other in zip(left, right, strict=True):
        line = one.copy()
        line.truncate(width, pad=True)
        lines.append(Text.assemble(line, "  ", other))
    return lines


DRAW_INTERVAL = 0.5  # seconds between two pictures
PRINT_INTERVAL = 5.0  # seconds between two looks where nothing can be drawn


class TerminalFeed(Protocol):
    """Whatever knows jobs."""

    def views(self) -> list[JobView]:
        """The jobs as they are now."""

    @property
    def is_linked(self) -> bool:
        """False while there is no way to the router."""

    @property
    def strangers(self) -> list[str]:
        """Jobs of another version."""


def watch_jobs(feed: TerminalFeed, endpoint: str, console: Console, glyphs: Glyphs, stop: Stop) -> None:
    """Show jobs until a key or a signal ends it."""
    if console.is_terminal and not console.is_dumb_terminal:
        with keyboard(stop) as heard:
            draw_screen(feed, endpoint, console, glyphs, heard, stop)
    else:
        print_status(feed, endpoint, console, glyphs, Keyboard(stop, None), stop)


def draw_screen(
    feed: TerminalFeed, endpoint: str, console: Console, glyphs: Glyphs, heard: Keyboard, stop: Stop
) -> None:
    """Draw the whole terminal twice a second, and after each key."""
    choice: ScreenSelection | None = ScreenSelection()
    while choice is not None and not stop.is_set:
        screen = Live(
            console=console, screen=True, auto_refresh=False, redirect_stderr=False, redirect_stdout=False
        )
        with screen:
            while choice is not None and not (stop.is_set or heard.is_to_rest):
                shown, (width, height) = screen_state(feed, endpoint), console.size
                screen.update(Group(*screen_lines(shown, choice, width, height, glyphs)), refresh=True)
                choice = _selection_after(
                    choice, heard.wait(DRAW_INTERVAL), shown, list_rows(shown, width, height, glyphs)
                )
        if heard.is_to_rest:
            heard.rest()


def _selection_after(
    choice: ScreenSelection, keys: list[str], shown: ScreenState, rows: int
) -> ScreenSelection | None:
    """What is to be seen after some keys; None: nothing more."""
    for key in keys:
        if key in QUIT_KEYS:
            return None
        choice = choice.pressed(key, shown.names, rows)
    return choice


def print_status(
    feed: TerminalFeed, endpoint: str, console: Console, glyphs: Glyphs, heard: Keyboard, stop: Stop
) -> None:
    """Tell how far the jobs are, every few seconds: for terminals that cannot be drawn on, and for files."""
    heard.wait(DRAW_INTERVAL)  # until something was heard
    while not stop.is_set:
        for line in status_lines(screen_state(feed, endpoint), console.width, glyphs):
            console.print(line, highlight=False, markup=False, soft_wrap=True)
        heard.wait(PRINT_INTERVAL)


def status_lines(shown: ScreenState, width: int, glyphs: Glyphs) -> list[str]:
    """All jobs in lines of words."""
    link = [shown.link.plain] if shown.link else []
    if link and not shown.is_over:
        return link
    if not shown.views:
        return [line.plain for line in no_job_lines(shown, width, glyphs)]
    return [glyphs.text(line) for view in shown.views for line in summary_lines(view, utc_now())] + link


def screen_state(feed: TerminalFeed, endpoint: str) -> ScreenState:
    """What there is to see now."""
    return ScreenState(
        feed.views(), endpoint, local_time(), is_linked=feed.is_linked, strangers=feed.strangers
    )


def local_time() -> datetime:
    """What time it is for whoever sits here."""
    return datetime.now(UTC).astimezone()
