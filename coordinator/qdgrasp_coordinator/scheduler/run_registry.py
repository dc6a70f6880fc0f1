"""The runs of a job in progress: opened and replayed when needed, let go when done.

The loader makes the next run ready in a thread of its own: building a scene takes seconds, and so may the
replay of a journal; results go on being settled meanwhile. What was made is handed over by the scheduler's
inbox.
"""

import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import msgspec
from msgspec import structs

from qdgrasp_assets.scene import Bundle
from qdgrasp_coordinator.metrics.job_status import JobStatus, RunListing, RunStatus
from qdgrasp_coordinator.metrics.run_stats import GrowthCurve, RunCounter
from qdgrasp_coordinator.scheduler.recorder_client import RowSink
from qdgrasp_coordinator.scheduler.run_plan import JobExtent, RunPlan, RunQueue
from qdgrasp_protocol.errors import DiskFull, EndedEarly, InputError, RunFailed, RunsFailed
from qdgrasp_protocol.messages import Opened
from qdgrasp_protocol.process import Stop
from qdgrasp_protocol.spec import from_toml


class ActiveRun:
    """A run from its opening at the recorder to its last durable row."""

    def __init__(self, assignment: RunPlan, record: RowSink) -> None:
        self.assignment = assignment
        self.pipeline = assignment.pipeline
        self.record = record
        self.replayed = 0
        """Counted evaluations that were in the journal when the run was opened."""
        self._spec = from_toml(assignment.spec.decode(), f"the spec of run '{assignment.run}'")
        self._began = time.monotonic()

    def open(self, epoch: int, wait: Callable[[], None]) -> Opened:
        """Open the run and replay its journal into its search, checked bit for bit.

        Parameters
        ----------
        epoch
            The coordinator's; 0: the recorder issues a new one.
        wait
            Called between two requests; it may raise to end them.

        Raises
        ------
        InputError
            The recorder refuses the run, or its journal is not what its spec replays to.
        """
        opened = self.record.open(self.assignment.opening, epoch, wait)
        position, durable = 0, opened.durable[0]
        while position < durable:
            stretch = self.record.recorded(position, wait)
            if not len(stretch):
                raise EndedEarly(f"The recorder has {durable} rows but shows none from {position} on.")
            self.pipeline.replay(stretch.rows)
            position = stretch.stop
            self.replayed = self.tally.evaluations
        return opened

    @property
    def run(self) -> str:
        """The run's name."""
        return self.assignment.run

    @property
    def tally(self) -> RunCounter:
        """Counts of its journal's rows."""
        return self.pipeline.tally

    @property
    def curve(self) -> GrowthCurve:
        """Growth of its counts."""
        return self.tally.curve(self.run)

    @property
    def waiting(self) -> int:
        """Settled rows that are not known to be on disk."""
        return max(0, self.tally.rows - self.record.durable)

    @property
    def is_done(self) -> bool:
        """True if the run is finished and all of its rows are on disk."""
        return self.pipeline.finished is not None and self.record.is_empty

    def figures(self, workers: int, now: float) -> RunStatus:
        """Return the run's figures; `workers` are those of the job."""
        seconds = now - self._began
        entry = RunListing.of(self.run, self._spec, self.assignment.bundle.digest, self.tally)
        counts = msgspec.structs.asdict(entry) | {"finished": self.pipeline.finished or ""}
        return RunStatus(
            **counts,
            workers=workers,
            durable=self.record.durable,
            seconds=seconds,
            rate=(entry.evaluations - self.replayed) / seconds if seconds > 0 else 0.0,
            trouble=self.record.trouble,
        )


TRY_INTERVAL = 0.1  # seconds between two tries: a recorder does not answer, or a disk is full
JOIN_TIMEOUT = 0.5  # seconds that the thread may take to notice that it is not needed any more


@dataclass(frozen=True)
class RunOpened:
    """A run is open and replayed."""

    lane: ActiveRun
    opened: Opened


@dataclass(frozen=True)
class RunNotOpened:
    """A run failed (`RunFailed`), or the coordinator cannot go on (any other error)."""

    reason: Exception


