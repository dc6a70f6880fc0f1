"""The fetcher: brings scenes from the coordinator in a thread of its own, while rows go on being recorded.

Nobody waits for that thread: what it waits for ends when the bus is closed.
"""

import threading
from collections.abc import Callable, Iterable
from dataclasses import dataclass

from qdgrasp_protocol import chunks
from qdgrasp_protocol.bus import Bus
from qdgrasp_protocol.errors import BusError, MessageError, Refused


@dataclass(frozen=True)
class Fetched:
    """A scene that came."""

    digest: str
    payload: bytes


class Fetcher:
    """Fetches scene bundles, one after the other.

    Parameters
    ----------
    tell
        Takes each that came; called in the fetcher's thread.
    """

    def __init__(self, bus: Bus, job: str, tell: Callable[[Fetched], None]) -> None:
        self._bus = bus
        self._job = job
        self._tell = tell
        self._thread: threading.Thread | None = None

    def begin(self, digests: Iterable[str]) -> None:
        """Ask for scenes, unless some are being asked for."""
        if self._thread is None or not self._thread.is_alive():
            self._thread = threading.Thread(
                target=self._fetch, args=(list(digests),), name="fetcher", daemon=True
            )
            self._thread.start()

    def _fetch(self, digests: list[str]) -> None:
        for digest in digests:
            try:
                self._tell(Fetched(digest, chunks.fetch(self._bus, self._job, digest)))
            except (MessageError, Refused):
                continue  # the coordinator is not there for this run now
            except BusError:
                return  # the next try is soon
