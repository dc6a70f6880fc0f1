"""Who may meet whom: what the table of traffic means, and what was seen of it."""

from collections.abc import Iterable
from dataclasses import dataclass
from threading import Condition
from time import monotonic

from qdgrasp_coordinator.security.traffic import TRAFFIC, Traffic, Way
from qdgrasp_protocol.keys import matches


@dataclass(frozen=True)
class Meeting:
    """Something went from one session to another.

    Attributes
    ----------
    way
        How.
    key
        On which key.
    giver
        Who published, asked or was alive.
    taker
        Who heard, answered or watched.
    """

    way: Way
    key: str
    giver: str
    taker: str


def givers(way: Way, key: str, traffic: Iterable[Traffic] = TRAFFIC) -> frozenset[str]:
    """Who may publish, ask or be alive on a key."""
    return frozenset(
        role for flow in traffic if flow.way is way and matches(flow.key, key) for role in flow.givers
    )


def takers(way: Way, key: str, traffic: Iterable[Traffic] = TRAFFIC) -> frozenset[str]:
    """Who may hear, answer or watch a key."""
    return frozenset(
        role for flow in traffic if flow.way is way and matches(flow.key, key) for role in flow.takers
    )


def allowed(way: Way, keys: Iterable[str]) -> set[Meeting]:
    """All meetings on these keys that the table of traffic allows."""
    return {
        Meeting(way, key, giver, taker)
        for key in keys
        for giver in givers(way, key)
        for taker in takers(way, key)
    }


class Notes:
    """What was seen, noted from any thread."""

    def __init__(self) -> None:
        self._seen: set[Meeting] = set()
        self._changed = Condition()

    def add(self, meeting: Meeting) -> None:
        """Note a meeting."""
        with self._changed:
            self._seen.add(meeting)
            self._changed.notify_all()

    def wait(self, for_: set[Meeting], patience: float) -> bool:
        """Wait until all of these were seen, at most `patience` seconds; whether they were."""
        deadline = monotonic() + patience
        with self._changed:
            return self._changed.wait_for(lambda: for_ <= self._seen, max(0.0, deadline - monotonic()))

    @property
    def seen(self) -> set[Meeting]:
        """All that was seen."""
        with self._changed:
            return set(self._seen)