@dataclass(frozen=True)
class NoRunLeft:
    """There was no run to open."""


LoaderEvent = RunOpened | RunNotOpened | NoRunLeft


class RunLoader:
    """Opens the runs of a programme one at a time.

    Parameters
    ----------
    make_record
        Makes the record that takes a run's rows.
    tell
        Takes the result of each opening, in the opener's thread.
    """

    def __init__(
        self,
        programme: RunQueue,
        make_record: Callable[[RunPlan], RowSink],
        tell: Callable[[LoaderEvent], None],
        stop: Stop,
    ) -> None:
        self._programme = programme
        self._make_record = make_record
        self._tell = tell
        self._stop = stop
        self._thread: threading.Thread | None = None
        self._is_closed = False
        self.lane: ActiveRun | None = None
        """The run that is being opened, or was opened last; None before it is made."""
        self.trouble = ""
        """Reason why no run can be opened now; empty when one can."""

    def begin(self, epoch: int) -> None:
        """Start to open the next run; `epoch` is the coordinator's, 0 before it has one."""
        self.lane, self.trouble = None, ""
        self._thread = threading.Thread(target=self._run, args=(epoch,), name="opener", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Stop, at the next request to the recorder."""
        self._is_closed = True
        if self._thread is not None:
            self._thread.join(JOIN_TIMEOUT)

    def _run(self, epoch: int) -> None:
        try:
            news = self._next(epoch)
        except _Closed:
            return
        except Exception as error:  # noqa: BLE001  # whatever it is, it is raised again where the job is run
            news = RunNotOpened(error)
        self._tell(news)

    def _next(self, epoch: int) -> LoaderEvent:
        assignment = self._assignment()
        if assignment is None:
            return NoRunLeft()
        self.lane = lane = ActiveRun(assignment, self._make_record(assignment))
        try:
            return RunOpened(lane, lane.open(epoch, self._wait))
        except InputError as error:
            raise RunFailed(assignment.run, str(error)) from None

    def _assignment(self) -> RunPlan | None:
        """Return the programme's next run; waits while the disk is full."""
        while True:
            try:
                assignment = self._programme.next()
            except DiskFull as full:
                self.trouble = str(full)
                self._wait()
            else:
                self.trouble = ""
                return assignment

    def _wait(self) -> None:
        """Pause between two tries; raises if closed."""
        if self._is_closed or self._stop.is_set:
            raise _Closed
        time.sleep(TRY_INTERVAL)


class _Closed(Exception):  # a way out, not an error
    """The opener is not needed any more."""


MOST_RUNS = 256  # The most runs that are carried out at once
MOST_SCENES = 64  # Number of scenes kept for late queries after their last run is done


class RunRegistry:
    """The active runs of a programme.

    Parameters
    ----------
    make_record
        Makes the record that takes a run's rows.
    tell
        Takes the result of each opening, in the opener's thread.
    """

    def __init__(
        self,
        programme: RunQueue,
        make_record: Callable[[RunPlan], RowSink],
        tell: Callable[[LoaderEvent], None],
        stop: Stop,
    ) -> None:
        self._extent = programme.extent
        self._programme = programme
        self._opener = RunLoader(programme, make_record, tell, stop)
        self._is_opening = False
        self._all_opened = False
        self._was_put_back = False  # since the opener began
        self._open: dict[str, ActiveRun] = {}
        self._failures: list[RunFailed] = []
        self._budgets = dict(programme.extent.budgets)  # of the runs that are neither done nor failed
        self._scenes: dict[str, Bundle] = {}
        self._done = 0
        self._found = programme.extent.done
        self._replayed = programme.extent.done.evaluations
        self._began = time.monotonic()

    def __iter__(self) -> Iterator[ActiveRun]:
        """Iterate over the active runs, oldest first; any may end meanwhile."""
        return iter(list(self._open.values()))

    def get(self, run: str) -> ActiveRun | None:
        """Return an active run; None: not active."""
        return self._open.get(run)

    def scene(self, digest: str) -> Bundle | None:
        """Return a present or recent scene; None: unknown. Safe in any thread."""
        return self._scenes.get(digest)

    @property
    def are_done(self) -> bool:
        """True if every run of the job is finished or failed."""
        return self._all_opened and not self._open

    def check(self) -> None:
        """Check that every run was carried out.

        Raises
        ------
        RunsFailed
            Some could not be.
        """
        if self._failures:
            raise RunsFailed(self._failures, self._extent.runs)

    # They come and go.

    def open_another(self, epoch: int, *, is_wanted: bool) -> None:
        """Start to open a run if one is wanted or no run is active; one at a time.

        Parameters
        ----------
        epoch
            The coordinator's; 0 before it has one.
        """
        is_due = is_wanted or not self._open
        if is_due and not self._is_opening and not self._all_opened and len(self._open) < MOST_RUNS:
            self._is_opening, self._was_put_back = True, False
            self._opener.begin(epoch)

    def begin(self, lane: ActiveRun) -> None:
        """Add an opened run."""
        self._is_opening = False
        self._open[lane.run] = lane
        self._budgets.setdefault(lane.run, lane.tally.budget)  # of a programme that grows
        self._replayed += lane.replayed
        self._keep(lane.assignment.bundle)

    def fail(self, failure: RunFailed) -> None:
        """Count a run that cannot be carried out as failed."""
        self._is_opening = False
        self._failures.append(failure)
        self._budgets.pop(failure.run, None)

    def none_left(self) -> None:
        """Note that no run is left to open, unless one was put back meanwhile."""
        self._is_opening = False
        self._all_opened = not self._was_put_back

    def end(self, lane: ActiveRun) -> None:
        """Remove a run that is done."""
        del self._open[lane.run]
        self._done += 1
        self._budgets.pop(lane.run, None)
        self._found += lane.tally.totals

    def reopen(self, lane: ActiveRun) -> None:
        """Remove a run whose recorder lost rows, to reopen it from its journal."""
        del self._open[lane.run]
        self._replayed -= lane.replayed
        self._programme.put_back(lane.run)
        self._was_put_back, self._all_opened = True, False

    def close(self) -> None:
        """Stop opening."""
        self._opener.close()

    def _keep(self, bundle: Bundle) -> None:
        wanted = {lane.assignment.bundle.digest for lane in self._open.values()}
        old = [digest for digest in self._scenes if digest not in wanted]
        self._scenes = {
            digest: kept for digest, kept in self._scenes.items() if digest not in old[:-MOST_SCENES]
        } | {bundle.digest: bundle}

    # How far they are.

    @property
    def extent(self) -> JobExtent:
        """Amount of work when the job began."""
        return self._extent

    def figures(self, job: str, workers: int, now: float) -> JobStatus:
        """Return the job's figures."""
        opening = [self._opener.lane] if self._is_opening and self._opener.lane else []
        lanes = [*self._open.values(), *opening]
        troubles = [
            self._opener.trouble if self._is_opening else "",
            *(lane.record.trouble for lane in lanes),
        ]
        found = sum((lane.tally.totals for lane in lanes), self._found)
        replayed = self._replayed + sum(lane.replayed for lane in opening)
        seconds = now - self._began
        return JobStatus(
            job=job,
            runs=self._extent.runs,
            runs_done=self._extent.runs_done + self._done,
            runs_failed=len(self._failures),
            runs_open=len(self._open),
            budget=max(self._extent.evaluations, found.evaluations),
            remaining=sum(self._budgets.values()) - sum(map(_spent_budget, lanes)),
            **structs.asdict(found),
            waiting=sum(lane.waiting for lane in self._open.values()),
            workers=workers,
            seconds=seconds,
            rate=(found.evaluations - replayed) / seconds if seconds > 0 else 0.0,
            trouble=next(filter(None, troubles), ""),
        )


def _spent_budget(lane: ActiveRun) -> int:
    """Return the spent part of a run's budget: all of it once the run is over."""
    return lane.tally.budget if lane.pipeline.finished else min(lane.tally.evaluations, lane.tally.budget)
