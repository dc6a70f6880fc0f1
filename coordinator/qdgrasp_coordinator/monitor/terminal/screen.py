"""The screen: what the feed knows, drawn again and again until somebody leaves."""

from datetime import UTC, datetime
from typing import Protocol

from rich.console import Console, Group
from rich.live import Live

from qdgrasp_coordinator.monitor.jobs import JobView
from qdgrasp_coordinator.monitor.overview import lines, utc_now
from qdgrasp_coordinator.monitor.terminal.choice import LEAVE, Choice
from qdgrasp_coordinator.monitor.terminal.frame import Shown, frame, nothing, page
from qdgrasp_coordinator.monitor.terminal.glyphs import Glyphs
from qdgrasp_coordinator.monitor.terminal.keyboard import Keyboard, keyboard
from qdgrasp_protocol.lifetime import Stop

INTERVAL = 0.5  # seconds between two pictures
QUIET_INTERVAL = 5.0  # seconds between two looks where nothing can be drawn


class Watched(Protocol):
    """Whatever knows jobs."""

    def views(self) -> list[JobView]:
        """The jobs as they are now."""

    @property
    def is_linked(self) -> bool:
        """False while there is no way to the router."""

    @property
    def strangers(self) -> list[str]:
        """Jobs of another version."""


def watch(feed: Watched, endpoint: str, console: Console, glyphs: Glyphs, stop: Stop) -> None:
    """Show jobs until a key or a signal ends it."""
    if console.is_terminal and not console.is_dumb_terminal:
        with keyboard(stop) as heard:
            draw(feed, endpoint, console, glyphs, heard, stop)
    else:
        tell(feed, endpoint, console, glyphs, Keyboard(stop, None), stop)


def draw(feed: Watched, endpoint: str, console: Console, glyphs: Glyphs, heard: Keyboard, stop: Stop) -> None:
    """Draw the whole terminal twice a second, and after each key."""
    choice: Choice | None = Choice()
    while choice is not None and not stop.is_set:
        screen = Live(
            console=console, screen=True, auto_refresh=False, redirect_stderr=False, redirect_stdout=False
        )
        with screen:
            while choice is not None and not (stop.is_set or heard.is_to_rest):
                shown, (width, height) = look(feed, endpoint), console.size
                screen.update(Group(*frame(shown, choice, width, height, glyphs)), refresh=True)
                choice = _chosen(choice, heard.wait(INTERVAL), shown, page(shown, width, height, glyphs))
        if heard.is_to_rest:
            heard.rest()


def _chosen(choice: Choice, keys: list[str], shown: Shown, rows: int) -> Choice | None:
    """What is to be seen after some keys; None: nothing more."""
    for key in keys:
        if key in LEAVE:
            return None
        choice = choice.pressed(key, shown.names, rows)
    return choice


def tell(feed: Watched, endpoint: str, console: Console, glyphs: Glyphs, heard: Keyboard, stop: Stop) -> None:
    """Tell how far the jobs are, every few seconds: for terminals that cannot be drawn on, and for files."""
    heard.wait(INTERVAL)  # until something was heard
    while not stop.is_set:
        for line in told(look(feed, endpoint), console.width, glyphs):
            console.print(line, highlight=False, markup=False, soft_wrap=True)
        heard.wait(QUIET_INTERVAL)


def told(shown: Shown, width: int, glyphs: Glyphs) -> list[str]:
    """All jobs in lines of words."""
    link = [shown.link.plain] if shown.link else []
    if link and not shown.is_over:
        return link
    if not shown.views:
        return [line.plain for line in nothing(shown, width, glyphs)]
    return [glyphs.text(line) for view in shown.views for line in lines(view, utc_now())] + link


def look(feed: Watched, endpoint: str) -> Shown:
    """What there is to see now."""
    return Shown(feed.views(), endpoint, local_time(), is_linked=feed.is_linked, strangers=feed.strangers)


def local_time() -> datetime:
    """What time it is for whoever sits here."""
    return datetime.now(UTC).astimezone()
