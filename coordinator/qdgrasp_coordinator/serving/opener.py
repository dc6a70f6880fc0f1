"""The opener: makes the next run of a job ready, in a thread of its own, while others go on.

Building a scene takes seconds, and so may the replay of a journal; results go on being settled meanwhile.
What was made is handed over by the coordinator's inbox.
"""

import threading
import time
from collections.abc import Callable
from dataclasses import dataclass

from qdgrasp_coordinator.campaigns.programme import Programme
from qdgrasp_coordinator.runs.assignment import Assignment
from qdgrasp_coordinator.serving.lane import Lane
from qdgrasp_coordinator.serving.record import Record
from qdgrasp_protocol.errors import DiskFull, InputError, RunFailed
from qdgrasp_protocol.lifetime import Stop
from qdgrasp_protocol.messages import Opened

TRY_INTERVAL = 0.1  # seconds between two tries: a recorder does not answer, or a disk is full
FAREWELL = 0.5  # seconds that the thread may take to notice that it is not needed any more


@dataclass(frozen=True)
class Begun:
    """A run is open and replayed."""

    lane: Lane
    opened: Opened


@dataclass(frozen=True)
class Failed:
    """A run cannot be carried out, or, where `reason` is another error, the coordinator cannot go on."""

    reason: Exception


@dataclass(frozen=True)
class NoneLeft:
    """There was no run to open."""


News = Begun | Failed | NoneLeft


class Opener:
    """Opens the runs of a programme one at a time.

    Parameters
    ----------
    make_record
        Where the rows of a run go.
    tell
        Takes the news; called in the opener's thread.
    """

    def __init__(
        self,
        programme: Programme,
        make_record: Callable[[Assignment], Record],
        tell: Callable[[News], None],
        stop: Stop,
    ) -> None:
        self._programme = programme
        self._make_record = make_record
        self._tell = tell
        self._stop = stop
        self._thread: threading.Thread | None = None
        self._is_closed = False
        self.lane: Lane | None = None
        """The run that is being opened, or was opened last; None before it is made."""
        self.trouble = ""
        """Why no run can be opened now, in words; empty when one can."""

    def begin(self, epoch: int) -> None:
        """Start on the next run; `epoch` is the coordinator's turn, 0 before it has one."""
        self.lane, self.trouble = None, ""
        self._thread = threading.Thread(target=self._run, args=(epoch,), name="opener", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Stop, at the next question to the recorder."""
        self._is_closed = True
        if self._thread is not None:
            self._thread.join(FAREWELL)

    def _run(self, epoch: int) -> None:
        try:
            news = self._next(epoch)
        except _Closed:
            return
        except Exception as error:  # noqa: BLE001  # whatever it is, it is raised again where the job is run
            news = Failed(error)
        self._tell(news)

    def _next(self, epoch: int) -> News:
        assignment = self._assignment()
        if assignment is None:
            return NoneLeft()
        self.lane = lane = Lane(assignment, self._make_record(assignment))
        try:
            return Begun(lane, lane.open(epoch, self._wait))
        except InputError as error:
            raise RunFailed(assignment.run, str(error)) from None

    def _assignment(self) -> Assignment | None:
        """The next run of the programme; a full disk is waited for."""
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
        """Between two tries."""
        if self._is_closed or self._stop.is_set:
            raise _Closed
        time.sleep(TRY_INTERVAL)


class _Closed(Exception):  # a way out, not an error
    """The opener is not needed any more."""
