"""Verified: what came of evaluating recorded rows again, for machines and for a person."""

from msgspec import Struct

from qdgrasp_protocol.phrases import counted

SHOWN = 10
"""Rows that are shown to a person one by one."""


class Values(Struct, frozen=True, kw_only=True):
    """One column of one row."""

    recorded: str
    now: str


class Different(Struct, frozen=True, kw_only=True):
    """A row that is not what it was."""

    folder: str
    """Whose journal it is in."""
    run: str
    """The run that found it."""
    number: int
    """In the journal."""
    generation: int
    index: int
    trial: int
    columns: dict[str, Values]
    """Those that differ."""
    reason: str
    """Why it failed now; empty where it did not."""

    @property
    def words(self) -> str:
        """One line for a person."""
        told = ", ".join(
            f"{name} {values.now} instead of {values.recorded}" for name, values in self.columns.items()
        )
        failed = f" ({self.reason})" if self.reason else ""
        return f"row {self.number} of {self.folder}, trial {self.trial}: {told}{failed}"


class MadeOn(Struct, frozen=True, kw_only=True):
    """A platform that rows were made on."""

    rows: int
    """Evaluated again of those that were made on it."""
    platform: dict[str, str]
    differences: str
    """What this one has instead, in words; empty where it is the same."""

    @property
    def words(self) -> str:
        """One line for a person."""
        made = f"{self.rows} of them were made on"
        if not self.platform:
            return f"{made} a platform that is not recorded"
        return (
            f"{made} another platform; here is {self.differences}"
            if self.differences
            else f"{made} this platform"
        )


class Verified(Struct, frozen=True, kw_only=True):
    """What came of evaluating rows again."""

    rows: int
    """Evaluated again."""
    same: int
    """Of these, equal in every bit of every result."""
    runs: int
    """That the rows come from."""
    outcomes: dict[str, int]
    """How they ended, as is recorded."""
    different: list[Different]
    columns: dict[str, int]
    """In how many rows each column differs."""
    platform: dict[str, str]
    """On which they were evaluated now."""
    origins: list[MadeOn]

    @property
    def is_same(self) -> bool:
        """Whether every row is what it was."""
        return self.same == self.rows

    @property
    def table(self) -> str:
        """All of it for a person."""
        lines = [one.words for one in self.different[:SHOWN]]
        if len(self.different) > SHOWN:
            lines.append(f"... and {len(self.different) - SHOWN} more")
        if self.columns:
            counts = ", ".join(f"{name} in {counted(n, 'row')}" for name, n in self.columns.items())
            lines.append(f"columns that differ: {counts}")
        ended = ", ".join(f"{count} {name.replace('_', ' ')}" for name, count in self.outcomes.items())
        lines.append(f"{self.same} of {counted(self.rows, 'row')} the same: {ended}")
        return "\n".join([*lines, *(origin.words for origin in self.origins)])
