"""Compares rows evaluated again with recorded ones, bit for bit, and describes differences."""

from collections.abc import Mapping

import numpy as np
from msgspec import Struct

from qdgrasp_coordinator.storage import platforms
from qdgrasp_protocol.replay_messages import REPLAYED, ReplayAnswer
from qdgrasp_protocol.rows import RESULT, Outcome, unpack
from qdgrasp_protocol.text import counted

ROWS_SHOWN = 10  # Rows that are shown to a person one by one


class ComparedValues(Struct, frozen=True, kw_only=True):
    """Recorded and present value of one column of one row."""

    recorded: str
    now: str


class DifferentRow(Struct, frozen=True, kw_only=True):
    """A row whose result differs from the recorded one."""

    folder: str
    """Folder of the journal that it is in."""
    number: int
    trial: int
    columns: dict[str, ComparedValues]
    reason: str
    """Reason of its failure now; empty where it did not fail."""

    @property
    def words(self) -> str:
        """One line for a person."""
        changes = ", ".join(difference_words(self.columns))
        failed = f" ({self.reason})" if self.reason else ""
        return f"row {self.number} of {self.folder}, trial {self.trial}: {changes}{failed}"


class PlatformShare(Struct, frozen=True, kw_only=True):
    """A platform that rows were made on."""

    rows: int
    """Rows evaluated again that were made on it."""
    platform: dict[str, str]
    differences: str
    """Entries that this platform has instead, in words; empty where it is the same."""

    @property
    def words(self) -> str:
        """The platform, beside this one, for a person."""
        bits = f"; {GPU_BITS}" if platforms.is_of_gpu(self.platform) else ""
        if not self.platform:
            return "a platform that is not recorded"
        return (
            f"another platform; here is {self.differences}" if self.differences else "this platform"
        ) + bits


class VerificationReport(Struct, frozen=True, kw_only=True):
    """Result of evaluating recorded rows again."""

    rows: int
    same: int
    """Rows that are equal in every bit of every result."""
    outcomes: dict[str, int]
    """Rows by their recorded outcome."""
    different: list[DifferentRow]
    columns: dict[str, int]
    """Number of rows in which each column differs."""
    platform: dict[str, str]
    """Platform on which they were evaluated now."""
    origins: list[PlatformShare]

    @property
    def is_same(self) -> bool:
        """True if every row is as recorded."""
        return self.same == self.rows

    @property
    def table(self) -> str:
        """The result as text for a person."""
        lines = [one.words for one in self.different[:ROWS_SHOWN]]
        if len(self.different) > ROWS_SHOWN:
            lines.append(f"... and {len(self.different) - ROWS_SHOWN} more")
        if self.columns:
            counts = ", ".join(f"{name} in {counted(n, 'row')}" for name, n in self.columns.items())
            lines.append(f"columns that differ: {counts}")
        ended = ", ".join(f"{count} {name.replace('_', ' ')}" for name, count in self.outcomes.items())
        lines.append(f"{self.same} of {counted(self.rows, 'row')} the same: {ended}")
        return "\n".join([*lines, *(f"{one.rows} of them were made on {one.words}" for one in self.origins)])


GPU_BITS = "on a GPU rows have no fixed bits"


def row_with_answer(row: np.void, answer: ReplayAnswer) -> np.void:
    """Return a row with the results of its replay in place of the recorded ones."""
    now: np.void = unpack(row.reshape(1).copy(), REPLAYED, answer.columns)[0]
    return now


def row_differences(recorded: np.void, now: np.void) -> dict[str, ComparedValues]:
    """Return the results in which two rows of one shape differ in any bit, with both values."""
    return {
        name: ComparedValues(recorded=column_words(recorded, name), now=column_words(now, name))
        for name in (column.name for column in RESULT)
        if recorded[name].tobytes() != now[name].tobytes()
    }


def difference_words(columns: Mapping[str, ComparedValues]) -> list[str]:
    """Describe the differences, column by column."""
    return [f"{name} {values.now} instead of {values.recorded}" for name, values in columns.items()]


def column_words(row: np.void, column: str) -> str:
    """Format a column of a row for a person, to the last bit."""
    value = row[column]
    if column == "outcome":
        return Outcome(value).name.lower() if value in set(Outcome) else str(value)
    return " ".join(str(number) for number in np.atleast_1d(value))
