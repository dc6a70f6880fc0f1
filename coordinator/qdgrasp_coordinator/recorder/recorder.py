"""Decides what a recorder does: takes rows, commits them in groups, reports what is durable.

Decided without a thread or a clock (docs/bus.md, rule 8); time is passed in, in seconds of any steady
clock. A run is reported at once when there is news of it, and then each second until nothing was heard of
it for a while: a report may be lost. Later ones are owed to nobody: a coordinator that still misses one
sends its rows again, and these are news.
"""

from collections import Counter
from contextlib import suppress
from math import inf
from pathlib import Path

import structlog

from qdgrasp_coordinator.recorder.run_store import RunStore
from qdgrasp_coordinator.recorder.run_writer import Arrival
from qdgrasp_coordinator.storage.job_folder import JobFolder
from qdgrasp_protocol import messages
from qdgrasp_protocol.bus import DropCounter, Query, Sample
from qdgrasp_protocol.errors import DiskFull, InputError, MessageError, NoReply, Refused
from qdgrasp_protocol.keys import Keys
from qdgrasp_protocol.messages import Log, Open, Platform, Recordable, Recorded, shorten

RETRY_INTERVAL = 1.0  # Seconds between two tries to write on a full disk


class DiskSpaceRetry:
    """State of a folder's disk, full or not, as writes have shown.

    Parameters
    ----------
    path
        The folder.
    patience
        How long a full disk is waited for [s].
    """

    def __init__(self, path: Path, patience: float) -> None:
        self._path = path
        self._patience = patience
        self._since: float | None = None
        self.trouble = ""
        """Reason why nothing can be written; empty when it can."""
        self.try_at = -inf
        """When to try to write again."""

    def missed(self, reason: str, now: float, command: str) -> None:
        """Note that a write did not fit; `command` goes on once there is room.

        Raises
        ------
        DiskFull
            Nothing has fitted for too long.
        """
        if self._since is None:
            self._since = now
        elif now - self._since > self._patience:
            raise DiskFull(
                f"{self._path} has had no room for {self._patience:g} s; make room, then `{command}` goes on."
            )
        self.trouble = reason
        self.try_at = now + RETRY_INTERVAL

    def found(self) -> None:
        """Note that something was written."""
        self._since, self.trouble, self.try_at = None, "", -inf


REPORT_INTERVAL = 1.0  # Seconds between two reports of a run when nothing happens
REPORT_SECONDS = 10.0  # Seconds for which a run is reported after the last that was heard of it


class ReportSchedule:
    """Schedule of the reports of runs."""

    def __init__(self) -> None:
        self._due: dict[str, float] = {}
        self._until: dict[str, float] = {}

    def heard(self, run: str, now: float) -> None:
        """Note that something was heard of a run: it is reported each second for a while."""
        self._due.setdefault(run, now + REPORT_INTERVAL)
        self._until[run] = now + REPORT_SECONDS

    def news(self, run: str, now: float) -> None:
        """Note that there is something to report of a run at once."""
        self._due[run] = now
        self._until[run] = now + REPORT_SECONDS

    def repeat(self, now: float) -> None:
        """Make every remembered run due at once."""
        self._due = dict.fromkeys(self._due, now)

    @property
    def deadline(self) -> float:
        """When the next report is due; infinite: none is."""
        return min(self._due.values(), default=inf)

    def due(self, now: float) -> list[str]:
        """The runs to report now; they count as reported."""
        runs = [run for run, at in self._due.items() if at <= now]
        for run in runs:
            if now + REPORT_INTERVAL <= self._until[run]:
                self._due[run] = now + REPORT_INTERVAL
            else:
                del self._due[run], self._until[run]
        return runs


log = structlog.get_logger()


