"""The journals that are open for writing, a few at a time: each holds three files open."""

from pathlib import Path

from qdgrasp_coordinator.folders.journal_format import Identity
from qdgrasp_coordinator.folders.journal_writer import JournalWriter


class Journals:
    """Opens journals as they are needed, and closes the one that was not used for longest.

    A context manager that closes them all. Raises as `JournalWriter.open` and `JournalWriter.create`.

    Parameters
    ----------
    most
        How many may be open; at least 1.
    """

    def __init__(self, most: int) -> None:
        self._most = most
        self._open: dict[Path, JournalWriter] = {}

    def __len__(self) -> int:
        """How many are open."""
        return len(self._open)

    def at(self, folder: Path) -> JournalWriter:
        """The journal in a run's folder, to be used before the next one is asked for."""
        journal = self._open.pop(folder, None) or self._make_room().open(folder)
        self._open[folder] = journal  # the last one is the one used last
        return journal

    def begin(self, folder: Path, identity: Identity) -> None:
        """Begin the journal of a run."""
        self._open[folder] = self._make_room().create(folder, identity)

    def __enter__(self) -> "Journals":
        return self

    def __exit__(self, *_: object) -> None:
        while self._open:
            self._close_oldest()

    def _make_room(self) -> type[JournalWriter]:
        while len(self._open) >= self._most:
            self._close_oldest()
        return JournalWriter

    def _close_oldest(self) -> None:
        self._open.pop(next(iter(self._open))).close()
