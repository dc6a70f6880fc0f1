"""The scribe: what a recorder does with what it hears, decided without a thread or a clock.

It takes settled rows into its books, commits them in groups, and says what is durable (docs/bus.md, rule 8).
Time is passed in, in seconds of any steady clock.
"""

from collections import Counter
from contextlib import suppress
from math import inf
from pathlib import Path

import structlog

from qdgrasp_coordinator.folders.job_folder import JobFolder
from qdgrasp_coordinator.recording.books import Books
from qdgrasp_coordinator.recording.intake import Arrival
from qdgrasp_coordinator.recording.reports import Reports
from qdgrasp_coordinator.recording.room import Room
from qdgrasp_protocol import codec
from qdgrasp_protocol.bus import Query, Sample
from qdgrasp_protocol.drops import Drops
from qdgrasp_protocol.errors import DiskFull, InputError, MessageError, NoReply, Refused
from qdgrasp_protocol.keys import Keys
from qdgrasp_protocol.messages import Log, Open, Platform, Recordable, Recorded, short

log = structlog.get_logger()


class Scribe:
    """Keeps the books of a job for whoever sends rows, or asks.

    Parameters
    ----------
    books
        The books, open.
    path
        The job's folder.
    disk_wait
        How long a full disk is waited for [s].

    Raises
    ------
    DiskFull
        From any method that is passed the time: the disk was full for too long.
    """

    def __init__(self, books: Books, job: str, path: Path, disk_wait: float, now: float) -> None:
        self._books = books
        self._keys = Keys(job)
        self._path = path
        self._room = Room(path, disk_wait)
        self._drops = Drops()
        self._reports = Reports()
        self._untaken: Counter[Arrival] = Counter()
        for run in books.runs:
            self._reports.heard(run, now)

    # Messages and questions come in.

    def take(self, sample: Sample, now: float) -> None:
        """Hear a message; what is none of ours is ignored."""
        try:
            if sample.encoding == codec.encoding(Recordable):
                self._take_rows(codec.decode(sample.payload, Recordable), now)
            elif sample.encoding == codec.encoding(Platform):
                self._books.set_platform(codec.decode(sample.payload, Platform))
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
                return self._open(codec.decode(query.payload, Open), now)
            return codec.encode(self._books.page(codec.decode(query.payload, Log)))
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
        return codec.encode(opened)

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
        self._room.missed(short(str(full)), now, JobFolder(self._path).resume_command)
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