class Recorder:
    """Decides what a recorder does with messages, queries and time.

    Parameters
    ----------
    books
        The job's runs as recorded, open.
    path
        The job's folder.
    disk_wait
        How long a full disk is waited for [s].

    Raises
    ------
    DiskFull
        From any method that is passed the time: the disk was full for too long.
    """

    def __init__(self, books: RunStore, job: str, path: Path, disk_wait: float, now: float) -> None:
        self._books = books
        self._keys = Keys(job)
        self._path = path
        self._room = DiskSpaceRetry(path, disk_wait)
        self._drops = DropCounter()
        self._reports = ReportSchedule()
        self._untaken: Counter[Arrival] = Counter()
        for run in books.runs:
            self._reports.heard(run, now)

    # Messages and questions come in.

    def take(self, sample: Sample, now: float) -> None:
        """Process a message; ignore those of other kinds."""
        try:
            if sample.encoding == messages.encoding(Recordable):
                self._take_rows(messages.decode(sample.payload, Recordable), now)
            elif sample.encoding == messages.encoding(Platform):
                self._books.set_platform(messages.decode(sample.payload, Platform))
        except (MessageError, Refused) as error:
            self._drops.note(sample.key, error)

    def answer(self, query: Query, now: float) -> bytes:
        """Open runs, or show recorded rows.

        Raises
        ------
        Refused
            That cannot be done; the asker is told why.
        NoReply
            There is no room now: it is to be asked again.
        """
        try:
            if query.key == self._keys.open:
                return self._open(messages.decode(query.payload, Open), now)
            return messages.encode(self._books.page(messages.decode(query.payload, Log)))
        except DiskFull as full:
            self._wait_for_room(full, now)
            raise NoReply(str(full)) from None
        except (InputError, MessageError, Refused) as error:
            raise Refused(str(error).removesuffix(".")) from None

    def _take_rows(self, message: Recordable, now: float) -> None:
        arrival = self._books.take(message, now)
        if arrival is Arrival.TAKEN:
            self._reports.heard(message.run, now)
        else:
            self._untaken[arrival] += message.n
            self._reports.news(message.run, now)

    def _open(self, asked: Open, now: float) -> bytes:
        opened = self._books.open(asked)
        self._have_room(now)
        for run, rows in zip(asked.runs, opened.durable, strict=True):
            self._reports.heard(run.run, now)
            log.info("opened", run=run.run, epoch=opened.epoch, rows=rows)
        return messages.encode(opened)

    # Time passes.

    @property
    def deadline(self) -> float:
        """When `step` has something to do if nothing comes before; infinite: never."""
        return min(self._commit_at, self._reports.deadline)

    def step(self, now: float) -> list[Recorded]:
        """Commit what is due; gives the reports that are."""
        if now >= self._commit_at:
            self._commit(now)
        return self._due_reports(now)

    def close(self, now: float) -> list[Recorded]:
        """Commit what waits, if there is room; gives the last reports."""
        with suppress(DiskFull):
            self._commit_due(inf, now)
        return self._due_reports(now)

    @property
    def _commit_at(self) -> float:
        return max(self._books.deadline, self._room.try_at)

    def _commit(self, now: float) -> None:
        try:
            self._commit_due(now, now)
        except DiskFull as full:
            self._wait_for_room(full, now)
        else:
            self._have_room(now)

    def _commit_due(self, by: float, now: float) -> None:
        for run in self._books.due(by):
            self._books.commit(run)
            self._reports.news(run, now)

    def _wait_for_room(self, full: DiskFull, now: float) -> None:
        """Say that the disk is full, and try again soon; give up when it was full for too long."""
        if not self._room.trouble:
            log.warning("the disk is full; trying again until there is room", reason=str(full))
        self._room.missed(shorten(str(full)), now, JobFolder(self._path).resume_command)
        for run in self._books.due(inf):
            self._reports.news(run, now)

    def _have_room(self, now: float) -> None:
        if self._room.trouble:
            log.info("there is room again", folder=str(self._path))
            self._reports.repeat(now)
        self._room.found()

    def _due_reports(self, now: float) -> list[Recorded]:
        for arrival, rows in self._untaken.items():
            log.info("rows not taken", reason=arrival.value, rows=rows)
        self._untaken.clear()
        return [self._report(run) for run in self._reports.due(now)]

    def _report(self, run: str) -> Recorded:
        books, trouble = self._books, self._room.trouble
        return Recorded(epoch=books.epoch, run=run, durable=books.durable(run), trouble=trouble)
