"""State of the page as JSON: jobs, sent all the time, and curves, sent when asked for."""

import threading
import time
from collections import Counter
from typing import Protocol

import msgspec
from msgspec import Struct

from qdgrasp_coordinator.metrics.job_status import JobEvent, JobMeta, JobStatus, RunStatus, WorkerStatus
from qdgrasp_coordinator.metrics.run_stats import GrowthCurve
from qdgrasp_coordinator.monitor.job_view import JobView, Series
from qdgrasp_coordinator.monitor.prometheus import exposition
from qdgrasp_protocol.errors import UnknownName

FRESH_SECONDS = 0.2  # seconds in which what was seen is not looked at again
MOST_WORKERS = 512  # So many workers of a job are listed, those in trouble first; all are counted
MOST_RUNS = 256
"""So many runs of a job are listed: those in progress first, then those that were heard of last."""
URGENCY = ("stuck", "gone", "leaving", "working", "idle")  # The states of workers, those in trouble first


class PageFeed(Protocol):
    """Whatever knows jobs."""

    @property
    def is_linked(self) -> bool:
        """False while there is no way to the router."""

    @property
    def strangers(self) -> list[str]:
        """Jobs that are there and cannot be shown: they speak as another version of qdgrasp does."""

    def views(self) -> list[JobView]:
        """The jobs as they are now."""


class WorkersState(Struct, frozen=True, kw_only=True):
    """The workers of a job."""

    total: int
    states: dict[str, int]
    """How many are in which state."""
    workers: list[WorkerStatus]
    """At most `MOST_WORKERS` of them."""


class JobState(Struct, frozen=True, kw_only=True):
    """A job as the page is told of it twice a second."""

    job: str
    state: str
    silent: float
    """Seconds since its coordinator was heard."""
    speed: float
    """Counted evaluations per second lately."""
    left: str
    """The time left in words."""
    obstacle: str
    """What keeps it from going on, in words; empty: nothing does."""
    meta: JobMeta
    figures: JobStatus
    runs: list[RunStatus]
    """In progress, or ended while somebody watched; at most `MOST_RUNS`."""
    speeds: dict[str, float]
    """That of each run, by its name."""
    lefts: dict[str, str]
    """The time left of each run."""
    team: WorkersState
    events: list[JobEvent]

    @classmethod
    def of(cls, view: JobView) -> "JobState":
        """That of a job."""
        runs = view.foremost(MOST_RUNS)
        return cls(
            job=view.job,
            state=view.state,
            silent=view.silent,
            speed=_latest_speed(view.history),
            left=view.figures.left,
            obstacle=view.figures.obstacle,
            meta=view.meta,
            figures=view.figures,
            runs=runs,
            speeds={one.run: _latest_speed(view.histories[one.run]) for one in runs},
            lefts={one.run: one.left for one in runs},
            team=_workers_state(view.workers),
            events=view.events,
        )


class JobsState(Struct, frozen=True, kw_only=True):
    """What all browsers are told twice a second."""

    at: float
    """When, in seconds since 1970."""
    linked: bool
    """Whether there is a way to the router."""
    strangers: list[str]
    """Jobs that are there and speak as another version of qdgrasp does."""
    jobs: list[JobState]


class JobCurves(Struct, frozen=True, kw_only=True):
    """How a job and its runs came to be as they are."""

    history: Series
    histories: dict[str, Series]
    curves: dict[str, GrowthCurve]


class PageState:
    """What the page shows of the jobs that somebody knows."""

    def __init__(self, watched: PageFeed) -> None:
        self._watched = watched
        self._lock = threading.Lock()
        self._views: list[JobView] = []
        self._looked = float("-inf")

    def state(self) -> bytes:
        """All jobs as they are now (`JobsState`), as JSON in one line."""
        jobs = [JobState.of(view) for view in self.views()]
        linked, strangers = self._watched.is_linked, self._watched.strangers
        return msgspec.json.encode(JobsState(at=time.time(), linked=linked, strangers=strangers, jobs=jobs))

    def curves(self, job: str) -> bytes:
        """How a job and its runs came to be so (`Curves`), as JSON.

        Raises
        ------
        UnknownName
            There is no such job.
        """
        views = {view.job: view for view in self.views()}
        if job not in views:
            raise UnknownName("job", job, views)
        view = views[job]
        return msgspec.json.encode(
            JobCurves(history=view.history, histories=view.histories, curves=view.curves)
        )

    def metrics(self) -> tuple[bytes, str]:
        """The same for Prometheus, and its content type."""
        return exposition(self.views())

    def views(self) -> list[JobView]:
        """The jobs as they are now, or were a moment ago."""
        with self._lock:
            if time.monotonic() > self._looked + FRESH_SECONDS:
                self._views, self._looked = self._watched.views(), time.monotonic()
            return self._views


def _latest_speed(series: Series) -> float:
    return series.rate[-1] if series.rate else 0.0


def _workers_state(workers: list[WorkerStatus]) -> WorkersState:
    shown = sorted(workers, key=lambda worker: URGENCY.index(worker.state) if worker.state in URGENCY else 0)
    return WorkersState(
        total=len(workers),
        states=dict(Counter(worker.state for worker in workers)),
        workers=shown[:MOST_WORKERS] if len(workers) > MOST_WORKERS else workers,
    )
