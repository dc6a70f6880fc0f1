"""Findings: what a check says of a gripper or an object of one's own."""

from collections.abc import Iterator

from msgspec import Struct


class Findings(Struct, frozen=True, kw_only=True):
    """What was found of an asset; each kind adds fields and lines of its own."""

    name: str
    notes: tuple[str, ...] = ()
    """What is worth a thought."""
    faults: tuple[str, ...] = ()
    """Why it cannot be used; empty where it can."""

    @property
    def table(self) -> str:
        """All of it, one fact to a line."""
        notes, faults = (("note", words) for words in self.notes), (("WRONG", words) for words in self.faults)
        return "\n".join(f"{label:<16} {words}" for label, words in (*self._lines(), *notes, *faults))

    @property
    def facts(self) -> tuple[str, ...]:
        """The most of it, in a few words each."""
        return ()

    def _lines(self) -> Iterator[tuple[str, str]]:
        """Labels and words, notes and faults apart."""
        yield "name", self.name
