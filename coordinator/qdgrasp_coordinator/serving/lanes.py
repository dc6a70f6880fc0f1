"""The lanes of a job: its runs in progress, opened as they are needed and let go when they are done."""

import time
from collections.abc import Callable, Iterator

from msgspec import structs

from qdgrasp_assets.scene import Bundle
from qdgrasp_coordinator.campaigns.programme import Extent, Programme
from qdgrasp_coordinator.counts.figures import JobFigures
from qdgrasp_coordinator.counts.totals import totals
from qdgrasp_coordinator.runs.assignment import Assignment
from qdgrasp_coordinator.serving.lane import Lane
from qdgrasp_coordinator.serving.opener import News, Opener
from qdgrasp_coordinator.serving.record import Record
from qdgrasp_protocol.errors import RunFailed, RunsFailed
from qdgrasp_protocol.lifetime import Stop

MOST_LANES = 256
"""The most runs that are carried out at once."""
MOST_SCENES = 64
"""So many scenes are kept for those who still want one when the last run of it is done."""


class Lanes:
    """The runs of a programme that are carried out now.

    Parameters
    ----------
    make_record
        Where the rows of a run go.
    tell
        Takes the opener's news, in the opener's thread.
    """

    def __init__(
        self,
        programme: Programme,
        make_record: Callable[[Assignment], Record],
        tell: Callable[[News], None],
        stop: Stop,
    ) -> None:
        self._extent = programme.extent
        self._programme = programme
        self._opener = Opener(programme, make_record, tell, stop)
        self._is_opening = False
        self._all_opened = False
        self._was_put_back = False  # since the opener began
        self._open: dict[str, Lane] = {}
        self._failures: list[RunFailed] = []
        self._budgets = dict(programme.extent.budgets)  # of the runs that are neither done nor failed
        self._scenes: dict[str, Bundle] = {}
        self._done = 0
        self._found = programme.extent.done
        self._replayed = programme.extent.done.evaluations
        self._began = time.monotonic()

    def __iter__(self) -> Iterator[Lane]:
        """The open ones, eldest first; they may be ended on the way."""
        return iter(list(self._open.values()))

    def get(self, run: str) -> Lane | None:
        """The open lane of a run."""
        return self._open.get(run)

    def scene(self, digest: str) -> Bundle | None:
        """A scene that is, or was just, worked on; safe in any thread."""
        return self._scenes.get(digest)

    @property
    def are_done(self) -> bool:
        """Whether every run of the job is finished, or failed."""
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
        """Have another run opened, if one is wanted or none is open; never two at a time.

        Parameters
        ----------
        epoch
            The coordinator's turn; 0 before it has one.
        """
        is_due = is_wanted or not self._open
        if is_due and not self._is_opening and not self._all_opened and len(self._open) < MOST_LANES:
            self._is_opening, self._was_put_back = True, False
            self._opener.begin(epoch)

    def begin(self, lane: Lane) -> None:
        """Take an opened run on."""
        self._is_opening = False
        self._open[lane.run] = lane
        self._budgets.setdefault(lane.run, lane.tally.budget)  # of a programme that grows
        self._replayed += lane.replayed
        self._keep(lane.assignment.bundle)

    def fail(self, failure: RunFailed) -> None:
        """Go on without a run that cannot be carried out."""
        self._is_opening = False
        self._failures.append(failure)
        self._budgets.pop(failure.run, None)

    def none_left(self) -> None:
        """Hear that there was no run to open; one that was put back meanwhile still is."""
        self._is_opening = False
        self._all_opened = not self._was_put_back

    def end(self, lane: Lane) -> None:
        """Let go of a run that is done."""
        del self._open[lane.run]
        self._done += 1
        self._budgets.pop(lane.run, None)
        self._found += totals(lane.tally)

    def reopen(self, lane: Lane) -> None:
        """Let go of a run whose records are less than they were, to go on with it from what there is."""
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
    def extent(self) -> Extent:
        """How much there was to do when they began."""
        return self._extent

    def figures(self, job: str, workers: int, now: float) -> JobFigures:
        """How far the job is."""
        opening = [self._opener.lane] if self._is_opening and self._opener.lane else []
        lanes = [*self._open.values(), *opening]
        troubles = [
            self._opener.trouble if self._is_opening else "",
            *(lane.record.trouble for lane in lanes),
        ]
        found = sum((totals(lane.tally) for lane in lanes), self._found)
        replayed = self._replayed + sum(lane.replayed for lane in opening)
        seconds = now - self._began
        return JobFigures(
            job=job,
            runs=self._extent.runs,
            runs_done=self._extent.runs_done + self._done,
            runs_failed=len(self._failures),
            runs_open=len(self._open),
            budget=max(self._extent.evaluations, found.evaluations),
            remaining=sum(self._budgets.values()) - sum(map(_spent, lanes)),
            **structs.asdict(found),
            waiting=sum(lane.waiting for lane in self._open.values()),
            workers=workers,
            seconds=seconds,
            rate=(found.evaluations - replayed) / seconds if seconds > 0 else 0.0,
            trouble=next(filter(None, troubles), ""),
        )


def _spent(lane: Lane) -> int:
    """How much of its budget a run has behind it: all of it once it is over."""
    return lane.tally.budget if lane.pipeline.finished else min(lane.tally.evaluations, lane.tally.budget)
