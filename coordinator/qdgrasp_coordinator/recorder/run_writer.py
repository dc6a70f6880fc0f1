"""Writes one run: its identity, its journal, and the rows that wait for their commit.

Messages may be lost, repeated, overlap, or come from a coordinator that was replaced (docs/bus.md, rule 8).
Time is passed in, in seconds of any steady clock.
"""

import time
from collections.abc import Iterator
from dataclasses import dataclass, replace
from enum import Enum
from math import inf
from pathlib import Path

from qdgrasp_coordinator.metrics.run_stats import count_rows
from qdgrasp_coordinator.storage.journal import Journal
from qdgrasp_coordinator.storage.journal_schema import JournalIdentity
from qdgrasp_coordinator.storage.journal_slice import JournalSlice, join_slices, slice_from_message
from qdgrasp_coordinator.storage.journal_writer import JournalWriter, OpenJournals
from qdgrasp_coordinator.storage.run_folder import RunFolder
from qdgrasp_protocol.errors import EndsTooSoon, ImpossibleValue, Refused
from qdgrasp_protocol.messages import OpenRun, Recordable
from qdgrasp_protocol.rows import Rows, RowShape
from qdgrasp_protocol.spec import RunSpec, differences, from_toml, to_toml


@dataclass(frozen=True)
class RunIdentity:
    """A run, as a coordinator opens it or as a folder holds it."""

    run: str
    spec: RunSpec
    scene: str
    """sha256 of the scene bundle."""
    shape: RowShape

    @classmethod
    def of(cls, asked: OpenRun) -> "RunIdentity":
        """Return the run that a coordinator opens.

        Raises
        ------
        InputError
            Its spec is not valid.
        """
        spec = from_toml(asked.spec.decode(errors="replace"), "the coordinator's spec")
        return cls(asked.run, spec, asked.scene, RowShape(asked.genes, asked.joints, asked.descriptors))

    @classmethod
    def recorded_in(cls, journal: Journal) -> "RunIdentity":
        """The run of a journal, with its latest budget."""
        return cls(journal.run, journal.spec, journal.scene, journal.shape)

    def begun_in(self, folder: RunFolder) -> "RunIdentity":
        """Return this run with the spec and scene of a folder without a journal."""
        scene = folder.bundle().digest if folder.has_bundle() else self.scene
        return replace(self, spec=folder.spec, scene=scene)

    @property
    def identity(self) -> JournalIdentity:
        """Identity for its new journal."""
        return JournalIdentity(self.run, to_toml(self.spec), self.scene, self.shape)


def check_same_run(path: Path, held: RunIdentity, asked: RunIdentity) -> None:
    """Check that a folder holds the run that is asked for, with any budget and goals.

    Raises
    ------
    Refused
        It is another one; what differs is named.
    """
    differ = differences(held.spec, asked.spec)
    if differ:
        raise Refused(f"{path} holds a run of another spec: {', '.join(differ)} differ; name another folder")
    if asked.scene != held.scene:
        raise Refused(
            f"{path} holds a run of scene {held.scene[:12]}, the coordinator has {asked.scene[:12]}"
        )
    if (asked.run, asked.shape) != (held.run, held.shape):
        raise Refused(f"{path} holds run '{held.run}' with rows of {held.shape}")


GROUP_ROWS = 2048  # With this many rows waiting, they are committed at once
GROUP_SECONDS = 0.25  # The longest that a row waits for its commit
MOST_WAITING = 65_536  # Most rows that wait while commits fail; more than a coordinator sends unconfirmed


class Arrival(Enum):
    """Result of offering rows."""

    TAKEN = "taken"
    """They, or the part that was not known, wait for their commit."""
    DUPLICATE = "known already"
    GAP = "rows before them are missing"
    STALE = "of a coordinator that was replaced"
    FULL = "more than can wait"


