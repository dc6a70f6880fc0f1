"""The team: the workers of a job, as its coordinator sees them and shows them, page by page."""

from msgspec import Struct

PAGE = 64
"""The most workers on one page."""


class WorkerFigures(Struct, frozen=True, kw_only=True):
    """A worker of a job, as the coordinator sees it."""

    wid: str
    host: str
    pid: int
    state: str
    """"working", "idle", "stuck" (it let a lease pass), "leaving" (it is drained) or "gone"."""
    batches: int
    """Batches that it holds."""
    rows: int
    """Rows that it has settled."""
    rate: float
    """Rows per second that it settled lately."""
    seconds: float
    """Since it joined."""
    seen: float
    """Seconds since its last sign of progress."""
    memory: int
    """Bytes that it and its simulator take together, as it said last; 0: it has not said."""
    restarts: int
    """How often it has started its simulator again."""


class TeamFigures(Struct, frozen=True, kw_only=True):
    """A page of the workers of a job, in the order in which they joined. JSON on `stat/team/<page>`.

    A worker that is gone stays on it for a minute.
    """

    page: int
    """Counted from 0."""
    pages: int
    """How many there are; those of a higher number, shown before, are not valid any more."""
    workers: list[WorkerFigures]
    """At most `PAGE`."""
