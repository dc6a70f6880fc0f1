"""The chronicle: what happened to a job, for those who watch and for those who come late."""

from collections.abc import Callable
from datetime import UTC, datetime

from qdgrasp_coordinator.counts.events import KEPT, Event, EventKind, Events
from qdgrasp_protocol.messages import short


def utc_now() -> datetime:
    """The time of the day."""
    return datetime.now(UTC)


class Chronicle:
    """Numbers what happens, and remembers the latest.

    Parameters
    ----------
    show
        Takes each event as it happens.
    clock
        The time of the day, with its zone.
    """

    def __init__(
        self, show: Callable[[Event], None] = lambda _event: None, clock: Callable[[], datetime] = utc_now
    ) -> None:
        self._show = show
        self._clock = clock
        self._latest: tuple[Event, ...] = ()
        self._count = 0

    def note(self, kind: EventKind, words: str, *, run: str = "", worker: str = "") -> None:
        """Note that something happened, in a sentence, to a run or worker where it is about one."""
        self._count += 1
        event = Event(
            number=self._count, at=self._clock(), kind=kind, words=short(words), run=run, worker=worker
        )
        self._latest = (*self._latest[1 - KEPT :], event)
        self._show(event)

    @property
    def latest(self) -> Events:
        """The latest events."""
        return Events(events=list(self._latest))
