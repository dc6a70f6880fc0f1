"""Writes one run: rows wait here from their arrival to their commit in the journal.

Messages may be lost, repeated, overlap, or come from a coordinator that was replaced (docs/bus.md, rule 8).
Time is passed in, in seconds of any steady clock.
"""

import time
from dataclasses import replace
from math import inf
from pathlib import Path

from qdgrasp_coordinator.metrics.job_status import RunListing
from qdgrasp_coordinator.metrics.run_stats import RunCounter, count_rows
from qdgrasp_coordinator.storage.journal import JournalIdentity, JournalSlice, join_slices
from qdgrasp_coordinator.storage.journal_writer import JournalWriter, OpenJournals
from qdgrasp_coordinator.storage.platforms import platform_of
from qdgrasp_coordinator.storage.run_folder import RunFolder
from qdgrasp_protocol.errors import Refused
from qdgrasp_protocol.rows import Rows
from qdgrasp_protocol.spec import RunSpec, differences

GROUP_ROWS = 2048  # With this many rows waiting, they are committed at once
GROUP_SECONDS = 0.25  # The longest that a row waits for its commit
MOST_WAITING = 65_536  # Most rows that wait while commits fail; more than a coordinator sends unconfirmed


def check_same_run(path: Path, held: JournalIdentity, asked: JournalIdentity) -> None:
    """Refuse a run that is not the one in a folder; budget and stop criteria may differ."""
    if differ := differences(held.spec, asked.spec):
        raise Refused(f"{path} holds a run of another spec: {', '.join(differ)} differ; name another folder")
    if asked.scene != held.scene:
        raise Refused(
            f"{path} holds a run of scene {held.scene[:12]}, the coordinator has {asked.scene[:12]}"
        )
    if (asked.run, asked.shape) != (held.run, held.shape):
        raise Refused(f"{path} holds run '{held.run}' with rows of {held.shape}")


class RunWriter:
    """The only writer of a run's folder, which has a journal; its owner holds the job's lock.

    Rows of a lower coordinator's epoch are refused, a higher one is adopted.
    """

    def __init__(self, folder: RunFolder, journals: OpenJournals, epoch: int) -> None:
        self.folder = folder
        self._journals = journals
        self.identity = self.journal.identity
        self.durable = self.journal.count  # Number of rows on disk
        self._counter: RunCounter | None = None  # Counts rows on disk; None before the first commit
        self._epoch = epoch
        self._waiting: list[JournalSlice] = []
        self._excluded: set[str] = set()
        self._since = 0.0

    @property
    def journal(self) -> JournalWriter:
        """The journal, open until the next one is asked for."""
        return self._journals.at(self.folder.path)

    @property
    def expected(self) -> int:
        """The number of the next row."""
        return self._waiting[-1].stop if self._waiting else self.durable

    @property
    def deadline(self) -> float:
        """When the waiting rows are to be committed; infinite if none wait."""
        if self.expected - self.durable >= GROUP_ROWS:
            return -inf
        return self._since + GROUP_SECONDS if self._waiting else inf

    def begin_epoch(self, spec: RunSpec, epoch: int) -> None:
        """Begin a coordinator's epoch, with the budget of its spec."""
        if self.identity.spec != spec:
            self.journal.set_spec(spec)
            self.identity = replace(self.identity, spec=spec)
            self._counter = None
        if self.folder.spec != spec:
            self.folder.rewrite_spec(spec)
        self.journal.begin_epoch(epoch, time.time())

    def exclude(self, workers: set[str]) -> None:
        """Take back the rows of workers that were found wrong, and all behind the first of them."""
        self._excluded = workers
        self._waiting.clear()
        wrong = [number for number, _, worker, _ in self.journal.makers() if worker in workers]
        if wrong:
            self.durable, self._counter = self.journal.withdraw(wrong[0]), None

    def add(self, rows: JournalSlice, epoch: int, now: float) -> bool:
        """Queue those of consecutive rows that are new for their commit; False: none is taken.

        They are of a coordinator that was replaced, or a worker found wrong, known already, behind a gap, or
        more than can wait.
        """
        if epoch < self._epoch or self._excluded & {maker.partition(" ")[0] for maker in set(rows.makers)}:
            return False
        self._epoch = epoch
        if not rows.first <= self.expected < rows.stop or rows.stop - self.durable > MOST_WAITING:
            return False
        if not self._waiting:
            self._since = now
        self._waiting.append(rows.part(self.expected, rows.stop))
        return True

    def commit(self, platform: dict[str, str]) -> None:
        """Make the waiting rows durable, with the platform that they were made on.

        On a full disk (`DiskFull`) they go on waiting.
        """
        if not self._waiting:
            return
        part = join_slices(self._waiting)
        platform = platform_of(self.identity.spec.engine, platform)
        self.journal.append(part, self._epoch, time.time(), platform)
        self.durable = self.expected
        self._waiting.clear()
        self._count(part.rows)

    def _count(self, rows: Rows) -> None:
        """Count rows that were just committed, and those before them if they were not."""
        if self._counter is None:
            self._counter = count_rows(self.identity.spec, self.journal.blocks())
        else:
            self._counter.count_block(rows)

    @property
    def finished(self) -> RunListing | None:
        """The listing of a run whose last row was committed here; None: it was not."""
        if self._counter is None or self._counter.finished is None:
            return None
        return RunListing.of(self.identity.run, self.identity.scene, self._counter)

    def forget_waiting(self, epoch: int) -> None:
        """Drop the rows that wait: another coordinator's epoch begins."""
        self._epoch = epoch
        self._waiting.clear()
