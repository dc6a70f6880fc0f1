"""Events: what happens to a job that a person wants to know."""

from datetime import datetime
from typing import Annotated, Literal

from msgspec import Meta, Struct

KEPT = 200
"""So many events a coordinator remembers for those who come late."""

EventKind = Literal["job", "run", "worker", "recorder", "trouble", "error"]
"""What it is about; "trouble" keeps a job from going on, "error" is a row that is given up, or a run."""


class Event(Struct, frozen=True, kw_only=True):
    """Something that happened. Travels as JSON on `event/<kind>`."""

    number: Annotated[int, Meta(description="Counts the events of one coordinator process, from 1.")]
    at: Annotated[datetime, Meta(tz=True, description="When.")]
    kind: Annotated[
        EventKind,
        Meta(
            description="job, run, worker, recorder; trouble keeps a job from going on; "
            "error: a row or run is given up."
        ),
    ]
    words: Annotated[str, Meta(description="What, in a sentence for a person.")]
    run: Annotated[str, Meta(description="Which run it is about; empty: none.")] = ""
    worker: Annotated[str, Meta(description="Which worker (its `wid`) it is about; empty: none.")] = ""


class Events(Struct, frozen=True, kw_only=True):
    """The latest events, eldest first, at most `KEPT`. JSON, the answer to a query on `event/recent`."""

    events: Annotated[list[Event], Meta(description="At most 200, eldest first.")]
