"""The team: the workers of a job, as its coordinator sees them and shows them, page by page."""

from msgspec import Struct

PAGE = 64
"""The most workers on one page."""


class WorkerFigures(Struct, frozen=True, kw_only=True):
    """A worker of a job, as the coordinator sees it."""

    wid: str
    """Its id: 32 hexadecimal digits, new at every start."""
    host: str
    """Where it runs."""
    pid: int
    """Of its process."""
    state: str
    """"working", "idle", "stuck" (it let a lease pass), "leaving" (it is drained) or "gone"."""
    batches: int
    """Batches that it holds."""
    rows: int
    """Rows that it has settled."""
    rate: float
    """Rows that it settled lately: a mean in which what is 10 s ago weighs 1 / e [1/s]."""
    seconds: float
    """Since it joined [s]."""
    seen: float
    """Since it was heard of last, by a sign, a result or a join [s]."""
    memory: int
    """What it and its simulator have of the memory, as it said last [bytes]; 0: it has not said."""
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
    """At most 64, in the order in which they joined; those that are gone stand last, for a minute."""
