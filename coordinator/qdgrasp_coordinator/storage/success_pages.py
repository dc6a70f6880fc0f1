"""Successes of a journal page by page, for monitors that draw them as the run goes on."""

from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray

from qdgrasp_assets.genes import layout
from qdgrasp_assets.scene import Joint, Scene
from qdgrasp_coordinator.metrics.niches import UNKNOWN_SYNERGIES, SynergyReader
from qdgrasp_coordinator.metrics.run_stats import success_mask
from qdgrasp_coordinator.metrics.scores import NO_TRIALS, TrialPlan, known_scores
from qdgrasp_coordinator.storage.journal import Journal
from qdgrasp_protocol.messages import SuccessPage, deflated
from qdgrasp_protocol.rows import GIVEN, RESULT, Layout, RowColumn, Rows, RowShape, pack, unpack

NO_ETA = -1.0  # Placeholder for an eta that is not known


@dataclass(frozen=True)
class PostureReader:
    """Reader of the finger joints that a genome's hand starts from."""

    layout: Layout
    joints: tuple[Joint, ...]
    """Joints of the hand; none if it is not known."""
    free: tuple[str, ...]
    """Names of its free joints, whose genes are the last ones."""

    def postures(self, rows: Rows) -> NDArray[np.float32]:
        """Return start positions (n, j) [rad or m]; of an unknown hand those after closing."""
        if not self.joints:
            return np.asarray(rows["joints"])
        starts = np.tile(np.array([joint.opened for joint in self.joints], np.float32), (len(rows), 1))
        if self.free:
            genomes = rows["genome"][:, : len(self.layout)]
            values = genomes if self.layout.prior == GIVEN else self.layout.values(genomes)
            names = [joint.name for joint in self.joints]
            starts[:, [names.index(name) for name in self.free]] = values[:, -len(self.free) :]
        return starts

    @classmethod
    def of(cls, scene: Scene, prior: str) -> "PostureReader":
        """Return the reader for genomes of a prior in a scene."""
        hand = scene.gripper
        return cls(layout(scene, prior), hand.joints, tuple(joint.name for joint in hand.free_joints))


UNKNOWN_POSTURES = PostureReader(Layout("", ()), (), ())


@dataclass(frozen=True)
class RowContext:
    """Context for reading a journal's rows: its trials, and how to read its genomes."""

    plan: TrialPlan = NO_TRIALS
    """Numbers of trials of a success."""
    synergies: SynergyReader = UNKNOWN_SYNERGIES
    postures: PostureReader = UNKNOWN_POSTURES

    def etas(self, rows: Rows) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
        """Return eta and trials of each nominal success in consecutive rows (n,).

        Eta is `NO_ETA` where it is not known.
        """
        scores, trials = known_scores(rows, self.plan)
        known = self.plan.eta(scores) if self.plan.trials else np.full(len(scores), np.nan)
        return np.nan_to_num(known, nan=NO_ETA), trials

    def has_all_trials(self, rows: Rows) -> NDArray[np.bool_]:
        """Flag the nominal successes (n,) in consecutive rows that have all of their trials."""
        if not self.plan.trials:
            return np.ones(int(np.count_nonzero(success_mask(rows))), dtype=bool)
        return np.asarray(known_scores(rows, self.plan)[1] == self.plan.trials)


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


def page_limit(shape: RowShape) -> int:
    """The most finds in one answer about rows of a shape."""
    return min(MOST_SUCCESSES, MOST_BYTES // success_dtype(shape.joints, shape.contact_slots).itemsize)


def success_table(rows: Rows, shape: RowShape, **columns: NDArray[np.number]) -> SuccessTable:
    """Return successes (n,) as finds (n,); the others are the columns that rows lack."""
    finds = np.zeros(len(rows), dtype=success_dtype(shape.joints, shape.contact_slots))
    for column in SUCCESS_COLUMNS:
        values = columns[column.name] if column.name in columns else rows[column.name]
        finds[column.name] = values[..., :3] if column.name == "descriptor" else values
    return finds


def success_columns(finds: SuccessTable) -> dict[str, bytes]:
    """Return the columns of successes as bytes, by name, as they travel."""
    return deflated(pack(finds, SUCCESS_COLUMNS))


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
        columns=success_columns(finds),
    )


def page_from_message(message: SuccessPage) -> SuccessTable:
    """Return the successes (n,) in a message.

    Raises `MessageError` where a column is missing, of the wrong length, or holds no finite number.
    """
    finds = np.zeros(message.n, dtype=success_dtype(message.joints, message.contact_slots))
    return unpack(finds, SUCCESS_COLUMNS, message.columns)


ROWS_SCANNED = 1 << 16  # Journal rows read for a page; more where the first success's trials lie farther off
NO_CONTEXT = RowContext()


def success_page(journal: Journal, first: int, context: RowContext = NO_CONTEXT) -> tuple[SuccessTable, int]:
    """Some successes (n,) from journal number `first` on, and the number from which to read on.

    Where a success at the end of the journal may have more trials, the number to read on from is that of the
    first such success; with too few it is given without eta.
    """
    rows, is_last = _scanned_rows(journal, first, context)
    is_success = success_mask(rows)
    numbers, successes = first + np.flatnonzero(is_success), rows[is_success]
    etas, trials = context.etas(rows)
    finds = success_table(
        successes,
        journal.shape,
        number=numbers,
        synergy=context.synergies.labels(successes["genome"]),
        pregrasp=context.postures.postures(successes),
        eta=etas,
        trials=trials,
    )
    lacking = numbers[~context.has_all_trials(rows)]
    upto = int(lacking[0]) if len(lacking) else first + len(rows)
    if not is_last:
        finds = finds[finds["number"] < upto]
    if len(finds) > (most := page_limit(journal.shape)):
        unknown = finds["number"][finds["eta"] < 0] if context.plan.trials else numbers[:0]
        return finds[:most], min([int(finds["number"][most]), *unknown.tolist()])
    return finds, upto


def _scanned_rows(journal: Journal, first: int, context: RowContext) -> tuple[Rows, bool]:
    """Return rows with all trials of the first success, and whether they are the last."""
    count, span = journal.count, ROWS_SCANNED
    while True:
        stop = min(count, first + span)
        kept = journal.blocks(first, stop) if first < stop else ()
        rows = np.concatenate([journal.shape.empty(0), *kept])
        is_last = stop >= count
        if is_last or context.has_all_trials(rows)[:1].all():
            return rows, is_last
        span *= 2
