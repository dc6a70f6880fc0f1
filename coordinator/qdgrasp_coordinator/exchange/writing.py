"""Writing grasps: the table of formats, each a file or a folder."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from qdgrasp_coordinator.exchange import acronym, csv_table, graspgen, isaac, moveit, parquet
from qdgrasp_coordinator.exchange.about import About
from qdgrasp_coordinator.exchange.grasps import Grasps
from qdgrasp_coordinator.folders.outputs import OutFile, OutFolder, Whole
from qdgrasp_protocol.errors import UnknownName

Write = Callable[[Path, Grasps, About], None]
ALL = -1
"""So many failures as there are."""


@dataclass(frozen=True)
class Format:
    """One line of the table."""

    name: str
    write: Write
    """Writes a new file or folder."""
    suffix: str
    """What files of it are called by others; empty: it is a folder."""
    negatives: int | None = 0
    """Failures that are written unless it is said how many; None: the format has no place for them."""

    def output(self, path: Path, *, force: bool = False) -> Whole:
        """The file or folder at a path; by force one that is there is replaced, if it is of the format."""
        if self.suffix:
            return OutFile(path, force=force)
        return OutFolder(path, force=force, is_kind=graspgen.is_ours)


FORMATS = {
    each.name: each
    for each in (
        Format("isaac", isaac.write, ".yaml", negatives=None),
        Format("acronym", acronym.write, ".h5"),
        Format("graspgen", graspgen.write, "", negatives=ALL),
        Format("parquet", parquet.write, ".parquet"),
        Format("moveit", moveit.write, ".yaml", negatives=None),
        Format("csv", csv_table.write, ".csv"),
    )
}


def format_of(name: str) -> Format:
    """The format of that name.

    Raises
    ------
    UnknownName
        There is none.
    """
    if name not in FORMATS:
        raise UnknownName("format", name, FORMATS)
    return FORMATS[name]


def write(out: Whole, form: Format, grasps: Grasps, about: About) -> None:
    """Write grasps to a file or folder.

    Raises
    ------
    DiskFull, OutputError
        It cannot be written.
    """
    with out.writing() as made:
        form.write(made, grasps, about)
