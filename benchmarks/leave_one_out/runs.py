"""Runs of variants: the wanted ones, the finished ones, and carrying out the missing ones."""

import csv
import io
import sys
from collections.abc import Collection, Iterable, Mapping
from itertools import product
from pathlib import Path
from typing import NamedTuple

import msgspec
from benchmarks import single_run
from benchmarks.leave_one_out.grid import TODAY, VARIANTS, patched, values_of
from benchmarks.results.programme import TUNING, TUNING_HAND
from benchmarks.results.table import disk_text
from benchmarks.side_by_side import side_by_side

from qdgrasp_coordinator.scheduler.pipeline import Flight
from qdgrasp_coordinator.scheduler.run_plan import full_spec
from qdgrasp_coordinator.search.value_search import ValueSearch
from qdgrasp_coordinator.storage import atomic_files
from qdgrasp_protocol.errors import InputError
from qdgrasp_protocol.rows import Outcome
from qdgrasp_worker.engines import ENGINES
from qdgrasp_worker.platform import EVALUATION, worlds
from qdgrasp_worker.syntax_digest import syntax_digest

SCENE = {"gripper": TUNING_HAND, "protocol": "physical", "engine": "mujoco"}
TUNING_SEEDS = (1, 2, 3)
HELD_OUT = (
    "ycb_banana", "ycb_bleach_cleanser", "ycb_bowl", "ycb_cracker_box", "ycb_spatula", "ycb_tennis_ball"
)  # fmt: skip
"""Objects that had no part in that."""
HELD_OUT_SEEDS = (1, 2, 3, 4, 5)
EVALUATIONS = 1500
HEX = 16
"""Digits of a digest."""


class Key(NamedTuple):
    """One wanted run."""

    variant: str
    scene: str
    """Its object."""
    seed: int
    """Seed of the search and of the surface points."""
    evaluations: int
    """The budget."""


class Row(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A finished run, one line of the table."""

    variant: str
    scene: str
    seed: int
    evaluations: int
    robust_cells: int
    """Distinct 1 cm cells with a grasp that holds, in the end."""
    cells: int
    """Distinct 1 cm cells with a success, in the end."""
    cpu_seconds: float
    """CPU time of search and evaluations."""
    code: str
    """Digest of their code, 16 digits."""

    @property
    def key(self) -> Key:
        return Key(*(getattr(self, name) for name in Key._fields))


COLUMNS = Row.__struct_fields__
Table = Mapping[Key, Row]


def code_digest() -> str:
    """The digest of the code of evaluation and search as it is written, whatever is patched."""
    return syntax_digest(*EVALUATION, *worlds(ENGINES["mujoco"]), ValueSearch, Flight)[:HEX]


def tuning_runs(evaluations: int) -> list[Key]:
    """Every variant on the tuning objects, one seed after another."""
    asked = product(TUNING_SEEDS, TUNING, VARIANTS)
    return [Key(name, thing, seed, evaluations) for seed, thing, name in asked]


def held_out_runs(variants: Iterable[str], evaluations: int) -> list[Key]:
    """Today's constants and other variants on the held-out objects, one seed after another."""
    asked = product(HELD_OUT_SEEDS, HELD_OUT, dict.fromkeys((TODAY, *variants)))
    return [Key(name, thing, seed, evaluations) for seed, thing, name in asked]


def read(file: Path) -> dict[Key, Row]:
    """The table in a file; empty where there is none.

    Raises
    ------
    InputError
        A line is none of such a table, or a variant is not in the grid.
    """
    if not file.exists():
        return {}
    table: dict[Key, Row] = {}
    with disk_text(file) as lines:
        reader = csv.DictReader(lines, strict=True)
        for values in reader:
            try:
                row = msgspec.convert(values, Row, strict=False)
            except (msgspec.ValidationError, TypeError) as error:
                raise InputError(
                    f"{file}, line {reader.line_num}: {error}; restore the line, or delete it."
                ) from None
            values_of(row.variant)
            table[row.key] = row
    return table


def text(table: Table) -> str:
    """A table as CSV, sorted; the inverse of `read`."""
    lines = io.StringIO()
    writer = csv.writer(lines, lineterminator="\n")
    writer.writerow(COLUMNS)
    writer.writerows(msgspec.structs.astuple(row) for _, row in sorted(table.items()))
    return lines.getvalue()


def carry_out(asked: Key) -> Row:
    """One run."""
    values = SCENE | {"object": asked.scene, "evaluations": asked.evaluations}
    spec = full_spec(values | {"seed": asked.seed, "surface_seed": asked.seed})
    with patched(values_of(asked.variant)):
        found = single_run.run(spec)
    held, cells = (found.history.cells(least).end for least in (Outcome.HELD, Outcome.DROPPED))
    seconds = round(found.evaluation_seconds + found.search_seconds, 1)
    return Row(*asked, robust_cells=held, cells=cells, cpu_seconds=seconds, code=code_digest())


def run_missing(file: Path, asked: Iterable[Key], current: Collection[str], processes: int = 1) -> None:
    """Carry out the runs of current code that a file's table lacks; write each as it ends."""
    table = read(file)
    missing = [key for key in asked if key not in table or table[key].code not in current]
    for number, (key, row) in enumerate(side_by_side(carry_out, missing, processes), 1):
        table[key] = row
        atomic_files.replace(file, text(table).encode())
        sys.stderr.write(
            f"{number} of {len(missing)}: {key.variant}, {key.scene}, seed {key.seed}: "
            f"{row.robust_cells} cells that hold, {row.cpu_seconds:.0f} CPU s\n"
        )
