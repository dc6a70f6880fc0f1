"""Builds the shape of an object in a process of its own, from files that come over the bus.

The process (`qdgrasp_assets.shape_builder`) looks into the store of this machine first, keeps to the task's
limits, and may crash. A thread waits for it, and reports its end.
"""

import os
import signal
import subprocess
import sys
import tempfile
import threading
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import msgspec

from qdgrasp_protocol import bundle_transfer
from qdgrasp_protocol.build_messages import MOST_PIECES, Build, Built, ShapeTask, split_payload
from qdgrasp_protocol.bus import Bus
from qdgrasp_protocol.errors import BusError, MessageError
from qdgrasp_protocol.messages import MAX_REASON, shorten

BUILDER = [sys.executable, "-m", "qdgrasp_assets.shape_builder"]
WALL_FACTOR, WALL_MARGIN = 30.0, 600.0
"""A builder is ended after this multiple of the task's CPU seconds, plus a margin: it has its own limit."""
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
    """Builds one shape at a time; `report` takes the end of each, in a thread of its own."""

    def __init__(self, bus: Bus, report: Callable[[BuildEnded], None], nice: int = 0) -> None:
        self._bus = bus
        self._report = report
        self._nice = nice
        self._attempt: _Attempt | None = None

    @property
    def build(self) -> Build | None:
        """The build that is under way."""
        return self._attempt.build if self._attempt else None

    def start(self, job: str, build: Build) -> None:
        """Start to build; none may be under way."""
        self._attempt = attempt = _Attempt(job, build)

        def run() -> None:
            self._report(attempt.run(self._bus, self._nice))

        threading.Thread(target=run, name="builder", daemon=True).start()

    def on_ended(self, ended: BuildEnded) -> bool:
        """Note the end of a build; False if it was stopped before."""
        is_current = self.build is ended.build
        if is_current:
            self._attempt = None
        return is_current

    def stop(self) -> None:
        """End the build that is under way, if any."""
        if self._attempt:
            self._attempt.kill()
            self._attempt = None


class _Attempt:
    """One build, from its files to its end."""

    def __init__(self, job: str, build: Build) -> None:
        self.job = job
        self.build = build
        self._lock = threading.Lock()
        self._process: subprocess.Popen[bytes] | None = None
        self._is_killed = False

    def kill(self) -> None:
        """End its process, now or before it starts."""
        with self._lock:
            self._is_killed = True
            if self._process is not None and self._process.returncode is None:
                os.kill(self._process.pid, signal.SIGKILL)  # `Popen.kill` would reap it if it has ended

    def run(self, bus: Bus, nice: int) -> BuildEnded:
        """Build; the end is an answer in every case."""
        task = self.build.task
        try:
            with tempfile.TemporaryDirectory(prefix="qdgrasp-shape-") as folder:
                self._fetch(bus, task, Path(folder) / "files")
                return self._build(task, Path(folder), nice)
        except bundle_transfer.TooLarge as error:
            return BuildEnded(self.job, self.build, reason=str(error), is_final=True)
        except (BusError, MessageError) as error:
            return BuildEnded(self.job, self.build, reason=f"its files cannot be fetched: {error}")
        except (RuntimeError, MemoryError, OSError) as error:  # no thread, or no room for one
            self.kill()
            why = getattr(error, "strerror", None) or error
            return BuildEnded(self.job, self.build, reason=f"it cannot be built here: {why}")

    def _fetch(self, bus: Bus, task: ShapeTask, folder: Path) -> None:
        for file in task.files:
            path = folder / file.name
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(bundle_transfer.fetch_bundle(bus, self.job, file.sha256))

    def _build(self, task: ShapeTask, folder: Path, nice: int) -> BuildEnded:
        given, found = folder / "task.msgpack", folder / "shape.msgpack"
        given.write_bytes(msgspec.msgpack.encode(task))
        command = [*BUILDER, str(given), str(folder / "files"), str(found)]
        with tempfile.TemporaryFile() as errors:
            with self._lock:
                if self._is_killed:
                    return BuildEnded(self.job, self.build, reason="it was stopped")
                self._process = process = subprocess.Popen(
                    ["nice", "-n", str(nice), *command] if nice else command,
                    stdin=subprocess.DEVNULL,
                    stdout=subprocess.DEVNULL,
                    stderr=errors,
                    start_new_session=True,
                )
            limit = threading.Timer(WALL_FACTOR * task.seconds + WALL_MARGIN, self.kill)
            limit.start()
            try:
                _, status, usage = os.wait4(process.pid, 0)
            finally:
                limit.cancel()
            with self._lock:
                process.returncode = code = os.waitstatus_to_exitcode(status)
            errors.seek(0)
            said = " ".join(errors.read().decode(errors="replace").split())
        cpu_seconds = usage.ru_utime + usage.ru_stime
        if code == 0:
            return BuildEnded(self.job, self.build, found.read_bytes(), cpu_seconds=cpu_seconds)
        ended = f"it was ended by {signal.Signals(-code).name}" if code < 0 else f"exit code {code}"
        reason = said if code == UNUSABLE else said[-MAX_REASON:] or ended
        return BuildEnded(
            self.job, self.build, reason=reason, is_final=code == UNUSABLE, cpu_seconds=cpu_seconds
        )
