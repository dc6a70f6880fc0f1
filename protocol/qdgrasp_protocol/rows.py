"""Rows: genome in, outcome out; the unit of evaluation and of the journal.

A genome is a float32 vector. The search sees only numbers in [-1, 1]; decoding maps them linearly to the
intervals of its genes (Huber et al. 2024, section III-B, "each component is projected in its own interval").

Trial 0 is the nominal evaluation of a genome; trials 1 to `trial_count(protocol)` repeat it, disturbed each
time (docs/protocols.md).

A row is (generation, index, trial) with the genome and everything its evaluation found, in a numpy
structured array. The same array of rows is what a worker fills, what the search is told, and what the
journal stores; on the bus each column travels as one little-endian blob (`pack`, `unpack`).
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import IntEnum
from functools import cached_property
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from qdgrasp_protocol.errors import MessageError
from qdgrasp_protocol.messages import DEFLATED_COLUMNS, inflate


class Outcome(IntEnum):
    """Outcome of an evaluation; a greater one got further.

    Stored as uint8 in messages and journal, so the numbers are part of the format.
    """

    ERROR = 0
    """The simulator failed on this row three times; the journal holds the reason."""
    DEAD_END = 1
    """No pose to simulate: the genome stands for none."""
    OVERLAP = 2
    """The open hand overlaps the object at the commanded pose."""
    MISSED = 3
    """No finger touched the object while the hand closed."""
    BRUSHED = 4
    """A finger touched the object while closing, but none does after it, or one outside the regions."""
    DROPPED = 5
    """A finger touches the object after closing; it survived no disturbance (fitness 0)."""
    SHAKEN = 6
    """The grasp survived some of the disturbances of its protocol, not all."""
    HELD = 7
    """The grasp survived every disturbance of its protocol: robust."""

    @property
    def is_simulated(self) -> bool:
        """True if the pose was free, so that the hand closed ("valid" in the paper's code)."""
        return self >= Outcome.MISSED

    @property
    def is_success(self) -> bool:
        """True if a finger touches the object after closing: for S_G and coverage."""
        return self >= Outcome.DROPPED

    @property
    def is_grasp(self) -> bool:
        """True if at least one disturbance was survived: a grasp for users and exports."""
        return self >= Outcome.SHAKEN


TRIALS = 100
"""Trials of a success (Huber et al. 2024), each with the disturbances of the base protocol."""
HARD_TRIALS = 20
"""Harder trials that may follow these, with the base `physical`; they order grasps of equal eta."""
TRIAL_COUNTS = {"robust": TRIALS}


def trial_count(protocol: str) -> int:
    """Return the number of trials besides the nominal evaluation; 0 for most protocols."""
    return TRIAL_COUNTS.get(protocol, 0)


LIFT = "lift"
"""The protocol in which the hand lifts the object off a table."""
DISTURBANCES = {"physical": 6, LIFT: 1}
"""Disturbances that a grasp meets after closing: six forces, or the lift; elsewhere they are two shakes."""
SHAKES = 2


def nominal_protocol(protocol: str, base: str) -> str:
    """Return the protocol of nominal evaluations: `base` where trials disturb it, else its own."""
    return base if trial_count(protocol) else protocol


def disturbance_count(protocol: str) -> int:
    """Return the number of disturbances in one evaluation of a nominal protocol."""
    return DISTURBANCES.get(protocol, SHAKES)


Genomes: TypeAlias = NDArray[np.float32]
"""(n, d): n genomes of d genes each, in [-1, 1]."""

GIVEN = "given"
"""Prior of poses scored as they are: genes are the pose, not numbers in [-1, 1]."""


NO_SYNERGY = -1  # The label of a pose without a synergy: all driven fingers close


@dataclass(frozen=True)
class Gene:
    """One component of a genome."""

    name: str
    low: float
    """Value at -1, in the gene's own unit (m or rad)."""
    high: float
    """Value at +1."""


@dataclass(frozen=True)
class Layout:
    """The genes of a genome, in order."""

    prior: str
    genes: tuple[Gene, ...]

    def __len__(self) -> int:
        return len(self.genes)

    @property
    def names(self) -> tuple[str, ...]:
        """The genes' names, in order."""
        return tuple(gene.name for gene in self.genes)

    def values(self, genomes: Genomes) -> NDArray[np.float64]:
        """Map genomes (n, d) in [-1, 1] to their intervals; (n, d) in m and rad, float64."""
        low, high = self.intervals
        values: NDArray[np.float64] = low + (genomes.astype(np.float64) + 1.0) / 2.0 * (high - low)
        return values

    def genomes(self, values: NDArray[np.float64]) -> Genomes:
        """Map values (n, d) in m and rad to genomes (n, d), the inverse of `values`.

        Values outside their interval are clipped; the gene of an interval without width is 0.
        """
        low, high = self.intervals
        width = high - low
        shares = np.divide(values - low, width, out=np.full(values.shape, 0.5), where=width > 0)
        genomes: Genomes = np.clip(2.0 * shares - 1.0, -1.0, 1.0).astype(np.float32)
        return genomes

    @property
    def intervals(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Values at -1 and at +1, (d,) each."""
        return np.array([gene.low for gene in self.genes]), np.array([gene.high for gene in self.genes])


Rows: TypeAlias = NDArray[np.void]
"""A structured array with the dtype of `RowShape.dtype`."""


@dataclass(frozen=True)
class RowColumn:
    """One column of a row."""

    name: str
    item: str
    """The numpy item type, little-endian."""
    width: str
    """Number of items: "1", "7", or the name of a `RowShape` field."""
    meaning: str


KEY = (
    RowColumn("generation", "<u4", "1", "the generation of the search"),
    RowColumn("index", "<u4", "1", "the genome's place in its generation"),
    RowColumn("trial", "<u2", "1", "0 is the nominal evaluation, 1 and up are domain-randomised"),
)
GENOME = (RowColumn("genome", "<f4", "genes", "the genome, in [-1, 1]"),)
RESULT = (
    RowColumn("outcome", "<u1", "1", "`Outcome`"),
    RowColumn(
        "fitness",
        "<f4",
        "1",
        "disturbances survived: 0 to 2 shakes, in `physical` 0 to 6 forces, in `lift` 0 or 1",
    ),
    RowColumn(
        "steps",
        "<u4",
        "1",
        "steps of physics that its evaluation simulated, in all engines together; 0 where filters decided",
    ),
    RowColumn(
        "descriptor",
        "<f4",
        "3",
        "behaviour descriptor: the hand's commanded position [m], CoM frame",
    ),
    RowColumn(
        "base_to_object", "<f4", "7", "the hand's root link in the object's CoM frame: x y z [m], qx qy qz qw"
    ),
    RowColumn(
        "joints", "<f4", "joints", "finger joint positions at the grasp [rad or m], the gripper's joint order"
    ),
    RowColumn(
        "surface_point", "<f4", "3", "the surface point aimed at [m], CoM frame; zeros where there is none"
    ),
    RowColumn("nu", "<f4", "1", "angle between its normal and the direction to the hand [rad]"),
    RowColumn("contacts", "<u1", "1", "finger links that touch the object after closing"),
    RowColumn("penetration", "<f4", "1", "deepest penetration after closing [m], 0 or positive"),
    RowColumn(
        "settled",
        "<f4",
        "settled_values",
        "successes: the hand's root link in the object's CoM frame after closing, before any disturbance: "
        "x y z [m], qx qy qz qw; else zeros",
    ),
    RowColumn(
        "contact_links",
        "<u1",
        "contact_slots",
        "successes: of each contact after closing, the hand's link, counted from 1; 0: no contact",
    ),
    RowColumn(
        "contact_points",
        "<f2",
        "contact_values",
        "of each contact x y z [m] on the object and the normal into it, CoM frame, and the normal force [N]",
    ),
)
COLUMNS = KEY + GENOME + RESULT
CONTACT_VALUES = 7  # Numbers of one contact: point, normal, force
MAX_CONTACT_SLOTS = 16


LENGTH = 1e4  # [m]: cells are told apart within 10 km (`metrics.cells`)
JOINT = 1e6  # [rad or m]
LIMITS: Mapping[str, tuple[float, float]] = {
    "genome": (-JOINT, JOINT),  # in [-1, 1], except that genes of the prior `GIVEN` are poses and joints
    "outcome": (0, max(Outcome)),
    "fitness": (0, SHAKES * TRIALS),  # more disturbances than any protocol has
    "descriptor": (-LENGTH, LENGTH),
    "base_to_object": (-LENGTH, LENGTH),
    "joints": (-JOINT, JOINT),
    "pregrasp": (-JOINT, JOINT),
    "surface_point": (-LENGTH, LENGTH),
    "nu": (-7, 7),  # within a turn
    "eta": (-1, 1),
    "penetration": (0, LENGTH),
    "settled": (-LENGTH, LENGTH),
    "contact_points": (-65504, 65504),  # all numbers of float16
}
"""Least and greatest value of columns by name; other integers may be all that fit their type.

They are wide: what is outside them no hand does, and it would overflow what is computed of rows.
"""


@dataclass(frozen=True)
class RowShape:
    """Widths of the columns of one run's rows."""

    genes: int
    joints: int
    contact_slots: int = 0
    """Contacts that a row has room for; 0: rows of a scene that records nothing of what closing did."""

    @property
    def settled_values(self) -> int:
        """Numbers of the settled pose: 7, or 0 where it is not recorded."""
        return 7 if self.contact_slots else 0

    @property
    def contact_values(self) -> int:
        """Numbers of all contacts: point, normal and force of each."""
        return CONTACT_VALUES * self.contact_slots

    @cached_property
    def dtype(self) -> np.dtype[np.void]:
        """The packed structured dtype; its bytes, row after row, are what the digest hashes."""
        return self.dtype_of(COLUMNS)

    def dtype_of(self, columns: Sequence[RowColumn]) -> np.dtype[np.void]:
        """The packed structured dtype of some columns."""
        return np.dtype([self._field(column) for column in columns])

    def width(self, column: RowColumn) -> int:
        """Return the number of items of `column` in each row."""
        return int(column.width) if column.width.isdigit() else int(getattr(self, column.width))

    def _field(self, column: RowColumn) -> tuple[str, str] | tuple[str, str, tuple[int]]:
        if column.width == "1":
            return (column.name, column.item)
        return (column.name, column.item, (self.width(column),))

    def empty(self, n: int) -> Rows:
        """Return `n` rows of zeros."""
        return np.zeros(n, dtype=self.dtype)


def pack(rows: Rows, columns: Sequence[RowColumn]) -> dict[str, bytes]:
    """Return each of `columns` as one little-endian blob, by name."""
    return {column.name: np.ascontiguousarray(rows[column.name]).tobytes() for column in columns}


def unpack(rows: Rows, columns: Sequence[RowColumn], blobs: Mapping[str, bytes]) -> Rows:
    """Fill `columns` of `rows` from blobs as they travel.

    A MessageError if a blob is missing, of the wrong length, or holds a number outside its `LIMITS`.
    """
    for reason in unpack_possible(rows, columns, blobs).values():
        raise MessageError(reason)
    return rows


def unpack_possible(rows: Rows, columns: Sequence[RowColumn], blobs: Mapping[str, bytes]) -> dict[int, str]:
    """Fill `columns` of `rows`; return why rows are impossible, by place (`impossible_rows`).

    A MessageError if a blob is missing or of the wrong length.
    """
    for column in columns:
        expected = len(rows) * rows.dtype[column.name].itemsize
        if column.name not in blobs:
            raise MessageError(f"column '{column.name}' is missing")
        blob = blobs[column.name]
        if column.name in DEFLATED_COLUMNS:
            try:
                blob = inflate(blob, expected + 1)  # one byte more, so that an end is seen at all
            except MessageError as error:
                raise MessageError(f"column '{column.name}': {error}") from None
        if len(blob) != expected:
            raise MessageError(f"column '{column.name}' has {len(blob)} bytes, expected {expected}")
        target = rows[column.name]
        target[...] = np.frombuffer(blob, dtype=column.item).reshape(target.shape)
    return impossible_rows(rows, columns)


def impossible_rows(rows: Rows, columns: Sequence[RowColumn] = COLUMNS) -> dict[int, str]:
    """Return why rows are impossible, by place: their first column outside `LIMITS`."""
    reasons: dict[int, str] = {}
    for column in columns:
        if column.name in LIMITS:
            low, high = LIMITS[column.name]
            values = rows[column.name]
            # all float16 that are finite are within, and to compare them takes many times as long
            is_half = column.item == "<f2"
            is_within = np.isfinite(values) if is_half else (values >= low) & (values <= high)
            for row in () if is_within.all() else np.flatnonzero(~is_within.reshape(len(rows), -1).all(1)):
                value = values[row][~is_within[row]].flat[0]
                reason = f"column '{column.name}' holds {value:g}, expected a number from {low:g} to {high:g}"
                reasons.setdefault(int(row), reason)
    return reasons
