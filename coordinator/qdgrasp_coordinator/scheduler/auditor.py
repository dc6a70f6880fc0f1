"""Results of workers: read, held against their batch, and audited.

Trusted workers evaluate some rows of others again, and differences are judged here.
"""

import os
from collections.abc import Callable, Collection

import msgspec
import numpy as np

from qdgrasp_coordinator.scheduler.batch_queue import Audit, Batch, RunRef, ShapeBuild
from qdgrasp_coordinator.scheduler.worker_registry import Worker
from qdgrasp_protocol.build_messages import Built
from qdgrasp_protocol.errors import MessageError
from qdgrasp_protocol.messages import TRUST_VARIABLE, Failure, Result, shorten
from qdgrasp_protocol.rows import RESULT, Outcome, Rows, RowShape, unpack_possible

AUDITED, FIRST_ROWS = 0.01, 50
"""Trusted workers evaluate such a share of each worker's rows again, and some 50 in 50 + n near its n-th."""


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
        is_drawn = self._random.random(len(rows)) < AUDITED + FIRST_ROWS / (FIRST_ROWS + before)
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


def complete_rows(rows: Rows, batch: Batch, failed: Collection[int]) -> None:
    """Fill the batch's keys and genomes into result rows; failed rows then hold zeros else."""
    if failed:
        rows[list(failed)] = np.zeros((), dtype=rows.dtype)
    rows["generation"] = batch.rows.number
    rows["index"] = batch.rows.indices
    rows["trial"] = batch.rows.trials
    rows["genome"] = batch.rows.genomes


def read_result(result: Result, shape: RowShape) -> tuple[Result, Rows]:
    """Return a result and its rows; impossible ones count as failed, unreadable ones all."""
    if len(result.failures) == result.n:
        return result, shape.empty(result.n)
    rows = shape.empty(result.n)
    try:
        reasons = unpack_possible(rows, RESULT, result.columns)
    except MessageError as error:
        rows, reasons = shape.empty(result.n), dict.fromkeys(range(result.n), str(error))
    if reasons:
        rows[list(reasons)] = np.zeros((), dtype=rows.dtype)
        told = {failure.row: failure.reason for failure in result.failures} | reasons
        failures = [Failure(row=row, reason=shorten(reason)) for row, reason in sorted(told.items())]
        result = msgspec.structs.replace(result, failures=failures)
    return result, rows


def check_result(task: Batch | ShapeBuild, result: Result | Built) -> None:
    """Raise a MessageError for an answer that does not fit what was leased."""
    if isinstance(task, ShapeBuild) or isinstance(result, Built):
        if not (isinstance(task, ShapeBuild) and isinstance(result, Built)):
            raise MessageError("a shape is no answer to a batch, nor rows to a build")
        return
    if result.run != task.run.run:
        raise MessageError(f"a result is of run '{result.run}', its batch of '{task.run.run}'")
    if result.n != len(task):
        raise MessageError(f"a result has {result.n} rows, its batch {len(task)}")
    for failure in result.failures:
        if failure.row >= result.n:
            raise MessageError(f"a result of {result.n} rows names row {failure.row} as failed")
