"""Publishes the status of a job, and answers late comers who ask (docs/bus.md).

Its cost does not depend on how many watch, or ask. The cache of the latest values is filled by the
coordinator's one thread and read in threads of the bus.
"""

import os
import socket
import time
from collections.abc import Callable, Container
from datetime import UTC, datetime
from importlib.metadata import version

from msgspec import Struct

from qdgrasp_coordinator.metrics.job_status import JobEvent, JobMeta, to_json
from qdgrasp_coordinator.scheduler.job_scheduler import JobScheduler
from qdgrasp_coordinator.scheduler.run_registry import ActiveRun
from qdgrasp_protocol.bus import Bus, Channel, Query
from qdgrasp_protocol.errors import NoReply
from qdgrasp_protocol.keys import Keys, last_chunk, matches

STALE_SECONDS = 5.0  # Seconds without an update after which queries go unanswered


class StatusCache:
    """Latest published values by key."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._shown: dict[str, bytes] = {}  # read in other threads as a copy made at once
        self._filled_at = clock()

    def set(self, key: str, payload: bytes) -> None:
        """Store the value of a key."""
        self._shown[key] = payload
        self._filled_at = self._clock()

    def retain(self, pattern: str, names: Container[str]) -> None:
        """Remove the keys of a pattern whose last chunk is not among these names."""
        for key in [key for key in self._shown if matches(pattern, key)]:
            if last_chunk(key) not in names:
                del self._shown[key]

    def answer(self, query: Query) -> dict[str, bytes]:
        """Return the values whose keys match.

        Raises NoReply if nothing was shown for a while: the coordinator hangs.
        """
        if self._clock() > self._filled_at + STALE_SECONDS:
            raise NoReply(f"Nothing was shown for {STALE_SECONDS:g} s.")
        return {key: payload for key, payload in self._shown.copy().items() if matches(query.key, key)}


STATUS_INTERVAL = 0.5  # seconds between two publications of the figures
RUNS_AT_ONCE = 256  # Most runs whose figures are published at once; more take turns


class StatusPublisher:
    """Publishes the status of a job on the bus."""

    def __init__(self, bus: Bus, scheduler: JobScheduler) -> None:
        self.cache = StatusCache()  # Latest values, for late queries
        self.due = 0.0  # When figures are to be published again
        self._bus = bus
        self._scheduler = scheduler
        self._keys = Keys(scheduler.job)
        self._identity = ""
        self._since = datetime.now(UTC).replace(microsecond=0)
        self._next_run = 0
        self._obstacle = ""

    def open(self, now: float) -> None:
        """Publish a first status, before any query."""
        self.cache.set(self._keys.meta, to_json(self._meta))
        self.publish(now)

    def publish_meta(self, identity: str) -> None:
        """Publish the job's metadata as an epoch begins, with its identity from the recorder."""
        self._identity = identity
        self._put(self._keys.meta, self._meta)

    def publish(self, now: float) -> None:
        """Publish the figures of job, runs and workers."""
        self.due = now + STATUS_INTERVAL
        runs = list(self._scheduler.runs)
        self.cache.retain(self._keys.stat("run/*"), {run.name for run in runs})
        first = self._next_run % max(1, len(runs))
        self._next_run = first + RUNS_AT_ONCE
        for run in (runs + runs)[first : first + min(len(runs), RUNS_AT_ONCE)]:
            self.publish_run(run, now)
        status = self._scheduler.status(now)
        if status.obstacle != self._obstacle:
            over = f"It goes on; this is over: {self._obstacle}"
            self._scheduler.events.note("trouble", status.obstacle or over)
            self._obstacle = status.obstacle
        self._put(self._keys.stat("job"), status)
        self._publish_workers(now)

    def publish_run(self, run: ActiveRun, now: float) -> None:
        """Publish the figures of a run."""
        self._put(self._keys.stat(f"run/{run.name}"), run.status(len(self._scheduler.workers), now))

    def publish_event(self, event: JobEvent) -> None:
        """Publish an event that was just logged."""
        self._send(self._keys.event(event.kind), to_json(event))
        self.cache.set(self._keys.recent, to_json(self._scheduler.events.latest))

    def _publish_workers(self, now: float) -> None:
        """Publish the workers."""
        pages = self._scheduler.workers.pages(now)
        self.cache.retain(self._keys.stat("team/*"), {str(page.page) for page in pages})
        for page in pages:
            self._put(self._keys.stat(f"team/{page.page}"), page)

    @property
    def _meta(self) -> JobMeta:
        extent = self._scheduler.runs.extent
        return JobMeta(
            job=self._scheduler.job,
            epoch=self._scheduler.epoch,
            since=self._since,
            host=socket.gethostname(),
            pid=os.getpid(),
            version=version("qdgrasp"),
            runs=extent.runs,
            budget=extent.evaluations,
            identity=self._identity,
        )

    def _put(self, key: str, shown: Struct) -> None:
        """Publish a value and store it for late queries."""
        payload = to_json(shown)
        self.cache.set(key, payload)
        self._send(key, payload)

    def _send(self, key: str, payload: bytes) -> None:
        self._bus.put(key, payload, encoding="application/json", channel=Channel.MONITOR)
