"""Background tasks of a worker: asking to join, fetching scenes, building shapes.

Each task runs in a thread of its own, so that nothing waits for it; its end is reported from there. The shape
of an object is built in a process of its own
(`qdgrasp_assets.shape_builder`), from files that come over the bus: it looks into the store of this machine
first, has limits of its own, and may crash.
"""

import resource
import signal
import subprocess
import sys
import tempfile
import threading
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TypeVar

import msgspec
import structlog

from qdgrasp_protocol import messages
from qdgrasp_protocol.build_messages import MOST_PIECES, Build, Built, split_payload
from qdgrasp_protocol.bus import Bus, TooLarge, fetch_bundle
from qdgrasp_protocol.errors import NoReply, QdgraspError
from qdgrasp_protocol.keys import Keys
from qdgrasp_protocol.messages import MAX_REASON, Join, Joined, shorten

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


class BackgroundRequests:
    """Asks coordinators, and reports each answer to `report`."""

    def __init__(self, bus: Bus, report: Callable[[JoinAnswered | SceneAnswered], None]) -> None:
        self._bus = bus
        self._report = report

    def join(self, job: str, join: Join) -> None:
        """Send a join to a job's coordinator."""

        def ask() -> Joined:
            payload = self._bus.ask(Keys(job).join, messages.encode(join), timeout=JOIN_SECONDS)
            return messages.decode(payload, Joined)

        start(lambda: self._report(JoinAnswered(job, join.number, result_or_error(ask))))

    def fetch(self, job: str, scene: str) -> None:
        """Get a scene from a coordinator."""
        bundle = partial(fetch_bundle, self._bus, Keys(job).asset(scene))
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


class BuilderClient:
    """Builds one shape at a time; `report` takes the end of each, an answer in every case."""

    def __init__(self, bus: Bus, report: Callable[[BuildEnded], None], nice: int = 0) -> None:
        self._bus = bus
        self._report = report
        self._nice = ["nice", "-n", str(nice)] if nice else []
        self._processes: set[subprocess.Popen[bytes]] = set()
        self.build: Build | None = None
        """The build that is under way."""

    def start(self, job: str, build: Build) -> None:
        """Start to build; none may be under way."""
        self.build = build
        start(lambda: self._report(self._run(job, build)))

    def on_ended(self, ended: BuildEnded) -> bool:
        """Note the end of a build; False if it was stopped before."""
        is_current = self.build is ended.build
        if is_current:
            self.build = None
        return is_current

    def stop(self) -> None:
        """End the build that is under way, if any."""
        self.build = None
        for process in list(self._processes):
            process.kill()

    def _run(self, job: str, build: Build) -> BuildEnded:
        """Build; final if no worker can have the files."""
        try:
            with tempfile.TemporaryDirectory(prefix="qdgrasp-shape-") as folder:
                for file in build.task.files:
                    path = Path(folder) / "files" / file.name
                    path.parent.mkdir(parents=True, exist_ok=True)
                    path.write_bytes(fetch_bundle(self._bus, Keys(job).asset(file.sha256)))
                return self._build(job, build, Path(folder))
        except (QdgraspError, MemoryError, OSError) as error:
            reason = str(getattr(error, "strerror", None) or error)
            return BuildEnded(job, build, reason=reason, is_final=isinstance(error, TooLarge))

    def _build(self, job: str, build: Build, folder: Path) -> BuildEnded:
        given, found = folder / "task.msgpack", folder / "shape.msgpack"
        given.write_bytes(msgspec.msgpack.encode(build.task))
        command = [*self._nice, *BUILDER, str(given), str(folder / "files"), str(found)]
        before = children_cpu_seconds()
        code, errors = self._wait(build, command)
        cpu_seconds = children_cpu_seconds() - before
        if code == 0:
            return BuildEnded(job, build, found.read_bytes(), cpu_seconds=cpu_seconds)
        said = " ".join(errors.decode(errors="replace").split())
        ended = f"it was ended by {signal.Signals(-code).name}" if code < 0 else f"exit code {code}"
        reason = said if code == UNUSABLE else said[-MAX_REASON:] or ended
        return BuildEnded(job, build, reason=reason, is_final=code == UNUSABLE, cpu_seconds=cpu_seconds)

    def _wait(self, build: Build, command: list[str]) -> tuple[int, bytes]:
        """Exit code and errors of a builder, killed if its build is stopped."""
        quiet, pipe = subprocess.DEVNULL, subprocess.PIPE
        process = subprocess.Popen(command, stdin=quiet, stdout=quiet, stderr=pipe, start_new_session=True)
        self._processes.add(process)
        if self.build is not build:
            process.kill()
        _, errors = process.communicate()
        self._processes.discard(process)
        return process.returncode, errors


def children_cpu_seconds() -> float:
    """CPU seconds of all child processes that have ended."""
    usage = resource.getrusage(resource.RUSAGE_CHILDREN)
    return usage.ru_utime + usage.ru_stime
