"""Requests to coordinators in background threads, and the events that come to a worker's inbox.

Joins and scenes are asked for in a thread each, so that nothing waits for them. Scene bundles are fetched by
digest, checked, kept on disk, and kept in memory until the simulator has them.
"""

import hashlib
import os
import tempfile
import threading
from collections import OrderedDict
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from queue import SimpleQueue
from typing import TypeAlias, TypeVar

import structlog

from qdgrasp_protocol import bundle_transfer, messages
from qdgrasp_protocol.bus import Bus, Sample
from qdgrasp_protocol.errors import NoReply, QdgraspError
from qdgrasp_protocol.keys import DIGEST, Keys
from qdgrasp_protocol.messages import Join, Joined
from qdgrasp_worker.runtime.simulator_supervisor import SimulatorEvent

MAX_STORE_SIZE = 2 << 30  # What the scenes on disk may take together [bytes]


class SceneStore:
    """Scene bundles by digest.

    Parameters
    ----------
    folder
        Where bundles are kept between processes; None: nowhere.
    """

    def __init__(self, folder: Path | None) -> None:
        self._folder = folder

    def bundle(self, bus: Bus, job: str, digest: str) -> bytes:
        """The bytes of a scene, from disk or from the job's coordinator.

        Raises
        ------
        NoReply, Refused
            The coordinator does not answer, or has no such scene.
        MessageError
            What came is not the scene of that digest.
        """
        payload = self._kept(digest)
        if payload is None:
            payload = bundle_transfer.fetch_bundle(bus, job, digest)
            self._keep(digest, payload)
        return payload

    def _kept(self, digest: str) -> bytes | None:
        if self._folder is None:
            return None
        with suppress(OSError):
            payload = (self._folder / digest).read_bytes()
            if hashlib.sha256(payload).hexdigest() == digest:
                with suppress(OSError):  # a folder of others
                    os.utime(self._folder / digest)
                return payload
        return None

    def _keep(self, digest: str, payload: bytes) -> None:
        if self._folder is None:
            return
        with suppress(OSError):  # a cache that cannot be written is only slower
            self._folder.mkdir(parents=True, exist_ok=True)
            _write(self._folder, digest, payload)
            _make_room(self._folder)


def _write(folder: Path, name: str, payload: bytes) -> None:
    """Write a file whole or not at all."""
    handle, draft = tempfile.mkstemp(dir=folder)
    try:
        with os.fdopen(handle, "wb") as file:
            file.write(payload)
        Path(draft).replace(folder / name)
    except OSError:
        Path(draft).unlink(missing_ok=True)
        raise


def _make_room(folder: Path) -> None:
    """Remove the scenes that were used the longest time ago, above what may be kept."""
    scenes = [(path, path.stat()) for path in folder.iterdir() if DIGEST.fullmatch(path.name)]
    scenes.sort(key=lambda scene: scene[1].st_mtime_ns, reverse=True)
    size = 0
    for path, status in scenes:
        size += status.st_size
        if size > MAX_STORE_SIZE:
            path.unlink(missing_ok=True)


log = structlog.get_logger()

JOIN_SECONDS = 2.0  # How long an answer to a join is waited for
T = TypeVar("T")


@dataclass(frozen=True)
class JoinAnswered:
    """What came of a join."""

    job: str
    number: int
    """The join's."""
    answer: Joined | QdgraspError


@dataclass(frozen=True)
class SceneAnswered:
    """What came of looking for a scene."""

    job: str
    scene: str
    bundle: bytes | QdgraspError


RequestAnswered = JoinAnswered | SceneAnswered


class BackgroundRequests:
    """Runs errands, and reports each to `report`, from its thread."""

    def __init__(self, bus: Bus, bundles: SceneStore, report: Callable[[RequestAnswered], None]) -> None:
        self._bus = bus
        self._bundles = bundles
        self._report = report

    def join(self, job: str, join: Join) -> None:
        """Ask a coordinator to be let in."""

        def ask() -> Joined:
            payload = self._bus.ask(Keys(job).join, messages.encode(join), timeout=JOIN_SECONDS)
            return messages.decode(payload, Joined)

        self._go(lambda: JoinAnswered(job, join.number, _result_or_error(ask)))

    def fetch(self, job: str, scene: str) -> None:
        """Get a scene, from disk or from a coordinator."""
        self._go(
            lambda: SceneAnswered(
                job, scene, _result_or_error(lambda: self._bundles.bundle(self._bus, job, scene))
            )
        )

    def _go(self, errand: Callable[[], RequestAnswered]) -> None:
        threading.Thread(target=lambda: self._report(errand()), name="errand", daemon=True).start()


def _result_or_error(act: Callable[[], T]) -> T | QdgraspError:
    try:
        return act()
    except QdgraspError as error:
        return error
    except Exception as error:
        log.exception("an errand failed")
        return NoReply(f"{type(error).__name__}: {error}")


MAX_SCENES = 8
"""So many scenes are kept here; the one that came first goes first, and is looked for again if need be."""


class SceneCache:
    """Bundles by digest, on their way."""

    def __init__(self, errands: BackgroundRequests) -> None:
        self._errands = errands
        self._bundles: OrderedDict[str, bytes] = OrderedDict()
        self._sought: set[str] = set()

    def has(self, job: str, digest: str) -> bool:
        """Whether a scene is here; where it is not, it is being looked for now."""
        if digest not in self._bundles and digest not in self._sought:
            self._sought.add(digest)
            self._errands.fetch(job, digest)
        return digest in self._bundles

    def came(self, fetched: SceneAnswered) -> None:
        """Take what came of looking for a scene; what was not found is looked for again when it is needed."""
        self._sought.discard(fetched.scene)
        if isinstance(fetched.bundle, bytes):
            self._bundles[fetched.scene] = fetched.bundle
            if len(self._bundles) > MAX_SCENES:
                self._bundles.popitem(last=False)

    def take(self, digest: str) -> bytes:
        """A scene that is here, for the simulator."""
        return self._bundles.pop(digest)


@dataclass(frozen=True)
class CoordinatorSeen:
    """A coordinator's token appeared or vanished."""

    key: str
    is_alive: bool


@dataclass(frozen=True)
class LinkChanged:
    """A transport of this session came up or went down."""

    is_up: bool


@dataclass(frozen=True)
class StopRequested:
    """The process is asked to stop."""


Event = Sample | CoordinatorSeen | LinkChanged | StopRequested | RequestAnswered | SimulatorEvent
Inbox: TypeAlias = "SimpleQueue[Event]"
