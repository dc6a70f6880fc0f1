"""Audits: rows of other workers that trusted ones evaluate again, and their verdict."""

import os
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from qdgrasp_coordinator.scheduler.batch_queue import Batch, RunRef
from qdgrasp_coordinator.scheduler.worker_registry import Worker
from qdgrasp_protocol.messages import TRUST_VARIABLE
from qdgrasp_protocol.rows import Outcome, Rows

AUDITED = 0.01
"""Share of each worker's rows that trusted workers evaluate again, besides one in n near its n-th row."""


@dataclass(eq=False, kw_only=True)
class Audit(Batch):
    """Rows of the one worker in `tried_by`, which a trusted one evaluates again."""

    is_audit: bool = True
    recorded: Rows
    """(n,): what that worker made of them."""
    answer: Rows | None = None
    """What a trusted worker made of them: it is to be confirmed; None: nothing yet."""


class Auditor:
    """Draws the rows to audit, and judges their makers; `audit` has rows evaluated again."""

    def __init__(self, audit: Callable[..., None]) -> None:
        self._audit = audit
        self._random = np.random.default_rng()  # No worker knows it, and no result depends on it

    def draw(self, run: RunRef, rows: Rows, maker: Worker | None) -> None:
        """Draw some of the rows (n,) that a worker has just made, its first ones more densely."""
        if maker is None or maker.is_trusted or run.needs_device or TRUST_VARIABLE not in os.environ:
            return
        before = np.maximum(maker.rows - len(rows), 0) + np.arange(len(rows))
        is_drawn = self._random.random(len(rows)) < AUDITED + 1 / (1 + before)
        is_drawn &= rows["outcome"] != Outcome.ERROR
        if is_drawn.any():
            self._audit(run, rows[is_drawn], maker.wid)

    def first_wrong(self, audit: Audit, rows: Rows) -> np.void | None:
        """Return the first recorded row that is certainly wrong; None without one.

        A trusted worker made `rows` (n,). A difference counts once a second evaluation has the same bits.
        """
        now, recorded = ([row.tobytes() for row in each] for each in (rows, audit.recorded))
        known = np.flatnonzero(rows["outcome"] != Outcome.ERROR).tolist()
        differing = [n for n in known if now[n] != recorded[n]]
        if audit.answer is not None:
            wrong = [n for n in differing if now[n] == audit.answer[n].tobytes()]
            return audit.recorded[wrong[0]] if wrong else None
        if differing:
            self._audit(audit.run, audit.recorded[differing], audit.tried_by[0], rows[differing])
        return None
