"""The sign that a worker gives of itself, about once a second. Travels as JSON on `stat/worker/<wid>`."""

from typing import Annotated

from msgspec import Meta, Struct

from qdgrasp_protocol.messages import Count, Text, Wid


class Sign(Struct, frozen=True, kw_only=True):
    """How a worker is."""

    wid: Annotated[Wid, Meta(description="Its id.")]
    host: Annotated[Text, Meta(description="Where it runs.")]
    run: Annotated[Text, Meta(description="Of the batch in work; empty: there is none.")] = ""
    rows: Annotated[Count, Meta(description="Of that batch; 0: there is none.")] = 0
    progressed: Annotated[
        bool, Meta(description="Whether its simulator did anything since the last sign.")
    ] = True
    memory: Annotated[
        Count, Meta(description="What it and its simulator have of the memory [bytes]; 0: unknown.")
    ] = 0
    restarts: Annotated[Count, Meta(description="How often it has started its simulator again.")] = 0
