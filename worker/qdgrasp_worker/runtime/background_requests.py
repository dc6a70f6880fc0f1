"""Requests to coordinators in background threads: joins, and scene bundles with caches.

Each join and scene is requested in a thread, so that nothing waits for it. Scene bundles are fetched by
digest, checked, kept on disk, and kept in memory until the simulator has them.
"""

import hashlib
import os
import threading
import time
from collections import OrderedDict
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TypeVar

import structlog

from qdgrasp_assets.asset_paths import remove_unfinished, write_whole
from qdgrasp_protocol import bundle_transfer, messages
from qdgrasp_protocol.bus import Bus
from qdgrasp_protocol.errors import NoReply, QdgraspError
from qdgrasp_protocol.keys import DIGEST, Keys
from qdgrasp_protocol.messages import Join, Joined

MAX_STORE_SIZE = 2 << 30  # Size of all scenes on disk [bytes], at most


class SceneStore:
    """Scene bundles by digest in a folder that other processes use too; None: they are not kept."""

    def __init__(self, folder: Path | None) -> None:
        self._folder = folder

    def bundle(self, bus: Bus, job: str, digest: str) -> bytes:
        """Return the bytes of a scene, from disk or from the job's coordinator (`fetch_bundle`)."""
        payload = None if self._folder is None else _read(self._folder / digest)
        if payload is None:
            payload = bundle_transfer.fetch_bundle(bus, job, digest)
            if self._folder is not None:
                with suppress(OSError):  # a cache that cannot be written is only slower
                    write_whole(self._folder / digest, payload)
                    _make_room(self._folder)
        return payload


def _read(path: Path) -> bytes | None:
    """The bundle in a file named by its digest; None: there is no such file, or it is damaged."""
    with suppress(OSError):
        payload = path.read_bytes()
        if hashlib.sha256(payload).hexdigest() == path.name:
            with suppress(OSError):  # the folder may belong to others
                os.utime(path)
            return payload
    return None


def _make_room(folder: Path) -> None:
    """Remove the least recently used scenes above the size limit, and unfinished files."""
    remove_unfinished(folder, time.time())
    scenes = [(path, path.stat()) for path in folder.iterdir() if DIGEST.fullmatch(path.name)]
    scenes.sort(key=lambda scene: scene[1].st_mtime_ns, reverse=True)
    size = 0
    for path, status in scenes:
        size += status.st_size
        if size > MAX_STORE_SIZE:
            path.unlink(missing_ok=True)


log = structlog.get_logger()

JOIN_SECONDS = 2.0  # Seconds to wait for the answer to a join
T = TypeVar("T")


@dataclass(frozen=True)
class JoinAnswered:
    """The answer to a join, or the error in its place."""

    job: str
    number: int
    answer: Joined | QdgraspError


@dataclass(frozen=True)
class SceneAnswered:
    """A scene's bundle, or the error in its place."""

    job: str
    scene: str
    bundle: bytes | QdgraspError


RequestAnswered = JoinAnswered | SceneAnswered


class BackgroundRequests:
    """Carries out requests in threads, and reports each answer to `report` from its thread."""

    def __init__(self, bus: Bus, store: SceneStore, report: Callable[[RequestAnswered], None]) -> None:
        self._bus = bus
        self._store = store
        self._report = report

    def join(self, job: str, join: Join) -> None:
        """Send a join to a job's coordinator."""

        def ask() -> Joined:
            payload = self._bus.ask(Keys(job).join, messages.encode(join), timeout=JOIN_SECONDS)
            return messages.decode(payload, Joined)

        self._start(ask, lambda answer: JoinAnswered(job, join.number, answer))

    def fetch(self, job: str, scene: str) -> None:
        """Get a scene, from disk or from a coordinator."""
        bundle = partial(self._store.bundle, self._bus, job, scene)
        self._start(bundle, lambda answer: SceneAnswered(job, scene, answer))

    def _start(self, act: Callable[[], T], answered: Callable[[T | QdgraspError], RequestAnswered]) -> None:
        def request() -> None:
            self._report(answered(_result_or_error(act)))

        threading.Thread(target=request, name="request", daemon=True).start()


def _result_or_error(act: Callable[[], T]) -> T | QdgraspError:
    try:
        return act()
    except QdgraspError as error:
        return error
    except Exception as error:
        log.exception("a request to a coordinator failed")
        return NoReply(f"{type(error).__name__}: {error}")


MAX_SCENES = 8  # Scenes kept in memory; the oldest is dropped first, and requested again if needed


class SceneCache:
    """Scene bundles by digest, in memory until the simulator takes them."""

    def __init__(self, requests: BackgroundRequests) -> None:
        self._requests = requests
        self._bundles: OrderedDict[str, bytes] = OrderedDict()
        self._requested: set[str] = set()

    def has_or_request(self, job: str, digest: str) -> bool:
        """Return whether a scene is here; if it is not, it is requested now."""
        if digest not in self._bundles and digest not in self._requested:
            self._requested.add(digest)
            self._requests.fetch(job, digest)
        return digest in self._bundles

    def on_answer(self, answered: SceneAnswered) -> None:
        """Take a scene; one that was not found is requested again when it is needed."""
        self._requested.discard(answered.scene)
        if isinstance(answered.bundle, bytes):
            self._bundles[answered.scene] = answered.bundle
            if len(self._bundles) > MAX_SCENES:
                self._bundles.popitem(last=False)

    def pop(self, digest: str) -> bytes:
        """Return a scene that is here, and forget it."""
        return self._bundles.pop(digest)
