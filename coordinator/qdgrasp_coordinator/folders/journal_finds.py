"""Finds in a journal: its successes page by page, for those who draw them while the run goes on."""

from collections.abc import Iterable

import numpy as np

from qdgrasp_coordinator.counts.finds import Found, found, layout, limit
from qdgrasp_coordinator.counts.tally import successful
from qdgrasp_coordinator.folders.journal import Journal
from qdgrasp_protocol.rows import Rows

SCANNED = 1 << 16
"""So many journal rows are read for one page."""


def page(journal: Journal, first: int) -> tuple[Found, int]:
    """Some successes (n,) from journal number `first` on, and the number from which to read on."""
    joints = journal.shape.joints
    stop, most = min(journal.count, first + SCANNED), limit(joints)
    finds = _found(journal.kept(first, stop) if first < stop else (), first, joints)
    if len(finds) > most:
        return finds[:most], int(finds["number"][most])
    return finds, max(first, stop)


def _found(blocks: Iterable[Rows], first: int, joints: int) -> Found:
    """The successes among consecutive rows, of which the first has the number `first`."""
    kept = [np.zeros(0, layout(joints))]
    for rows in blocks:
        here = np.flatnonzero(successful(rows))
        kept.append(found(rows[here], first + here, joints))
        first += len(rows)
    return np.concatenate(kept)
