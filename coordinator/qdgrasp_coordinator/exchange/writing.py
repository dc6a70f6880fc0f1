"""Writing grasps: the table of formats, and a file or folder that appears whole or not at all."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from qdgrasp_coordinator.exchange import acronym, csv_table, graspgen, isaac, moveit, parquet
from qdgrasp_coordinator.exchange.about import About
from qdgrasp_coordinator.exchange.grasps import Grasps
from qdgrasp_coordinator.folders import disk
from qdgrasp_protocol.errors import FolderError, UnknownName

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

    @property
    def is_folder(self) -> bool:
        """Whether it is a folder of files."""
        return not self.suffix


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


def check_free(out: Path, form: Format, *, force: bool = False) -> None:
    """Check that grasps can be written at `out`: nothing is there, or what may be replaced.

    Raises
    ------
    FolderError
        Something is there that may not.
    """
    if not form.is_folder:
        if out.is_dir():
            raise FolderError(
                f"{out} is a folder, and {form.name} is written as a file; name another with -o."
            )
        disk.check_file(out, force=force)
    elif out.is_symlink() or (out.exists() and not out.is_dir()):
        raise FolderError(f"{out} is a file, and {form.name} is written as a folder; name another with -o.")
    elif out.exists() and not graspgen.is_ours(out) and any(out.iterdir()):
        raise FolderError(f"{out} holds other files than {form.name} has; name a new folder with -o.")
    elif out.exists() and not force:
        raise FolderError(f"{out} is there already; name another folder, or replace it with --force.")


def write(out: Path, form: Format, grasps: Grasps, about: About) -> None:
    """Write grasps to a file or folder, which replaces what is there at once.

    Raises
    ------
    DiskFull, FolderError
        It cannot be written.
    """
    with disk.writing(out.absolute().parent), disk.workshop(out) as part:
        made, old = part / "new", part / "old"
        form.write(made, grasps, about)
        if out.is_dir():
            out.rename(old)
        try:
            made.rename(out)
        except OSError:
            if old.exists():
                old.rename(out)
            raise
        disk.sync(out.absolute().parent)
