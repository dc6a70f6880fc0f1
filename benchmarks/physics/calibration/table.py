"""The table of the calibration study: one line a grasp, sorted, so that a run more is its lines more."""

import csv
import io
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Literal, NamedTuple

import msgspec
from benchmarks.results.table import disk_text, locked, written
from msgspec import Struct

from qdgrasp_coordinator.storage import atomic_files
from qdgrasp_protocol.errors import InputError
from qdgrasp_protocol.rows import disturbance_count

Group = Literal["best", "held", "success"]
"""The best ones by rank; drawn of all others that hold; drawn of all successes that are left."""
PUSHES = disturbance_count("physical")


class RunKey(NamedTuple):
    """A run of the study."""

    gripper: str
    object: str
    seed: int

    @property
    def words(self) -> str:
        """Name for a reader."""
        return f"{self.gripper} on {self.object}, seed {self.seed}"


class Origin(NamedTuple):
    """Numbers and code of a run's lines; lines of another origin are made again."""

    design: str
    """The numbers of the study (`study.Design`)."""
    code: str
    """Beginning of the digest of the evaluation's code, `platform code` of `qdgrasp info`."""
    mujoco_code: str
    """Beginning of the digest of the code of MuJoCo's worlds."""


class GraspRow(Struct, frozen=True, kw_only=True):
    """A grasp; of each disturbance the share of its trials in which the grasp was held."""

    gripper: str
    object: str
    seed: int
    """Seed of the search and of the surface points."""
    group: Group
    place: int
    """From 1: its rank, or the number of its draw."""
    design: str
    code: str
    mujoco_code: str
    scene: str
    """Beginning of the digest of the run's scene."""
    generation: int
    index: int
    """With the generation its place in the run."""
    fitness: int
    """Pushes survived in MuJoCo, undisturbed; 6: it holds."""
    eta: float
    """Share of disturbances survived in the trials of the ranking."""
    trials: int
    margin: float
    penetration_mm: float
    motion_mm: float
    """Motion of the object in the hand while it closed."""
    bullet: float
    """1 if it holds in Bullet, undisturbed."""
    friction_050: float
    weight_200: float
    weight_500: float
    torsion_017: float
    effort_070: float
    together: float
    paper_bullet: float
    friction_070: float
    arm: float

    @property
    def run(self) -> RunKey:
        """The run that it is of."""
        return RunKey(self.gripper, self.object, self.seed)

    @property
    def origin(self) -> Origin:
        """Numbers and code that it was made with."""
        return Origin(self.design, self.code, self.mujoco_code)

    @property
    def holds(self) -> bool:
        """Whether it survived every push in MuJoCo."""
        return self.fitness == PUSHES

    @property
    def holds_in_both(self) -> bool:
        """Whether it holds in both engines."""
        return self.holds and self.bullet == 1.0


COLUMNS = tuple(field.name for field in msgspec.structs.fields(GraspRow))


def grasp_row(values: dict[str, object]) -> GraspRow:
    """A row of values, as precise as the table is."""
    said = {name: float(written(one)) if isinstance(one, float) else one for name, one in values.items()}
    return msgspec.convert(said, GraspRow)


def read(file: Path) -> list[GraspRow]:
    """The rows in a file; none where there is no file.

    An InputError that names the line if it is no such table.
    """
    if not file.exists():
        return []
    with disk_text(file) as lines:
        reader = csv.DictReader(lines, strict=True)
        if tuple(reader.fieldnames or ()) != COLUMNS:
            raise InputError(f"{file}, line 1: its columns must be {', '.join(COLUMNS)}; restore the head.")
        rows = []
        for values in reader:
            try:
                rows.append(msgspec.convert(values, GraspRow, strict=False))
            except msgspec.ValidationError as error:
                raise InputError(f"{file}, line {reader.line_num}: {error}; restore the line.") from None
    return rows


def text(rows: Iterable[GraspRow]) -> str:
    """Rows as CSV, by run, group and place; the inverse of `read`."""
    lines = io.StringIO()
    writer = csv.DictWriter(lines, COLUMNS, lineterminator="\n")
    writer.writeheader()
    for row in sorted(rows, key=lambda row: (*row.run, row.group, row.place)):
        writer.writerow({name: written(getattr(row, name)) for name in COLUMNS})
    return lines.getvalue()


def replaced(rows: Sequence[GraspRow], run: RunKey, found: Sequence[GraspRow]) -> list[GraspRow]:
    """The rows, with the rows of a run replaced."""
    return [row for row in rows if row.run != run] + list(found)


def is_measured(rows: Iterable[GraspRow], run: RunKey, origin: Origin) -> bool:
    """Whether the rows of a run are there, made by the same design and code."""
    return {row.origin for row in rows if row.run == run} == {origin}


def add(file: Path, run: RunKey, found: Sequence[GraspRow]) -> list[GraspRow]:
    """Put the rows of a run into a file's table, and return all its rows."""
    with locked(file):
        rows = replaced(read(file), run, found)
        with atomic_files.writing(file.parent):
            atomic_files.write(file, text(rows).encode())
    return read(file)
