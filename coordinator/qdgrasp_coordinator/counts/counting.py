"""Counting: the tally of a journal's rows, block by block, and how it came to be."""

from collections.abc import Iterable

import numpy as np

from qdgrasp_coordinator.counts.curve import Trail
from qdgrasp_coordinator.counts.goals import Goals
from qdgrasp_coordinator.counts.tally import Tally
from qdgrasp_protocol.rows import Rows
from qdgrasp_protocol.spec import RunSpec
from qdgrasp_protocol.trials import trials


def tally(spec: RunSpec, blocks: Iterable[Rows], trail: Trail | None = None) -> Tally:
    """The tally of a journal, in its order, in blocks of any length; and how it came to be."""
    total = begun(spec)
    for block in blocks:
        go_on(total, spec, block, trail)
    return total


def begun(spec: RunSpec) -> Tally:
    """The tally of a journal that has no rows yet."""
    return Tally(spec.evaluations, spec.overlaps, trials(spec.protocol), Goals.of(spec))


def go_on(total: Tally, spec: RunSpec, block: Rows, trail: Trail | None = None) -> None:
    """Count the next rows of a journal, and note where each generation ends."""
    for number in np.unique(block["generation"]):
        rows = block[block["generation"] == number]
        total.count(rows)
        if ((rows["index"] == spec.population - 1) & (rows["trial"] == 0)).any():
            total.end_generation()
            if trail is not None:
                trail.note(total)
