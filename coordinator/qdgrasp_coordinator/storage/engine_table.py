"""Tables of the verdicts of another engine on a run's successes (docs/engines.md).

`qdgrasp verify --engine NAME` writes `engine-NAME.csv` into the run's folder.
"""

from pathlib import Path

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from qdgrasp_coordinator.storage.outputs import OutFile
from qdgrasp_coordinator.storage.run_folder import RunFolder
from qdgrasp_coordinator.storage.tables import Value, csv_text, read_csv
from qdgrasp_protocol.errors import InputError
from qdgrasp_protocol.rows import Outcome, Rows
from qdgrasp_protocol.spec import ENGINES, engine_names

VERDICT = np.dtype([("outcome", "i1"), ("fitness", "<f4")])
"""A verdict; -1 and NaN where it is not known."""
UNKNOWN = np.array((-1, np.nan), VERDICT)
TABLE = np.dtype(
    [
        ("row", "<i8"),
        *((name + end, VERDICT[name]) for end in ("", "_now") for name in ("outcome", "fitness")),
    ]
)
"""Row of a table: its number in the journal, its verdict as recorded, and that in the other engine."""

COLUMNS = TABLE.names or ()
OUTCOMES = ("outcome", "outcome_now")  # Columns that are words in a file

EngineTable = NDArray[np.void]  # (n,) of `TABLE`, by row
Verdicts = NDArray[np.void]  # (n,) of `VERDICT`


class HeldShare(Struct, frozen=True):
    """Share of the grasps that hold which do so in another engine too."""

    held: int
    """Of the grasps in its table that hold as recorded: those that hold there."""
    known: int
    """Grasps in its table that hold as recorded."""

    @property
    def words(self) -> str:
        """The share for a person."""
        return f"{self.held} of {self.known}" + (f", {self.held / self.known:.0%}" if self.known else "")


def table_path(folder: RunFolder, engine: str) -> Path:
    """The file of a run's verdicts in an engine."""
    return folder.path / f"engine-{engine}.csv"


def check_table(folder: RunFolder, engine: str) -> None:
    """Check that verdicts can be written into a run's table, before they are made."""
    path = table_path(folder, engine)
    OutFile(path, force=True).check()
    if path.is_file():
        read_table(path)


def write_table(
    folder: RunFolder, engine: str, numbers: NDArray[np.int64], recorded: Rows, now: Rows
) -> Path:
    """Write both verdicts of rows by number (n,).

    Verdicts of other rows stay in the table.
    """
    made = np.zeros(len(numbers), TABLE)
    made["row"] = numbers
    for name in ("outcome", "fitness"):
        made[name], made[name + "_now"] = recorded[name], now[name]
    path = table_path(folder, engine)
    if path.is_file():
        before = read_table(path)
        made = np.concatenate([before[~np.isin(before["row"], numbers)], made])
        made = made[np.argsort(made["row"])]
    lines: list[dict[str, Value]] = [dict(zip(COLUMNS, map(int, row), strict=True)) for row in made.tolist()]
    for line, row in zip(lines, made, strict=True):
        line.update({name: Outcome(row[name]).name.lower() for name in OUTCOMES})
    text = csv_text(lines, COLUMNS)
    OutFile(path, force=True).write(text.encode())
    return path


def read_table(path: Path) -> EngineTable:
    """Read a table; raises InputError for another file."""
    try:
        lines = [
            line | {name: Outcome[line[name].upper()] for name in OUTCOMES}
            for line in read_csv(path, COLUMNS)
        ]
        table = np.array([tuple(int(line[name]) for name in COLUMNS) for line in lines], TABLE)
    except (ValueError, KeyError, OverflowError, InputError) as error:
        raise InputError(
            f"{path} is no table that `qdgrasp verify --engine` wrote ({error}); remove it and write it anew."
        ) from None
    return table[np.argsort(table["row"])]


def other_tables(folder: RunFolder) -> dict[str, EngineTable]:
    """The tables of a run by engine, but for engines that it was simulated in itself."""
    others = [name for name in ENGINES if name not in engine_names(folder.spec.engine)]
    return {name: read_table(path) for name in others if (path := table_path(folder, name)).is_file()}


def verdicts(table: EngineTable, numbers: NDArray[np.integer], outcomes: NDArray[np.integer]) -> Verdicts:
    """The other engine's verdicts on rows by number and recorded outcome (n,).

    Unknown are rows that the table lacks, or that it says another outcome of: it is of another journal.
    """
    found = np.full(len(numbers), UNKNOWN)
    if len(table):
        places = np.searchsorted(table["row"], numbers).clip(max=len(table) - 1)
        lines = table[places]
        known = (lines["row"] == numbers) & (lines["outcome"] == outcomes)
        for name in ("outcome", "fitness"):
            found[name][known] = lines[name + "_now"][known]
    return found


def held_shares(folder: RunFolder) -> dict[str, HeldShare]:
    """Of each other engine that a run has a table of, how many that hold do so there too."""
    found = {}
    for name, table in other_tables(folder).items():
        held = table[table["outcome"] == Outcome.HELD]
        found[name] = HeldShare(int((held["outcome_now"] == Outcome.HELD).sum()), len(held))
    return found
