"""The sign that a worker gives of itself, about once a second. Travels as JSON on `stat/worker/<wid>`."""

from msgspec import Struct

from qdgrasp_protocol.messages import Count, Text, Wid


class Sign(Struct, frozen=True, kw_only=True):
    """How a worker is."""

    wid: Wid
    host: Text
    run: Text = ""
    """Of the batch in work; empty: there is none."""
    rows: Count = 0
    """Of that batch."""
    progressed: bool = True
    """Whether its simulator did anything since the last sign."""
    memory: Count = 0
    """Bytes that it and its simulator take together; 0: unknown."""
    restarts: Count = 0
    """How often it has started its simulator again."""
