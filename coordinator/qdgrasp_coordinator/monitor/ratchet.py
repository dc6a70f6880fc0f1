"""The ratchet: counts of a job and its runs that do not fall where another coordinator goes on with them.

What a coordinator told and a recorder had not written is lost with it, and found again; runs are opened again
one by one. To whoever takes differences of counts, all that was ever found would seem to be found at once.
"""

from collections.abc import Mapping
from typing import Any, TypeVar

from msgspec import structs

from qdgrasp_coordinator.counts.figures import Figures, JobFigures, JobMeta
from qdgrasp_coordinator.counts.totals import NAMES

Found = TypeVar("Found", Figures, JobFigures)

COUNTS = frozenset({*NAMES, "rows", "outcomes"})
"""What only grows while a job goes on: numbers, or numbers by name. Jobs do not have all of them."""


def raised(now: Found, before: Found | None) -> Found:
    """The figures now, with no count below what it was before; what is counted does not remain."""
    if before is None:
        return now
    names = COUNTS.intersection(now.__struct_fields__)
    counts = {name: _greater(getattr(before, name), getattr(now, name)) for name in names}
    if isinstance(now, JobFigures):
        counts["remaining"] = max(0, now.remaining - (counts["evaluations"] - now.evaluations))
    return structs.replace(now, **counts)


def goes_on(before: JobMeta, now: JobMeta) -> bool:
    """Whether it is the coordinator of before, or one that goes on with its work.

    Turns are counted, which is all there is to go by where a job has no identity.
    """
    if before.identity and now.identity:
        return before.identity == now.identity
    return now.since == before.since or not now.epoch or now.epoch > before.epoch


def _greater(before: Any, now: Any) -> Any:
    if isinstance(now, Mapping):
        return {name: max(before.get(name, 0), count) for name, count in now.items()}
    return max(before, now)
