"""The sign that a worker gives of itself, about once a second. Travels as JSON on `stat/worker/<wid>`."""

from msgspec import Struct

from qdgrasp_protocol.messages import Count, Text, Wid


class Sign(Struct, frozen=True, kw_only=True):
    """How a worker is."""

    wid: Wid
    """Its id."""
    host: Text
    """Where it runs."""
    run: Text = ""
    """Of the batch in work; empty: there is none."""
    rows: Count = 0
    """Of that batch; 0: there is none."""
    progressed: bool = True
    """Whether its simulator did anything since the last sign."""
    memory: Count = 0
    """What it and its simulator have of the memory [bytes]; 0: unknown."""
    restarts: Count = 0
    """How often it has started its simulator again."""
