"""Successes of a journal page by page, for monitors that draw them as the run goes on."""

from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray

from qdgrasp_coordinator.metrics.cells import UNKNOWN_GENOMES, GenomeReader
from qdgrasp_coordinator.metrics.successes import (
    NO_TRIALS,
    TrialPlan,
    all_successes,
    find_successes,
    join_successes,
)
from qdgrasp_coordinator.storage.journal import Journal
from qdgrasp_protocol.messages import SuccessPage, deflated
from qdgrasp_protocol.rows import RESULT, RowColumn, Rows, RowShape, pack, unpack

NO_ETA = -1.0  # Placeholder for an eta that is not known


@dataclass(frozen=True)
class RowContext:
    """Context for reading a journal's rows: its trials, and how to read its genomes."""

    plan: TrialPlan = NO_TRIALS
    """Numbers of trials of a success."""
    genomes: GenomeReader = UNKNOWN_GENOMES


SUCCESS_COLUMNS = (
    RowColumn("number", "<u4", "1", "the row's number in the journal"),
    RowColumn("outcome", "<u1", "1", "`Outcome`"),
    RowColumn("fitness", "<f4", "1", "disturbances survived; the sum over the trials is not in it"),
    RowColumn(
        "descriptor", "<f4", "3", "the hand's commanded position [m], CoM frame: what cells are made of"
    ),
    RowColumn(
        "base_to_object", "<f4", "7", "the hand's root link in the object's CoM frame: x y z [m], qx qy qz qw"
    ),
    RowColumn("joints", "<f4", "joints", "finger joint positions at the grasp [rad or m]"),
    RowColumn("pregrasp", "<f4", "joints", "finger joint positions that the hand starts from [rad or m]"),
    RowColumn(
        "synergy", "<i2", "1", "the synergy that closed the hand, by its place in the gripper; -1: none"
    ),
    RowColumn("eta", "<f4", "1", "estimated probability of transfer; -1 where too few trials are recorded"),
    RowColumn("trials", "<u2", "1", "trials of it that are recorded"),
    *(
        column
        for column in RESULT
        if column.name in ("contacts", "penetration", "settled", "contact_links", "contact_points")
    ),
)
MOST_SUCCESSES = 4096  # The most finds in one answer
MOST_BYTES = 1 << 20  # The most bytes of all columns of one answer

SuccessTable = NDArray[np.void]  # A structured array with the dtype of `success_dtype`


@cache
def success_dtype(joints: int, contact_slots: int) -> np.dtype[np.void]:
    """The dtype of finds of a hand with so many joints, with room for so many contacts."""
    return RowShape(0, joints, contact_slots=contact_slots).dtype_of(SUCCESS_COLUMNS)


def success_table(rows: Rows, shape: RowShape, **columns: NDArray[np.number]) -> SuccessTable:
    """Return successes (n,) as finds (n,); the others are the columns that rows lack."""
    finds = np.zeros(len(rows), dtype=success_dtype(shape.joints, shape.contact_slots))
    for column in SUCCESS_COLUMNS:
        values = columns[column.name] if column.name in columns else rows[column.name]
        finds[column.name] = values[..., :3] if column.name == "descriptor" else values
    return finds


def page_to_message(finds: SuccessTable, upto: int, journal: Journal, run: str) -> SuccessPage:
    """Pack successes up to row `upto` of a run's journal."""
    return SuccessPage(
        run=run,
        scene=journal.scene,
        began=journal.created,
        next=upto,
        rows=journal.count,
        n=len(finds),
        joints=journal.shape.joints,
        contact_slots=journal.shape.contact_slots,
        columns=deflated(pack(finds, SUCCESS_COLUMNS)),
    )


def page_from_message(message: SuccessPage) -> SuccessTable:
    """Return the successes (n,) in a message.

    Raises `MessageError` where a column is missing, of the wrong length, or holds no finite number.
    """
    finds = np.zeros(message.n, dtype=success_dtype(message.joints, message.contact_slots))
    return unpack(finds, SUCCESS_COLUMNS, message.columns)


ROWS_SCANNED = 1 << 16  # Journal rows read for a page; more where trials of the first success lie farther off


def success_page(journal: Journal, first: int, context: RowContext) -> tuple[SuccessTable, int]:
    """Some successes (n,) from journal number `first` on, and the number from which to read on.

    Where a success at the end of the journal may have more trials, the number to read on from is that of the
    first such success; with too few it is given without eta.
    """
    one = success_dtype(journal.shape.joints, journal.shape.contact_slots)
    most, parts = min(MOST_SUCCESSES, MOST_BYTES // one.itemsize), [all_successes(journal.shape.empty(0))]
    for part in find_successes(journal.blocks(first), context.plan, first=first):
        parts.append(part)
        if sum(map(len, parts)) > most or (part.stop - first >= ROWS_SCANNED):
            break
    found, upto = join_successes(parts), max(first, parts[-1].stop)
    if len(found) > most:
        upto = min(upto, int(found.numbers[most]))
        found = found[:most]
    etas = context.plan.eta(found.scores) if context.plan.trials else np.full(len(found), np.nan)
    table = success_table(
        found.rows,
        journal.shape,
        number=found.numbers,
        synergy=context.genomes.labels(found.rows["genome"]),
        pregrasp=context.genomes.postures(found.rows),
        eta=np.nan_to_num(etas, nan=NO_ETA),
        trials=found.trials,
    )
    return table, upto
