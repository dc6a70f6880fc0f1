"""Legends of journals, read from the folders of their runs and kept."""

from itertools import accumulate
from pathlib import Path

from qdgrasp_coordinator.analysis.diversity import synergies_of
from qdgrasp_coordinator.counts.legend import Legend
from qdgrasp_coordinator.counts.niches import synergies
from qdgrasp_coordinator.folders.folder import RunFolder
from qdgrasp_coordinator.folders.journal import Journal
from qdgrasp_coordinator.searches.search import method
from qdgrasp_protocol.trials import trials

MOST = 256
"""So many are kept, a few hundred bytes each."""
Name = tuple[Path, float, str, int]
"""The folder of a run; of its journal when it was begun, its scene, and from how many runs it is."""


class Legends:
    """The legends of journals; any thread may ask.

    Raises
    ------
    FolderError
        The scene of a run cannot be read.
    """

    def __init__(self) -> None:
        self._known: dict[Name, Legend] = {}

    def of(self, folder: RunFolder, journal: Journal) -> Legend:
        """That of the journal of a run; one without its scene names no synergies."""
        name = (folder.path, journal.created, journal.scene, len(journal.sources))
        if name in self._known:
            return self._known[name]
        if len(self._known) >= MOST:
            self._known.clear()
        made = legend(folder, journal)
        if folder.has_bundle():
            self._known[name] = made
        return made


def legend(folder: RunFolder, journal: Journal) -> Legend:
    """The legend of the journal of a run; raises as `Legends`."""
    sources = journal.sources
    if not sources:
        return Legend(trials(folder.spec.protocol), ((0, synergies_of(folder)),))
    scene, asked = folder.scene(), [source.asked for source in sources]
    ends = accumulate(source.kept for source in sources)
    named = (synergies(scene, method(spec.method).prior) for spec in asked)
    return Legend(trials(asked[0].protocol), tuple(zip(ends, named, strict=True)))
