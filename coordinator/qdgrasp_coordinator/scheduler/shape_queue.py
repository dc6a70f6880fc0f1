"""Builds: shapes of objects that workers build before the runs that need them are opened.

A build is leased like a batch (docs/bus.md, rules 1 to 6), and a worker that holds one gets nothing else.
"""

import secrets
from collections import deque
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path

from qdgrasp_protocol.build_messages import Build, Built, ShapeTask


@dataclass(frozen=True)
class WantedShape:
    """A shape that is not built yet, and the mesh that it is made of."""

    task: ShapeTask
    mesh: Path

    @property
    def paths(self) -> dict[str, Path]:
        """Its files by sha256: the mesh, and those that it names beside it."""
        mesh, *others = self.task.files
        return {mesh.sha256: self.mesh} | {file.sha256: self.mesh.parent / file.name for file in others}


@dataclass(frozen=True, eq=False)
class ShapeBuild:
    """A shape that one worker is to build."""

    id: bytes
    """16 bytes: random ones of the epoch and a counter, not used again in the job."""
    task: ShapeTask
    failed_by: frozenset[str] = frozenset()
    """Workers on which it failed."""


@dataclass(frozen=True)
class BuildLease:
    """A build leased to a worker."""

    wid: str
    join: int
    """The worker's join number; the worker drops what it was sent for an older one."""
    attempt: int
    """Counts the leases of this build, from 1."""
    build: ShapeBuild

    def message(self, epoch: int) -> Build:
        """Return the message to the worker."""
        return Build(
            epoch=epoch, batch=self.build.id, attempt=self.attempt, join=self.join, task=self.build.task
        )


@dataclass(frozen=True)
class BuildReply:
    """The end of a build: its shape, or the reason why it cannot be built."""

    key: str
    """The task's."""
    pieces: tuple[bytes, ...] = ()
    """The deflated shape; empty if it cannot be built."""
    reason: str = ""
    cpu_seconds: float = 0.0
    superseded: tuple[str, ...] = ()
    """Other holders of the build, which are to drop it."""

    @classmethod
    def of(cls, build: ShapeBuild, built: Built, superseded: tuple[str, ...]) -> "BuildReply":
        """Return the end of a build that a worker has answered."""
        return cls(build.task.key, built.pieces, built.reason, built.cpu_seconds, superseded)


class ShapeQueue:
    """Builds that wait for a worker, in the order in which their runs come."""

    def __init__(self) -> None:
        self._prefix = secrets.token_bytes(8)
        self._count = 0
        self._waiting: deque[ShapeBuild] = deque()

    def __iter__(self) -> Iterator[ShapeBuild]:
        return iter(self._waiting)

    def __len__(self) -> int:
        return len(self._waiting)

    def submit(self, tasks: Iterable[ShapeTask]) -> None:
        """Take shapes that were never leased."""
        self._waiting.extend(ShapeBuild(self._new_id(), task) for task in tasks)

    def pop(self, wid: str, code: str) -> ShapeBuild | None:
        """Return the next build for a worker with this building code; None: no such build."""
        for build in self._waiting:
            if code and build.task.code == code and wid not in build.failed_by:
                self._waiting.remove(build)
                return build
        return None

    def requeue(self, build: ShapeBuild) -> None:
        """Have a build leased again, before any other."""
        self._waiting.appendleft(build)

    def requeue_failed(self, build: ShapeBuild, wid: str) -> None:
        """Have a build that failed on a worker tried on another one, as another build."""
        self.requeue(replace(build, failed_by=build.failed_by | {wid}, id=self._new_id()))

    def remove(self, build: ShapeBuild) -> None:
        """Forget a build that was queued again, if it still waits."""
        if build in self._waiting:
            self._waiting.remove(build)

    def _new_id(self) -> bytes:
        self._count += 1
        return self._prefix + self._count.to_bytes(8)

    def clear(self) -> None:
        """Forget all builds that wait."""
        self._waiting.clear()
