"""Publishes the status of a job, and answers late comers who ask (docs/bus.md).

What that costs does not depend on how many watch, or ask. The cache of what was shown last is filled by the
coordinator's one thread and read in threads of the bus.
"""

import os
import socket
import threading
import time
from collections.abc import Callable, Container, Mapping
from datetime import UTC, datetime
from importlib.metadata import version

import msgspec
from msgspec import Struct

from qdgrasp_coordinator.metrics.job_status import EventLog, JobEvent, JobMeta, JobStatus, RunStatus, to_json
from qdgrasp_coordinator.metrics.run_stats import GrowthCurve
from qdgrasp_coordinator.scheduler.job_scheduler import JobScheduler
from qdgrasp_coordinator.scheduler.run_registry import RunRegistry
from qdgrasp_protocol.bus import Bus, Channel, Query
from qdgrasp_protocol.errors import NoReply
from qdgrasp_protocol.keys import Keys, last_chunk, matches

CURVE_SECONDS = 0.5  # Seconds for which curves are cached, however many queries come
STALE_SECONDS = 5.0  # Seconds without an update after which queries go unanswered: the coordinator hangs

CurveSource = Callable[[], Mapping[str, Struct]]
"""Returns the curves by key; called in any thread."""


class StatusCache:
    """Latest published values by key, and curves that are made when asked for.

    Parameters
    ----------
    clock
        The time [s].
    """

    def __init__(self, curves: CurveSource, clock: Callable[[], float] = time.monotonic) -> None:
        self._curves = curves
        self._clock = clock
        self._shown: dict[str, bytes] = {}  # read in other threads as a copy, which nobody interrupts
        self._filled_at = clock()
        self._drawing = threading.Lock()
        self._drawn: dict[str, bytes] = {}
        self._drawn_until = 0.0

    def fill(self, key: str, payload: bytes) -> None:
        """Store the value of a key."""
        self._shown[key] = payload
        self._filled_at = self._clock()

    def keep(self, pattern: str, names: Container[str]) -> None:
        """Remove the keys of a pattern whose last chunk is not among these names."""
        for key in [key for key in self._shown if matches(pattern, key)]:
            if last_chunk(key) not in names:
                del self._shown[key]

    def values(self, query: Query) -> dict[str, bytes]:
        """Return the values whose keys match; curves only if the pattern has `/curve/` in it.

        Raises
        ------
        NoReply
            Nothing was shown for a while.
        """
        if self._clock() > self._filled_at + STALE_SECONDS:
            raise NoReply(f"Nothing was shown for {STALE_SECONDS:g} s.")
        known = self._shown.copy() | (self._draw() if "/curve/" in query.key else {})
        return {key: payload for key, payload in known.items() if matches(query.key, key)}

    def _draw(self) -> dict[str, bytes]:
        """Return all curves, at most `DRAWN` seconds old."""
        with self._drawing:
            if self._clock() >= self._drawn_until:
                self._drawn = {key: to_json(curve) for key, curve in self._curves().items()}
                self._drawn_until = self._clock() + CURVE_SECONDS
            return self._drawn


STATUS_INTERVAL = 0.5  # seconds between two publications of the figures
WORKERS_INTERVAL = 1.0  # seconds between two of the workers', unless somebody's state has changed


