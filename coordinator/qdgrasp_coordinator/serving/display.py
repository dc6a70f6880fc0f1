"""The display: what was shown last of a job, for whoever comes late and asks.

It is filled by the coordinator's one thread and read in threads of the bus: what is asked, and how often,
takes that thread no time.
"""

import threading
import time
from collections.abc import Callable, Container, Mapping

from msgspec import Struct

from qdgrasp_coordinator.counts.figures import to_json
from qdgrasp_protocol.bus import Query
from qdgrasp_protocol.errors import NoReply
from qdgrasp_protocol.keys import last_chunk, matches

DRAWN = 0.5
"""Seconds for which curves are good once they are drawn, however many ask."""
PATIENCE = 5.0
"""Seconds after which what was shown last is not told any more: the coordinator stands still."""

Curves = Callable[[], Mapping[str, Struct]]
"""Gives the curves there are, by their keys; called in any thread."""


class Display:
    """What was shown last, by key; and curves, which are drawn where they are asked for.

    Parameters
    ----------
    clock
        The time [s].
    """

    def __init__(self, curves: Curves, clock: Callable[[], float] = time.monotonic) -> None:
        self._curves = curves
        self._clock = clock
        self._shown: dict[str, bytes] = {}  # read in other threads as a copy, which nobody interrupts
        self._filled_at = clock()
        self._drawing = threading.Lock()
        self._drawn: dict[str, bytes] = {}
        self._drawn_until = 0.0

    def fill(self, key: str, payload: bytes) -> None:
        """Show this on a key from now on."""
        self._shown[key] = payload
        self._filled_at = self._clock()

    def keep(self, pattern: str, names: Container[str]) -> None:
        """Of what is shown on keys of a pattern, keep what has one of these names as its last chunk."""
        for key in [key for key in self._shown if matches(pattern, key)]:
            if last_chunk(key) not in names:
                del self._shown[key]

    def values(self, query: Query) -> dict[str, bytes]:
        """What is shown on the keys that match a pattern; curves only where they are asked for by that word.

        Raises
        ------
        NoReply
            Nothing was shown for a while.
        """
        if self._clock() > self._filled_at + PATIENCE:
            raise NoReply(f"Nothing was shown for {PATIENCE:g} s.")
        known = self._shown.copy() | (self._draw() if "/curve/" in query.key else {})
        return {key: payload for key, payload in known.items() if matches(query.key, key)}

    def _draw(self) -> dict[str, bytes]:
        """All curves, as they are or were a moment ago."""
        with self._drawing:
            if self._clock() >= self._drawn_until:
                self._drawn = {key: to_json(curve) for key, curve in self._curves().items()}
                self._drawn_until = self._clock() + DRAWN
            return self._drawn
