"""A run while it is recorded: its folder, its journal, and the rows that wait for their commit."""

import time
from collections.abc import Iterator
from dataclasses import replace

from qdgrasp_coordinator.counts.counting import tally
from qdgrasp_coordinator.counts.stretch import Stretch, from_message
from qdgrasp_coordinator.folders.folder import RunFolder
from qdgrasp_coordinator.folders.journal_writer import JournalWriter
from qdgrasp_coordinator.folders.journals import Journals
from qdgrasp_coordinator.recording.intake import Arrival, Intake
from qdgrasp_coordinator.recording.subject import Subject
from qdgrasp_protocol.errors import EndsTooSoon, ImpossibleValue
from qdgrasp_protocol.messages import Recordable
from qdgrasp_protocol.rows import Rows
from qdgrasp_protocol.spec import RunSpec, to_toml


class Ledger:
    """The one writer of a run's folder; whoever makes it holds the lock of the job's.

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

    def __init__(self, folder: RunFolder, journals: Journals, epoch: int) -> None:
        self._folder = folder
        self._journals = journals
        journal = self._journal
        self.subject = Subject.recorded_in(journal)
        self.platform = journal.platform
        """What the recorded rows were made on; empty while there are none."""
        self.intake = Intake(epoch, journal.count)
        """The rows that wait."""

    def begin_turn(self, spec: RunSpec, epoch: int) -> None:
        """Go on for a coordinator, with the budget of its spec."""
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
            tally(spec, self._rows()).check_budget(spec)
        except ImpossibleValue as reason:
            raise EndsTooSoon(self._folder.path, reason) from None

    def take(self, message: Recordable, now: float) -> Arrival:
        """Let rows wait for their commit.

        Raises
        ------
        MessageError
            They are not of this run's shape.
        """
        return self.intake.offer(message.epoch, from_message(message, self.subject.shape), now)

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
        """Drop the rows that wait: another coordinator begins its turn."""
        self.intake = Intake(epoch, self.intake.durable)

    def page(self, first: int, limit: int) -> Stretch:
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
