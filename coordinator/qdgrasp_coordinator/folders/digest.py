"""The digest of a journal: equal for two runs of one spec, however they were carried out."""

import hashlib

from qdgrasp_coordinator.folders.journal import Journal


def digest(journal: Journal) -> str:
    """The sha256 over the bytes of the journal's rows in order, 64 hex digits.

    Where the blocks that hold the rows begin, and what they cost, when, and on which host, is not in it
    (docs/reproducibility.md).
    """
    total = hashlib.sha256()
    for rows in journal.blocks():
        total.update(rows.tobytes())
    return total.hexdigest()
