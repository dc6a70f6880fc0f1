"""The runs of a job in progress: opened and replayed when needed, let go when done.

The loader makes the next run ready in a thread of its own: the replay of a journal may take seconds, and so
may a scene that no worker builds; results go on being settled meanwhile. The runs are handed over through
the scheduler's inbox. Shapes that runs wait for are built by workers, some ahead of their runs.
"""

import threading
import time
from collections.abc import Callable, Collection, Iterator
from dataclasses import dataclass, replace
from itertools import islice
from pathlib import Path
from typing import Any

from msgspec import structs

from qdgrasp_assets.scene import Bundle
from qdgrasp_coordinator.metrics.job_status import JobStatus, RunListing, RunStatus
from qdgrasp_coordinator.metrics.run_stats import RunCounter
from qdgrasp_coordinator.scheduler.batch_queue import RunRef
from qdgrasp_coordinator.scheduler.recorder_client import RowSink
from qdgrasp_coordinator.scheduler.run_plan import (
    BuildReply,
    RunPlan,
    RunQueue,
    ShapesMissing,
    WantedShape,
    WantedShapes,
)
from qdgrasp_protocol.errors import DiskFull, EndedEarly, InputError, RunFailed, RunsFailed
from qdgrasp_protocol.messages import Opened
from qdgrasp_protocol.process import Stop


class ActiveRun:
    """A run from its opening at the recorder to its last durable row."""

    def __init__(self, plan: RunPlan, sink: RowSink) -> None:
        self.name = plan.run
        self.plan = plan
        self.pipeline = plan.pipeline
        self.sink = sink
        self.ref = RunRef(plan.run, plan.bundle.digest, plan.prior, plan.spec.engine)
        self.replayed = 0  # Counted evaluations that were in the journal when the run was opened
        self.excluded: frozenset[str] = frozenset()  # Workers whose rows were taken back then
        self._began = time.monotonic()

    def open(self, epoch: int, wait: Callable[[], None], excluded: Collection[str] = ()) -> Opened:
        """Open the run and replay its journal into its search, checked bit for bit.

        In epoch 0 the recorder issues a new one, and it takes the rows of `excluded` workers back. `wait` is
        called between two requests; it may raise to end them. Raises InputError if the recorder refuses the
        run, or its spec does not replay to its journal.
        """
        self.excluded = frozenset(excluded)
        request = structs.replace(self.plan.open_request, excluded=sorted(excluded))
        opened = self.sink.open(request, epoch, wait)
        position, durable = 0, opened.durable[0]
        while position < durable:
            recorded = self.sink.recorded_rows(position, wait)
            if not len(recorded):
                raise EndedEarly(f"The recorder has {durable} rows but shows none from {position} on.")
            self.pipeline.replay(recorded.rows)
            position = recorded.stop
            self.replayed = self.tally.evaluations
        return opened

    @property
    def tally(self) -> RunCounter:
        """Counts of its journal's rows."""
        return self.pipeline.tally

    @property
    def remaining(self) -> int:
        """Counted evaluations that it may still take; 0 once it is over."""
        return 0 if self.pipeline.finished else max(0, self.tally.left)

    @property
    def trials_left(self) -> int:
        """Trials of its successes so far that are to come; 0 once it is over."""
        return 0 if self.pipeline.finished else self.tally.trials_left

    @property
    def is_done(self) -> bool:
        """True if the run is finished and all of its rows are on disk."""
        return self.pipeline.finished is not None and self.sink.is_empty

    def status(self, workers: int, now: float) -> RunStatus:
        """Return the run's figures; `workers` are those of the job."""
        seconds = now - self._began
        listing = RunListing.of(self.name, self.plan.bundle.digest, self.tally)
        counts = structs.asdict(listing) | {"finished": self.pipeline.finished or ""}
        return RunStatus(
            **counts,
            workers=workers,
            durable=self.sink.durable,
            seconds=seconds,
            rate=(listing.evaluations - self.replayed) / seconds if seconds > 0 else 0.0,
            trials_left=self.trials_left,
            trouble=self.sink.trouble,
        )


TRY_INTERVAL = 0.1  # seconds between two tries: a recorder does not answer, or a disk is full
JOIN_TIMEOUT = 0.5  # seconds that the thread may take to notice that it is not needed any more