class StatusPublisher:
    """Publishes the status of a job on the bus.

    Parameters
    ----------
    lanes
        Its active runs.
    turn
        Returns the scheduler of the present epoch.
    clock
        The time for the status cache [s].
    """

    def __init__(
        self,
        bus: Bus,
        job: str,
        lanes: RunRegistry,
        turn: Callable[[], JobScheduler],
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self.chronicle = EventLog(self._publish_event)
        """Log of events."""
        self.display = StatusCache(self._curves, clock)
        """Latest values, for late queries."""
        self.is_cancelled = False
        """True if the job ends before it is done: it was cancelled, or its time is over."""
        self._bus = bus
        self._job = job
        self._keys = Keys(job)
        self._lanes = lanes
        self._turn = turn
        self._identity = ""
        self._since = datetime.now(UTC).replace(microsecond=0)
        self._recorders: set[str] = set()
        self.due = 0.0
        """When figures are to be published again."""
        self._team_due = 0.0
        self._states: list[str] = []
        self._obstacle = ""

    def token_changed(self, key: str, alive: bool) -> None:
        """Log that a recorder appeared or vanished."""
        who = last_chunk(key)
        if key == self._keys.recorder_token(who) and alive != (who in self._recorders):
            (self._recorders.add if alive else self._recorders.discard)(who)
            words = "A recorder is there." if alive else "The recorder is gone; what is found waits for one."
            self.chronicle.note("recorder", words)

    def figures(self, now: float) -> JobStatus:
        """Return the job's figures."""
        turn = self._turn()
        found = self._lanes.figures(self._job, turn.dispatch.workers, now)
        return msgspec.structs.replace(
            found,
            state="cancelled" if self.is_cancelled else scheduler_state(turn),
            recorders=len(self._recorders),
            requeued=turn.dispatch.counters["requeued"],
            strays=turn.dispatch.strays,
        )

    def open(self, now: float) -> None:
        """Publish a first status, before any query."""
        self.display.fill(self._keys.meta, to_json(self._meta))
        self.publish(now)

    def publish_meta(self, identity: str) -> None:
        """Publish the job's metadata as an epoch begins, with its identity from the recorder."""
        self._identity = identity
        self._put(self._keys.meta, self._meta)

    def publish_due(self, now: float) -> None:
        """Publish the figures if they are due."""
        if now >= self.due:
            self.publish(now)

    def publish(self, now: float) -> None:
        """Publish the figures of job, runs and workers."""
        self.due = now + STATUS_INTERVAL
        runs = [lane.figures(self._turn().dispatch.workers, now) for lane in self._lanes]
        self.display.keep(self._keys.stat("run/*"), {run.run for run in runs})
        for run in runs:
            self.publish_run(run)
        figures = self.figures(now)
        self._note_trouble(figures)
        self._put(self._keys.stat("job"), figures)
        self._publish_team(now)

    def publish_run(self, figures: RunStatus) -> None:
        """Publish the figures of a run."""
        self._put(self._keys.stat(f"run/{figures.run}"), figures)

    def _publish_team(self, now: float) -> None:
        """Publish the workers, at intervals and when a state has changed."""
        states = [f"{member.wid} {member.state}" for member in self._turn().dispatch.members]
        if now < self._team_due and states == self._states:
            return
        self._team_due, self._states = now + WORKERS_INTERVAL, states
        pages = self._turn().crew.pages(now)
        self.display.keep(self._keys.stat("team/*"), {str(page.page) for page in pages})
        for page in pages:
            self._put(self._keys.stat(f"team/{page.page}"), page)

    def _publish_event(self, event: JobEvent) -> None:
        self._send(self._keys.event(event.kind), to_json(event))
        self.display.fill(self._keys.recent, to_json(self.chronicle.latest))

    def _note_trouble(self, figures: JobStatus) -> None:
        """Log that an obstacle appeared or was cleared."""
        if figures.obstacle != self._obstacle:
            over = f"It goes on; this is over: {self._obstacle}"
            self.chronicle.note("trouble", figures.obstacle or over)
            self._obstacle = figures.obstacle

    @property
    def _meta(self) -> JobMeta:
        return JobMeta(
            job=self._job,
            epoch=self._turn().epoch,
            since=self._since,
            host=socket.gethostname(),
            pid=os.getpid(),
            version=version("qdgrasp"),
            runs=self._lanes.extent.runs,
            budget=self._lanes.extent.evaluations,
            identity=self._identity,
        )

    def _curves(self) -> dict[str, GrowthCurve]:
        """Return the curves of active runs by key; in any thread."""
        return {self._keys.stat(f"curve/{lane.run}"): lane.curve for lane in self._lanes}

    def _put(self, key: str, shown: Struct) -> None:
        """Publish a value and store it for late queries."""
        payload = to_json(shown)
        self.display.fill(key, payload)
        self._send(key, payload)

    def _send(self, key: str, payload: bytes) -> None:
        self._bus.put(key, payload, encoding="application/json", channel=Channel.MONITOR)


def scheduler_state(turn: JobScheduler) -> str:
    """Return the job's state: starting, running, paused or ending."""
    states = {"ending": turn.is_ending, "paused": turn.is_paused, "starting": not turn.epoch}
    return next((state for state, holds in states.items() if holds), "running")
