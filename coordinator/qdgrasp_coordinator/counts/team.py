"""The team: the workers of a job, as its coordinator sees them and shows them, page by page."""

from typing import Annotated

from msgspec import Meta, Struct

PAGE = 64
"""The most workers on one page."""


class WorkerFigures(Struct, frozen=True, kw_only=True):
    """A worker of a job, as the coordinator sees it."""

    wid: Annotated[str, Meta(description="Its id: 32 hexadecimal digits, new at every start.")]
    host: Annotated[str, Meta(description="Where it runs.")]
    pid: Annotated[int, Meta(description="Of its process.")]
    state: Annotated[
        str,
        Meta(
            description='"working", "idle", "stuck" (it let a lease pass), '
            '"leaving" (it is drained) or "gone".'
        ),
    ]
    batches: Annotated[int, Meta(description="Batches that it holds.")]
    rows: Annotated[int, Meta(description="Rows that it has settled.")]
    rate: Annotated[
        float,
        Meta(description="Rows that it settled lately: a mean in which what is 10 s ago weighs 1 / e [1/s]."),
    ]
    seconds: Annotated[float, Meta(description="Since it joined [s].")]
    seen: Annotated[float, Meta(description="Since it was heard of last, by a sign, a result or a join [s].")]
    memory: Annotated[
        int,
        Meta(
            description="What it and its simulator have of the memory, as it said last [bytes]; "
            "0: it has not said."
        ),
    ]
    restarts: Annotated[int, Meta(description="How often it has started its simulator again.")]


class TeamFigures(Struct, frozen=True, kw_only=True):
    """A page of the workers of a job, in the order in which they joined. JSON on `stat/team/<page>`.

    A worker that is gone stays on it for a minute.
    """

    page: Annotated[int, Meta(description="Counted from 0.")]
    pages: Annotated[
        int,
        Meta(
            description="How many there are; those of a higher number, shown before, are not valid any more."
        ),
    ]
    workers: Annotated[
        list[WorkerFigures],
        Meta(
            description="At most 64, in the order in which they joined; "
            "those that are gone stand last, for a minute."
        ),
    ]