@dataclass(frozen=True)
class LoadEnded:
    """The loader rests: with a run, a failure, an epoch, or nothing, as the defaults say."""

    run: ActiveRun | None = None
    """The run that is open and replayed."""
    opened: Opened | None = None
    """The recorder's answer; without a run: an epoch, before the first run is opened."""
    failure: Exception | None = None
    """A run failed (`RunFailed`), or the coordinator cannot go on (any other error)."""
    is_last: bool = False
    """There was no run left to open."""
    runs_wait: bool = False
    """All runs that are left wait for shapes."""


LoaderEvent = LoadEnded | WantedShapes


class RunLoader:
    """Opens the runs of a job one at a time; `put` takes the results, in the loader's thread.

    `begin_epoch` asks the recorder for an epoch where all runs wait for shapes, which workers build; None:
    runs of this queue wait for none.
    """

    def __init__(
        self,
        queue: RunQueue,
        make_sink: Callable[[RunPlan], RowSink],
        put: Callable[[LoaderEvent], None],
        stop: Stop,
        begin_epoch: Callable[[Callable[[], None]], Opened] | None = None,
    ) -> None:
        self._queue = queue
        self._make_sink = make_sink
        self._put = put
        self._stop = stop
        self._begin_epoch = begin_epoch
        self._thread: threading.Thread | None = None
        self._is_closed = False
        self.run: ActiveRun | None = None
        """The run that is being opened, or was opened last; None before it is made."""
        self.trouble = ""  # Reason why no run can be opened now; empty when one can
        self.excluded: frozenset[str] = frozenset()  # Workers whose rows are taken back

    def begin(self, epoch: int, *, opens: bool, shapes: int, built: tuple[BuildReply, ...]) -> None:
        """Start to take built shapes, to look for more, and to open the next run, in this order.

        `epoch` is the coordinator's, 0 before it has one; at most `shapes` are looked for.
        """
        self.run, self.trouble = None, ""
        request = (epoch, opens, shapes, built)
        self._thread = threading.Thread(target=self._load, args=request, name="loader", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Stop, at the next request to the recorder."""
        self._is_closed = True
        if self._thread is not None:
            self._thread.join(JOIN_TIMEOUT)

    def _load(self, epoch: int, opens: bool, shapes: int, built: tuple[BuildReply, ...]) -> None:
        try:
            warnings = tuple(filter(None, map(self._queue.take_shape, built)))
            if shapes or warnings:
                self._put(replace(self._queue.wanted_shapes(shapes), warnings=warnings))
            self._put(self._open_next(epoch) if opens else LoadEnded())
        except _Closed:
            return
        except Exception as error:  # noqa: BLE001  # any error is raised again where the job is run
            self._put(LoadEnded(failure=error))

    def _open_next(self, epoch: int) -> LoadEnded:
        try:
            plan = self._next_plan()
        except ShapesMissing:
            if epoch or self._begin_epoch is None:
                return LoadEnded(runs_wait=True)
            return LoadEnded(opened=self._begin_epoch(self._wait))
        if plan is None:
            return LoadEnded(is_last=True)
        self.run = run = ActiveRun(plan, self._make_sink(plan))
        try:
            return LoadEnded(run, run.open(epoch, self._wait, self.excluded))
        except InputError as error:
            raise RunFailed(plan.run, str(error)) from None

    def _next_plan(self) -> RunPlan | None:
        """Return the queue's next run; waits while the disk is full."""
        while True:
            try:
                plan = self._queue.next()
            except DiskFull as full:
                self.trouble = str(full)
                self._wait()
            else:
                self.trouble = ""
                return plan

    def _wait(self) -> None:
        """Pause between two tries; raises if closed."""
        if self._is_closed or self._stop.is_set:
            raise _Closed
        time.sleep(TRY_INTERVAL)


class _Closed(Exception):  # a way out, not an error
    """The loader is not needed any more."""


BUILDING_SHOWN = 8  # Most meshes that are named while their shapes are built
MOST_LOOKED_AT = 64  # Most shapes that are looked for before the next run is opened


class ShapeProgress:
    """Shapes of a job that are to be built: those that are under way, and how many there were."""

    def __init__(self, *, is_last: bool) -> None:
        self.wanted = self.built = self.failed = 0
        """Shapes that were to be built so far, that were, and that cannot be."""
        self.cpu_seconds = 0.0
        """CPU seconds that workers took for them."""
        self.files: dict[str, Path] = {}
        """The files of those under way, by sha256; read in any thread."""
        self._under_way: dict[str, WantedShape] = {}
        self._ended: list[BuildReply] = []
        self._is_last = is_last  # No more are to be looked for

    def room(self, most: int) -> int:
        """Return how many shapes are to be looked for, that there are at most so many under way."""
        return 0 if self._is_last else min(MOST_LOOKED_AT, max(0, most - len(self._under_way)))

    def add(self, found: WantedShapes) -> None:
        """Note shapes that are to be built."""
        self._is_last = found.is_last
        self.wanted += len(found.shapes)
        for shape in found.shapes:
            self._under_way[shape.task.key] = shape
            self.files |= shape.paths

    def end(self, reply: BuildReply) -> None:
        """Note the end of a build."""
        self.built += bool(reply.pieces)
        self.failed += bool(reply.reason)
        self.cpu_seconds += reply.cpu_seconds
        self._ended.append(reply)
        self._under_way.pop(reply.key, None)
        used = {file.sha256 for shape in self._under_way.values() for file in shape.task.files}
        self.files = {digest: path for digest, path in self.files.items() if digest in used}

    @property
    def under_way(self) -> int:
        """Number of shapes that are built, or wait for that."""
        return len(self._under_way)

    @property
    def building(self) -> list[str]:
        """The first of the meshes whose shapes are under way."""
        return [str(shape.mesh) for shape in islice(self._under_way.values(), BUILDING_SHOWN)]

    def take_ended(self) -> tuple[BuildReply, ...]:
        """Return the builds that have ended since the last call."""
        ended, self._ended = tuple(self._ended), []
        return ended


MOST_RUNS, MOST_RUNS_OF_MANY = 256, 1024
"""The most runs that are carried out at once: as many as there are workers, between these two.

A generation of the default method has 50 genomes, two or three batches. An open run has 2 MB.
"""
MOST_SCENES = 64  # Number of scenes kept for late queries after their last run is done


class RunRegistry:
    """The active runs of a job."""

    def __init__(self, queue: RunQueue, loader: RunLoader) -> None:
        self.extent = queue.extent  # Amount of work when the job began
        self._queue = queue
        self._loader = loader
        self.is_loading = False  # The loader is at work
        self._all_opened = False
        self._runs_wait = False  # every run that is left, for shapes
        self._was_put_back = False  # since the loader began
        self.shapes = ShapeProgress(is_last=not queue.has_shapes)
        self._open: dict[str, ActiveRun] = {}
        self._failures: list[RunFailed] = []
        self._budgets = dict(self.extent.budgets)  # of the runs that are neither done nor failed
        self._scenes: dict[str, Bundle] = {}
        self._finished: list[str] = []  # Runs that were finished here
        self._done = 0
        self._found = self.extent.done
        self._replayed = self.extent.done.evaluations
        self._began = time.monotonic()

    def __iter__(self) -> Iterator[ActiveRun]:
        """Iterate over the active runs, oldest first; any may end meanwhile."""
        return iter(list(self._open.values()))

    def get(self, run: str) -> ActiveRun | None:
        """Return an active run; None: not active."""
        return self._open.get(run)

    def object_of(self, run: str) -> str:
        """Return the object of a run of a campaign, as its spec names it; empty: not known."""
        return self._queue.object_of(run)

    def asset(self, digest: str) -> Bundle | Path | None:
        """Return a present or recent scene, or a file of a shape; None: unknown. Safe in any thread."""
        return self._scenes.get(digest) or self.shapes.files.get(digest)

    @property
    def are_done(self) -> bool:
        """True if every run of the job is finished or failed."""
        return self._all_opened and not self._open

    def check(self) -> None:
        """Raise RunsFailed if some runs could not be carried out."""
        if self._failures:
            raise RunsFailed(self._failures, self.extent.runs)

    def load(self, epoch: int, *, workers: int, is_wanted: bool) -> None:
        """Have built shapes taken, others looked for, and a run opened if one is wanted.

        One such request at a time; a run is opened too if none is active. Shapes are built, or lie ready, for
        as many runs as there are workers.
        """
        if self.is_loading:
            return
        built = self.shapes.take_ended()
        self._runs_wait &= not built
        opens = (is_wanted or not self._open) and not (self._all_opened or self._runs_wait)
        opens &= len(self._open) < min(max(MOST_RUNS, workers), MOST_RUNS_OF_MANY)
        shapes = self.shapes.room(max(1, workers) - self._queue.ready_runs) if epoch else 0
        if opens or shapes or built:
            self.is_loading, self._was_put_back = True, False
            self._loader.begin(epoch, opens=opens, shapes=shapes, built=built)

    def load_ended(self, event: LoadEnded) -> None:
        """Note that the loader rests, and why it has opened no run."""
        self.is_loading = False
        self._runs_wait = event.runs_wait and not self._was_put_back
        self._all_opened |= event.is_last and not self._was_put_back

    def add(self, run: ActiveRun) -> None:
        """Add an opened run."""
        self._open[run.name] = run
        self._budgets.setdefault(run.name, run.tally.spec.evaluations)  # of a queue that grows
        self._replayed += run.replayed
        self._keep_scene(run.plan.bundle)

    def add_failure(self, failure: RunFailed) -> None:
        """Count a run that cannot be carried out as failed."""
        self._failures.append(failure)
        self._budgets.pop(failure.run, None)

    def remove(self, run: ActiveRun) -> None:
        """Remove a run that is done."""
        del self._open[run.name]
        self._finished.append(run.name)
        self._done += 1
        self._budgets.pop(run.name, None)
        self._found += run.tally.totals

    def reopen(self, run: ActiveRun) -> None:
        """Remove a run, to reopen it from its journal."""
        del self._open[run.name]
        self._replayed -= run.replayed
        self._put_back(run.name)

    def _put_back(self, run: str) -> None:
        self._queue.put_back(run)
        self._was_put_back, self._all_opened, self._runs_wait = True, False, False

    @property
    def excluded(self) -> frozenset[str]:
        """Workers that were found wrong."""
        return self._loader.excluded

    def exclude(self, wid: str) -> None:
        """Reopen all runs, without the rows of a worker that was found wrong."""
        self._loader.excluded |= {wid}
        for run in self:
            self.reopen(run)
        for name in self._finished:
            self._put_back(name)
        self._finished, self._done, self._found = [], 0, self.extent.done

    def close(self) -> None:
        """Stop opening."""
        self._loader.close()

    def _keep_scene(self, bundle: Bundle) -> None:
        """Add a scene, and forget the oldest of those that no active run has."""
        wanted = {run.plan.bundle.digest for run in self._open.values()}
        old = [digest for digest in self._scenes if digest not in wanted][:-MOST_SCENES]
        kept = {digest: scene for digest, scene in self._scenes.items() if digest not in old}
        self._scenes = kept | {bundle.digest: bundle}

    def status(self, now: float, trouble: str = "", **others: Any) -> JobStatus:
        """Return the job's figures: those of its runs, and others; `trouble` is that of its workers."""
        opening = [self._loader.run] if self.is_loading and self._loader.run else []
        runs = [*self._open.values(), *opening]
        opened = self._loader.trouble if self.is_loading else ""
        troubles = [opened, *(run.sink.trouble for run in runs), trouble]
        found = sum((run.tally.totals for run in runs), self._found)
        replayed = self._replayed + sum(run.replayed for run in opening)
        spent = sum(run.tally.spec.evaluations - run.remaining for run in runs)
        seconds = now - self._began
        return JobStatus(
            **others,
            runs=self.extent.runs,
            runs_done=self.extent.runs_done + self._done,
            runs_failed=len(self._failures),
            runs_open=len(self._open),
            budget=max(self.extent.evaluations, found.evaluations),
            remaining=sum(self._budgets.values()) - spent,
            trials_left=sum(run.trials_left for run in runs),
            **structs.asdict(found),
            waiting=sum(max(0, run.tally.rows - run.sink.durable) for run in self._open.values()),
            seconds=seconds,
            rate=(found.evaluations - replayed) / seconds if seconds > 0 else 0.0,
            trouble=next(filter(None, troubles), ""),
            scenes=self.shapes.wanted,
            scenes_done=self.shapes.built,
            scenes_failed=self.shapes.failed,
            scenes_seconds=self.shapes.cpu_seconds,
            building=self.shapes.building,
        )
