"""Background tasks of a worker: asking to join, fetching scenes, building shapes.

Each task runs in a thread of its own, so that nothing waits for it; its end is reported from there. Scenes
are fetched by digest, checked, and kept on disk. The shape of an object is built in a process of its own
(`qdgrasp_assets.shape_builder`), from files that come over the bus: it looks into the store of this machine
first, has limits of its own, and may crash.
"""

import hashlib
import os
import resource
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import TypeVar

import msgspec
import structlog

from qdgrasp_assets.asset_paths import remove_unfinished, write_whole
from qdgrasp_protocol import messages
from qdgrasp_protocol.build_messages import MOST_PIECES, Build, Built, split_payload
from qdgrasp_protocol.bus import Bus, TooLarge, fetch_bundle
from qdgrasp_protocol.errors import BusError, MessageError, NoReply, QdgraspError
from qdgrasp_protocol.keys import DIGEST, Keys
from qdgrasp_protocol.messages import MAX_REASON, Join, Joined, shorten

log = structlog.get_logger()

MAX_STORE_SIZE = 2 << 30  # Size of all scenes on disk [bytes], at most
JOIN_SECONDS = 2.0  # Seconds to wait for the answer to a join
T = TypeVar("T")


class SceneStore:
    """Scene bundles by digest in a folder that other processes use too; None: they are not kept."""

    def __init__(self, folder: Path | None) -> None:
        self._folder = folder

    def bundle(self, bus: Bus, job: str, digest: str) -> bytes:
        """Return the bytes of a scene, from disk or from the job's coordinator (`fetch_bundle`)."""
        payload = None if self._folder is None else _read(self._folder / digest)
        if payload is None:
            payload = fetch_bundle(bus, job, digest)
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


class BackgroundRequests:
    """Asks coordinators, and reports each answer to `report`."""

    def __init__(
        self, bus: Bus, store: SceneStore, report: Callable[[JoinAnswered | SceneAnswered], None]
    ) -> None:
        self._bus = bus
        self._store = store
        self._report = report

    def join(self, job: str, join: Join) -> None:
        """Send a join to a job's coordinator."""

        def ask() -> Joined:
            payload = self._bus.ask(Keys(job).join, messages.encode(join), timeout=JOIN_SECONDS)
            return messages.decode(payload, Joined)

        start(lambda: self._report(JoinAnswered(job, join.number, result_or_error(ask))))

    def fetch(self, job: str, scene: str) -> None:
        """Get a scene, from disk or from a coordinator."""
        bundle = partial(self._store.bundle, self._bus, job, scene)
        start(lambda: self._report(SceneAnswered(job, scene, result_or_error(bundle))))


def start(act: Callable[[], None]) -> None:
    """Do something in a thread that ends with this process."""
    threading.Thread(target=act, name="background", daemon=True).start()


def result_or_error(act: Callable[[], T]) -> T | QdgraspError:
    """Return what a request returns, or why it failed."""
    try:
        return act()
    except QdgraspError as error:
        return error
    except Exception as error:
        log.exception("a request to a coordinator failed")
        return NoReply(f"{type(error).__name__}: {error}")


BUILDER = [sys.executable, "-m", "qdgrasp_assets.shape_builder"]
MOST_SECONDS = 6 * 3600.0
"""A builder is ended after this time by the clock [s]: it has its own limits of CPU time."""
UNUSABLE = 2
"""Exit code of a builder when no object can be made of the files."""


@dataclass(frozen=True)
class BuildEnded:
    """A builder has ended: with a shape, or with a reason why it has built none."""

    job: str
    build: Build
    shape: bytes = b""
    """The shape, packed; empty if it was not built."""
    reason: str = ""
    is_final: bool = False
    """True if no worker can build it."""
    cpu_seconds: float = 0.0

    def message(self, wid: str, key: bytes) -> Built:
        """Return the answer to the coordinator, by a worker."""
        pieces = split_payload(self.shape) if self.shape else ()
        is_large = len(pieces) > MOST_PIECES
        reason = f"its shape is larger than {MOST_PIECES} MiB, deflated" if is_large else self.reason
        return Built(
            epoch=self.build.epoch,
            batch=self.build.batch,
            attempt=self.build.attempt,
            wid=wid,
            key=key,
            pieces=() if is_large else pieces,
            reason=shorten(reason),
            is_final=self.is_final or is_large,
            cpu_seconds=self.cpu_seconds,
        )


