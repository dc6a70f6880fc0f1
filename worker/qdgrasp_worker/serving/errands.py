"""Errands: questions to others on the bus, each in a thread of its own, so that nobody waits for them."""

import threading
from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeVar

import structlog

from qdgrasp_protocol import codec
from qdgrasp_protocol.bus import Bus
from qdgrasp_protocol.errors import NoReply, QdgraspError
from qdgrasp_protocol.keys import Keys
from qdgrasp_protocol.messages import Join, Joined
from qdgrasp_worker.serving.bundles import Bundles

log = structlog.get_logger()

JOIN_SECONDS = 2.0
"""How long an answer to a join is waited for."""
T = TypeVar("T")


@dataclass(frozen=True)
class Answered:
    """What came of a join."""

    job: str
    number: int
    """The join's."""
    answer: Joined | QdgraspError


@dataclass(frozen=True)
class Fetched:
    """What came of looking for a scene."""

    job: str
    scene: str
    bundle: bytes | QdgraspError


Return = Answered | Fetched


class Errands:
    """Runs errands, and reports each to `report`, from its thread."""

    def __init__(self, bus: Bus, bundles: Bundles, report: Callable[[Return], None]) -> None:
        self._bus = bus
        self._bundles = bundles
        self._report = report

    def join(self, job: str, join: Join) -> None:
        """Ask a coordinator to be let in."""

        def ask() -> Joined:
            payload = self._bus.ask(Keys(job).join, codec.encode(join), timeout=JOIN_SECONDS)
            return codec.decode(payload, Joined)

        self._go(lambda: Answered(job, join.number, _tried(ask)))

    def fetch(self, job: str, scene: str) -> None:
        """Get a scene, from disk or from a coordinator."""
        self._go(lambda: Fetched(job, scene, _tried(lambda: self._bundles.bundle(self._bus, job, scene))))

    def _go(self, errand: Callable[[], Return]) -> None:
        threading.Thread(target=lambda: self._report(errand()), name="errand", daemon=True).start()


def _tried(act: Callable[[], T]) -> T | QdgraspError:
    try:
        return act()
    except QdgraspError as error:
        return error
    except Exception as error:
        log.exception("an errand failed")
        return NoReply(f"{type(error).__name__}: {error}")
