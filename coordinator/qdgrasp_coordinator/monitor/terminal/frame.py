"""The frame: all that is shown at once, in exactly the lines and columns that a terminal has."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from datetime import datetime

from rich.cells import cell_len
from rich.text import Text

from qdgrasp_coordinator.monitor.jobs import JobView
from qdgrasp_coordinator.monitor.terminal.choice import Choice
from qdgrasp_coordinator.monitor.terminal.glyphs import Glyphs
from qdgrasp_coordinator.monitor.terminal.lists import (
    event_list,
    job_list,
    run_list,
    state,
    window,
    worker_list,
    worker_words,
)
from qdgrasp_coordinator.monitor.terminal.parts import curves, found, progress, stages
from qdgrasp_coordinator.monitor.terminal.table import Lines, fit
from qdgrasp_coordinator.monitor.view import last_word

LEAST = (40, 12)
"""The least columns and lines in which something can be shown."""
WIDE = 160  # columns from which two lists stand side by side
TALLEST = 30
"""The most lines of the curves."""
AWAY = "The router is away; it is sought until it is back."
LEFT = "The router has left, as all jobs are over; what begins there is shown."
KEYS = "q quit  tab job  r runs  w workers  e events  arrows scroll"


@dataclass(frozen=True)
class Shown:
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
        return Text(LEFT) if self.is_over else Text(AWAY, style="bold red")


def frame(shown: Shown, choice: Choice, width: int, height: int, glyphs: Glyphs) -> Lines:
    """What is shown, in `height` lines of at most `width` cells."""
    if width < LEAST[0] or height < LEAST[1]:
        return [Text(fit(f"{LEAST[0]} columns, {LEAST[1]} lines", width, glyphs).rstrip())]
    head, foot = _head(shown, width, glyphs), _foot(choice, width, glyphs)
    room = height - len(head) - 1
    body = _body(shown, choice, width, room, glyphs) if shown.views else nothing(shown, width, glyphs)
    filled = [*body[:room], *([Text()] * (room - len(body)))]
    return [*head, *filled, foot]


def sheet(shown: Shown, width: int, glyphs: Glyphs) -> Lines:
    """All that there is to see of all jobs, in as many lines as that takes."""
    if not shown.views:
        return nothing(shown, width, glyphs)[1:]
    lines = _head(shown, width, glyphs)
    for view in shown.views:
        lists = {
            "runs": run_list(view, width, glyphs),
            f"workers: {worker_words(view, glyphs)}": worker_list(view, width, glyphs),
            "events": event_list(view.events, width, glyphs),
        }
        title = f"{view.job}: {glyphs.text(state(view))}"
        lines += [_rule(title, width, glyphs), progress(view, width, glyphs), *found(view, width, glyphs)]
        lines += stages(view, width, glyphs)
        lines += curves(view, width, 8, glyphs) if view.figures.evaluations else []
        for title, rows in lists.items():
            lines += [_rule(title, width, glyphs), *rows] if len(rows) > 1 else []
    return lines


def page(shown: Shown, width: int, height: int, glyphs: Glyphs) -> int:
    """How many rows of a long list are seen at a time."""
    return max(1, height - len(_head(shown, width, glyphs)) - 4 - min(2, len(shown.views)))


def nothing(shown: Shown, width: int, glyphs: Glyphs) -> Lines:
    """What to do where there is no job."""
    if not shown.is_linked:
        return []
    sentences = [
        f"No job is at {shown.endpoint}: the router answers, but no coordinator does.",
        "Begin one with `qdgrasp run --gripper panda --object mug`, or name another router with --connect.",
        "It is shown here as soon as it begins.",
    ]
    return [Text(), *(line for words in sentences for line in folded(words, width))]


def folded(words: str, width: int) -> Lines:
    """A sentence in as many lines as it needs."""
    lines = [""]
    for word in words.split():
        if len(lines[-1]) + len(word) + 1 > width:
            lines.append("")
        lines[-1] += f" {word}" if lines[-1] else word
    return [Text(line[:width]) for line in lines]


def _head(shown: Shown, width: int, glyphs: Glyphs) -> Lines:
    """Where this is, what time it is, and whether the router is there."""
    clock = f"{shown.at:%H:%M:%S}"
    words = f"qdgrasp-monitor{glyphs.between}{glyphs.text(shown.endpoint)}"
    line = f"{fit(words, width - len(clock) - 1, glyphs)} {clock}"
    lines = [Text(line, style="bold reverse")]
    if link := shown.link:
        lines.append(Text(fit(link.plain, width, glyphs).rstrip(), style=link.style))
    if shown.strangers:
        names = ", ".join(map(glyphs.text, shown.strangers))
        words = f"Watch with their own version of qdgrasp-monitor: {names}"
        lines.append(Text(fit(words, width, glyphs).rstrip(), style="bold yellow"))
    return lines


def _foot(choice: Choice, width: int, glyphs: Glyphs) -> Text:
    return Text(fit(f"{KEYS}  a all" if choice.long else KEYS, width, glyphs), style="reverse")


def _body(shown: Shown, choice: Choice, width: int, room: int, glyphs: Glyphs) -> Lines:
    """The jobs, and the one that is chosen."""
    chosen = choice.place(shown.names)
    view = shown.views[chosen]
    rows = min(len(shown.views), max(2, room // 7))
    if choice.long:
        jobs = job_list(shown.views, chosen, width, min(2, rows), glyphs)
        return [*jobs, *_long(view, choice, width, room - len(jobs), glyphs)]
    jobs = job_list(shown.views, chosen, width, rows, glyphs)
    about = [_rule(view.job, width, glyphs), progress(view, width, glyphs), *found(view, width, glyphs)]
    above = [*jobs, *about, *stages(view, width, glyphs)]
    return [*above, *_below(view, width, room - len(above), glyphs)]


def _below(view: JobView, width: int, room: int, glyphs: Glyphs) -> Lines:
    """Curves, runs, workers and events, each with a part of the room."""
    has_many, wide = view.figures.runs > 1, (width - 2) // 2
    runs = run_list(view, wide if width >= WIDE else width, glyphs) if has_many else []
    workers = worker_list(view, wide if has_many and width >= WIDE else width, glyphs)
    events = event_list(view.events, width, glyphs)
    is_beside = has_many and width >= WIDE
    staff = max(len(runs), len(workers)) if is_beside else len(workers)
    some, tall, happened, below = shared(
        room, [(4, staff + 1), (4, TALLEST), (3, len(events) + 1), (0 if is_beside else 4, len(runs) + 1)]
    )
    title = f"workers: {worker_words(view, glyphs)}"
    drawn = curves(view, width, tall, glyphs) if tall else []
    feed = _titled(f"events of {view.job}", events, width, happened, glyphs)
    if is_beside:
        pair = _titled("runs", runs, wide, some, glyphs), _titled(title, workers, wide, some, glyphs)
        return [*drawn, *_beside(*pair, wide), *feed]
    table = _titled(title, workers, width, some, glyphs)
    return [*drawn, *(_titled("runs", runs, width, below, glyphs) if runs else []), *table, *feed]


def shared(room: int, wishes: Sequence[tuple[int, int]]) -> list[int]:
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


def _long(view: JobView, choice: Choice, width: int, room: int, glyphs: Glyphs) -> Lines:
    """One list with all the room there is, from where it is scrolled to."""
    lists = {
        "runs": lambda: run_list(view, width, glyphs),
        "workers": lambda: worker_list(view, width, glyphs),
        "events": lambda: event_list(view.events, width, glyphs),
    }
    head, *rows = lists[choice.long]()
    first = window(len(rows), room - 2, choice.top)
    last = min(len(rows), first + room - 2)
    title = f"{choice.long} of {view.job}: {first + 1} to {last} of {len(rows)}" if rows else choice.long
    return [_rule(title, width, glyphs), head, *rows[first:last]]


def _titled(title: str, lines: Lines, width: int, room: int, glyphs: Glyphs) -> Lines:
    """A list below its title, in exactly so many lines; how many are left out is said."""
    if room < 2:
        return [Text()] * room
    hidden = len(lines) - (room - 1)
    title = f"{title} ({hidden} more)" if hidden > 0 else title
    kept = lines[: room - 1]
    return [_rule(title, width, glyphs), *kept, *([Text()] * (room - 1 - len(kept)))]


def _rule(title: str, width: int, glyphs: Glyphs) -> Text:
    words = fit(f"{glyphs.rule * 2} {title} ", min(width, cell_len(title) + 4), glyphs)
    return Text(words + glyphs.rule * (width - cell_len(words)), style="bold")


def _beside(left: Lines, right: Lines, width: int) -> Lines:
    """Two lists of one length side by side; the left one has so many cells."""
    lines = []
    for one, other in zip(left, right, strict=True):
        line = one.copy()
        line.truncate(width, pad=True)
        lines.append(Text.assemble(line, "  ", other))
    return lines
