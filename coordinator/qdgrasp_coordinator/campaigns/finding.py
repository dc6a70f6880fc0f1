"""What a finished run has found, kept beside its journal so that a large campaign need not read that again.

* `found.json`   the totals, and a mark of the journal, the end and the version that they are of
"""

from contextlib import suppress
from importlib.metadata import version

import msgspec
from msgspec import Struct

from qdgrasp_coordinator.counts.totals import NAMES, Totals
from qdgrasp_coordinator.folders import disk
from qdgrasp_coordinator.folders.folder import RunFolder
from qdgrasp_protocol.errors import FolderError
from qdgrasp_protocol.spec import GOALS, RunSpec

FILE = "found.json"


class Finding(Struct, frozen=True):
    """What was found, and by what."""

    mark: str
    totals: Totals


def read(folder: RunFolder, spec: RunSpec) -> Totals | None:
    """What a run has found that was finished under `spec`; None: that is not known."""
    file = folder.path / FILE
    if not file.is_file():
        return None
    with suppress(FolderError, msgspec.MsgspecError):
        known = msgspec.json.decode(disk.read(file), type=Finding)
        if known.mark == _mark(folder, spec):
            return known.totals
    return None


def write(folder: RunFolder, spec: RunSpec, found: Totals) -> None:
    """Keep what a finished run has found; a disk that cannot take it goes without."""
    with suppress(FolderError):
        disk.replace(folder.path / FILE, msgspec.json.encode(Finding(_mark(folder, spec), found)))


def _mark(folder: RunFolder, spec: RunSpec) -> str:
    """What the totals depend on: the rows, where they end, and what is counted how."""
    with folder.journal() as journal:
        ends = [str(getattr(spec, key)) for key in GOALS]
        return " ".join([journal.mark, *ends, version("qdgrasp"), *NAMES])
