"""Finds in a journal: its successes page by page, for those who draw them while the run goes on."""

import numpy as np

from qdgrasp_coordinator.counts.finds import Found, found, limit
from qdgrasp_coordinator.counts.legend import Legend
from qdgrasp_coordinator.counts.tally import successful
from qdgrasp_coordinator.folders.journal import Journal
from qdgrasp_protocol.rows import Rows

SCANNED = 1 << 16
"""So many journal rows are read for one page; more where the trials of its first success lie farther off."""
PLAIN = Legend()


def page(journal: Journal, first: int, legend: Legend = PLAIN) -> tuple[Found, int]:
    """Some successes (n,) from journal number `first` on, and the number from which to read on.

    At the end of the journal some may lack trials. They are told without eta, and are to be read again: the
    number from which to read on is theirs.
    """
    rows, is_last = _scanned(journal, first, legend)
    finds = _found(rows, first, legend, journal.shape.joints)
    lacking = finds["number"][finds["eta"] < 0] if legend.trials else finds["number"][:0]
    upto = int(lacking[0]) if len(lacking) else first + len(rows)
    if not is_last:
        finds = finds[finds["number"] < upto]
    if len(finds) > (most := limit(journal.shape.joints)):
        return finds[:most], min(upto, int(finds["number"][most]))
    return finds, upto


def _scanned(journal: Journal, first: int, legend: Legend) -> tuple[Rows, bool]:
    """Rows from a number on, all trials of the first success among them, and whether they are the last."""
    count, span = journal.count, SCANNED
    while True:
        stop = min(count, first + span)
        kept = journal.kept(first, stop) if first < stop else ()
        rows = np.concatenate([journal.shape.empty(0), *kept])
        is_last = stop >= count
        if is_last or not legend.trials or (legend.etas(rows)[:1] >= 0).all():
            return rows, is_last
        span *= 2


def _found(rows: Rows, first: int, legend: Legend, joints: int) -> Found:
    """The successes among consecutive rows, of which the first has the number `first`."""
    here = np.flatnonzero(successful(rows))
    numbers, successes = first + here, rows[here]
    synergy = legend.synergies(successes, numbers)
    return found(successes, joints, number=numbers, synergy=synergy, eta=legend.etas(rows))