class CommitQueue:
    """Rows of one run between their arrival and their commit.

    Parameters
    ----------
    epoch
        The coordinator's; rows of a lower one are refused, a higher one is adopted.
    durable
        How many rows of the run are committed.
    """

    def __init__(self, epoch: int, durable: int) -> None:
        self.epoch = epoch
        self.durable = durable
        self._waiting: list[JournalSlice] = []
        self._since = 0.0

    @property
    def expected(self) -> int:
        """The number of the next row."""
        return self._waiting[-1].stop if self._waiting else self.durable

    def offer(self, epoch: int, stretch: JournalSlice, now: float) -> Arrival:
        """Take the new ones of consecutive rows."""
        if epoch < self.epoch:
            return Arrival.STALE
        self.epoch = epoch
        if stretch.first > self.expected:
            return Arrival.GAP
        if stretch.stop <= self.expected:
            return Arrival.DUPLICATE
        if stretch.stop - self.durable > MOST_WAITING:
            return Arrival.FULL
        if not self._waiting:
            self._since = now
        self._waiting.append(stretch.part(self.expected, stretch.stop))
        return Arrival.TAKEN

    @property
    def deadline(self) -> float:
        """When the waiting rows are to be committed; infinite where none wait."""
        if self.expected - self.durable >= GROUP_ROWS:
            return -inf
        return self._since + GROUP_SECONDS if self._waiting else inf

    @property
    def group(self) -> JournalSlice | None:
        """The waiting rows as one; None where none wait."""
        return join_slices(self._waiting) if self._waiting else None

    def committed(self) -> None:
        """Note that the waiting rows are durable."""
        self.durable = self.expected
        self._waiting.clear()


class RunWriter:
    """The only writer of a run's folder; its owner holds the lock of the job's folder.

    Parameters
    ----------
    folder
        The run's, with a journal in it.
    journals
        Where the journal is opened when it is needed.
    epoch
        The coordinator's.

    Raises
    ------
    FolderError
        The journal cannot be read, or not be written.
    """

    def __init__(self, folder: RunFolder, journals: OpenJournals, epoch: int) -> None:
        self._folder = folder
        self._journals = journals
        journal = self._journal
        self.subject = RunIdentity.recorded_in(journal)
        self.platform = journal.platform
        """Platform of the recorded rows; empty while there are no rows."""
        self.intake = CommitQueue(epoch, journal.count)
        """Rows that wait."""

    def begin_turn(self, spec: RunSpec, epoch: int) -> None:
        """Begin an epoch, with the budget of the coordinator's spec."""
        if self.subject.spec != spec:
            self._journal.set_spec(to_toml(spec))
            self.subject = replace(self.subject, spec=spec)
        if self._folder.spec != spec:
            self._folder.rewrite_spec(spec)
        self._journal.begin_turn(epoch, time.time())

    def check_end(self, spec: RunSpec) -> None:
        """Check that the run may end as this spec says: not before a row that is here or waits.

        Raises
        ------
        EndsTooSoon
            It may not.
        """
        if spec == self.subject.spec:
            return
        try:
            count_rows(spec, self._rows()).check_budget(spec)
        except ImpossibleValue as reason:
            raise EndsTooSoon(self._folder.path, reason) from None

    def take(self, message: Recordable, now: float) -> Arrival:
        """Queue rows for their commit.

        Raises
        ------
        MessageError
            They do not have this run's shape.
        """
        return self.intake.offer(message.epoch, slice_from_message(message, self.subject.shape), now)

    def commit(self, platform: dict[str, str]) -> None:
        """Make the waiting rows durable, after the platform that they were made on if it is new.

        Raises
        ------
        DiskFull
            There is no room; they go on waiting.
        """
        group = self.intake.group
        if group is None:
            return
        if platform and platform != self.platform:
            self._journal.set_platform(platform)
            self.platform = platform
        self._journal.append(group, self.intake.epoch, time.time())
        self.intake.committed()

    def forget_waiting(self, epoch: int) -> None:
        """Drop the rows that wait: another coordinator's epoch begins."""
        self.intake = CommitQueue(epoch, self.intake.durable)

    def page(self, first: int, limit: int) -> JournalSlice:
        """Recorded rows from number `first` on."""
        return self._journal.stretch(first, limit)

    def add_scene(self, payload: bytes) -> None:
        """Store the scene's bundle."""
        self._folder.add_bundle(payload)

    def _rows(self) -> Iterator[Rows]:
        """All rows in order, some thousands at a time."""
        yield from self._journal.blocks()
        if (group := self.intake.group) is not None:
            yield group.rows

    @property
    def _journal(self) -> JournalWriter:
        return self._journals.at(self._folder.path)
