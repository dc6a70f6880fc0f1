"""Sums: what all rows of a run come to, counted, or told of a run that keeps its successes alone."""

from collections import deque
from collections.abc import Iterable
from dataclasses import dataclass, fields

from qdgrasp_coordinator.counts.counting import tally
from qdgrasp_coordinator.folders.journal import Journal
from qdgrasp_protocol.rows import Rows
from qdgrasp_protocol.spec import RunSpec


@dataclass(frozen=True)
class Sums:
    """What all rows of a run come to; see `Summary` for what each counts."""

    evaluations: int
    complete: bool
    simulated: int
    proposals: int
    overlaps: int
    dead_ends: int
    cpu_seconds: float


def sums_of(journal: Journal, spec: RunSpec, blocks: Iterable[Rows]) -> Sums:
    """What the rows of one run come to; `blocks` are those that its journal holds, and all of them pass."""
    if journal.sources:
        deque(blocks, maxlen=0)
        told = journal.sources[0].summary
        return Sums(**{field.name: told[field.name] for field in fields(Sums)})
    total = tally(spec, blocks)
    return Sums(
        evaluations=total.evaluations,
        complete=total.finished is not None,
        simulated=total.simulated,
        proposals=total.proposals,
        overlaps=total.overlaps,
        dead_ends=total.dead_ends,
        cpu_seconds=journal.cpu_seconds,
    )
