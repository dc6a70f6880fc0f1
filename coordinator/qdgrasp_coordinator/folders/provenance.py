"""Provenance: which run each row of a journal comes from; a merged journal holds rows of several."""

from dataclasses import dataclass

from qdgrasp_coordinator.folders.folder import RunFolder
from qdgrasp_coordinator.folders.journal import Journal
from qdgrasp_protocol.spec import RunSpec


@dataclass(frozen=True)
class Provenance:
    """A run, and which rows of a journal are its own."""

    run: str
    """The name of the folder that it lay in when its rows were taken."""
    spec: RunSpec
    platform: dict[str, str]
    """What its rows were made on; empty where that is not known."""
    package: str
    """The version of this package that began it."""
    rows: range
    """Their numbers in the journal."""


def provenances(folder: RunFolder, journal: Journal) -> list[Provenance]:
    """The runs that the rows of a folder's journal come from, in the order of the rows."""
    if not journal.sources:
        name, rows = folder.path.absolute().name, range(journal.count)
        return [Provenance(name, folder.spec, journal.platform, journal.package, rows)]
    found, first = [], 0
    for source in journal.sources:
        rows = range(first, first + source.kept)
        found.append(Provenance(source.run, source.asked, source.platform, source.package, rows))
        first = rows.stop
    return found


def provenance(folder: RunFolder, journal: Journal, number: int) -> Provenance:
    """The run that a row comes from; the journal has a row of this number."""
    return next(one for one in provenances(folder, journal) if number in one.rows)
