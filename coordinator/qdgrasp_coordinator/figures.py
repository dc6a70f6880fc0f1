"""The figures of a running search: defined once, published about once a second, shown by whoever listens."""

import json

import msgspec
from msgspec import Struct

from qdgrasp_protocol.errors import MessageError


class Figures(Struct, frozen=True, kw_only=True):
    """How far a run is. Travels as JSON on `stat/run/<run>`."""

    run: str
    evaluations: int
    """Counted evaluations."""
    budget: int
    rows: int
    """Journal rows, overlaps included."""
    proposals: int
    overlaps: int
    successes: int
    """A finger touches the object after closing."""
    grasps: int
    """Fitness 1 or more."""
    robust: int
    """Fitness 2."""
    errors: int
    cells: int
    """Distinct 1 cm cells with a success."""
    workers: int
    """Workers that have joined."""
    durable: int
    """Rows that the recorder reports to be on disk."""
    seconds: float
    """Since the coordinator opened the run."""
    rate: float
    """Counted evaluations per second since then, replayed ones apart."""
    trouble: str = ""
    """What keeps the run from going on, in words; empty when nothing does."""

    @property
    def words(self) -> str:
        """One line for a person."""
        if self.trouble:
            return f"{self.evaluations} of {self.budget} evaluations, paused: {self.trouble}"
        return (
            f"{self.evaluations} of {self.budget} evaluations, {self.rate:.0f}/s, "
            f"{self.successes} successes in {self.cells} cells, {self.workers} workers"
        )

    @property
    def left(self) -> str:
        """The time left in words, at the speed so far."""
        if self.rate <= 0:
            return "time left unknown"
        seconds = round(max(0, self.budget - self.evaluations) / self.rate)
        return f"{seconds // 60}:{seconds % 60:02d} left"


def to_json(figures: Figures) -> bytes:
    """The figures as JSON, readable with any zenoh tool."""
    return json.dumps(msgspec.to_builtins(figures)).encode()


def from_json(payload: bytes) -> Figures:
    """The figures in a message.

    Raises
    ------
    MessageError
        The payload is not such JSON.
    """
    try:
        return msgspec.json.decode(payload, type=Figures)
    except msgspec.DecodeError as error:
        raise MessageError(f"not figures: {error}") from None