@dataclass(eq=False)
class BuildAttempt:
    """One build, from its files to its end."""

    job: str
    build: Build
    process: subprocess.Popen[bytes] | None = field(default=None, init=False)
    is_stopped: bool = field(default=False, init=False)

    def stop(self) -> None:
        """End its process, now or as soon as it starts."""
        self.is_stopped = True
        if self.process is not None:
            self.process.kill()

    def run(self, bus: Bus, nice: int) -> BuildEnded:
        """Build; the end is an answer in every case."""
        try:
            with tempfile.TemporaryDirectory(prefix="qdgrasp-shape-") as folder:
                self._fetch(bus, Path(folder) / "files")
                return self._build(Path(folder), ["nice", "-n", str(nice)] if nice else [])
        except TooLarge as error:
            return BuildEnded(self.job, self.build, reason=str(error), is_final=True)
        except (BusError, MessageError) as error:
            return BuildEnded(self.job, self.build, reason=f"its files cannot be fetched: {error}")
        except (MemoryError, OSError) as error:
            why = getattr(error, "strerror", None) or error
            return BuildEnded(self.job, self.build, reason=f"it cannot be built here: {why}")

    def _fetch(self, bus: Bus, folder: Path) -> None:
        for file in self.build.task.files:
            path = folder / file.name
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(fetch_bundle(bus, self.job, file.sha256))

    def _build(self, folder: Path, nice: list[str]) -> BuildEnded:
        task, given, found = self.build.task, folder / "task.msgpack", folder / "shape.msgpack"
        given.write_bytes(msgspec.msgpack.encode(task))
        command = [*nice, *BUILDER, str(given), str(folder / "files"), str(found)]
        before = children_cpu_seconds()
        self.process = subprocess.Popen(
            command,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            start_new_session=True,
        )
        if self.is_stopped:
            self.process.kill()
        try:
            _, errors = self.process.communicate(timeout=MOST_SECONDS)
        except subprocess.TimeoutExpired:
            self.process.kill()
            _, errors = self.process.communicate()
        cpu_seconds, code = children_cpu_seconds() - before, self.process.returncode
        if code == 0:
            return BuildEnded(self.job, self.build, found.read_bytes(), cpu_seconds=cpu_seconds)
        said = " ".join(errors.decode(errors="replace").split())
        ended = f"it was ended by {signal.Signals(-code).name}" if code < 0 else f"exit code {code}"
        reason = said if code == UNUSABLE else said[-MAX_REASON:] or ended
        return BuildEnded(
            self.job, self.build, reason=reason, is_final=code == UNUSABLE, cpu_seconds=cpu_seconds
        )


def children_cpu_seconds() -> float:
    """CPU seconds of all child processes that have ended."""
    usage = resource.getrusage(resource.RUSAGE_CHILDREN)
    return usage.ru_utime + usage.ru_stime


class BuilderClient:
    """Builds one shape at a time; `report` takes the end of each."""

    def __init__(self, bus: Bus, report: Callable[[BuildEnded], None], nice: int = 0) -> None:
        self._bus = bus
        self._report = report
        self._nice = nice
        self._attempt: BuildAttempt | None = None

    @property
    def build(self) -> Build | None:
        """The build that is under way."""
        return self._attempt.build if self._attempt else None

    def start(self, job: str, build: Build) -> None:
        """Start to build; none may be under way."""
        self._attempt = attempt = BuildAttempt(job, build)
        start(lambda: self._report(attempt.run(self._bus, self._nice)))

    def on_ended(self, ended: BuildEnded) -> bool:
        """Note the end of a build; False if it was stopped before."""
        is_current = self.build is ended.build
        if is_current:
            self._attempt = None
        return is_current

    def stop(self) -> None:
        """End the build that is under way, if any."""
        if self._attempt:
            self._attempt.stop()
            self._attempt = None
