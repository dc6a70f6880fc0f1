"""The table of results: one line a run, sorted, so that a run more is a line more."""

import csv
import io
from collections.abc import Collection, Iterable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple, get_args

import msgspec
import pyarrow as pa
import pyarrow.parquet as pq
from benchmarks.results.assets import asset_name, has_own_mass
from msgspec import Struct, structs

from qdgrasp_coordinator.storage import atomic_files, job_folder
from qdgrasp_protocol.errors import InputError
from qdgrasp_protocol.spec import RunSpec

DIGITS = 5
"""Significant ones of a number that is not whole."""
MILESTONES = {
    f"{n // 1000}k" if n % 1000 == 0 else str(n): n for n in (500, 1000, 2000, 5000, 10_000, 50_000)
}
"""Counted evaluations after which a row says how much was found, by the end of their columns' names."""
CPU_MILESTONES = {f"{n}s": n for n in (5, 7, 10, 14, 20, 28, 40, 56, 80, 112, 160, 224, 320)}
"""CPU seconds of the workers after which it says so, in the same way: a factor of the root of 2 apart."""


class Key(NamedTuple):
    """The wanted run: unique in a table, whose rows are sorted by it."""

    gripper: str
    object: str
    protocol: str
    """With its engine where that is not Bullet: `physical in mujoco`."""
    method: str
    overlaps: str
    settings: str
    """Other values of the spec that are not its defaults, such as `population=50`; mostly empty."""
    seed: int
    budget: int

    @property
    def scene(self) -> tuple[str, str, str]:
        """Hand, object and protocol."""
        return self.gripper, self.object, self.protocol

    @property
    def words(self) -> str:
        """Name for a reader."""
        marks = (
            f"{self.protocol}, {'overlaps redrawn' if self.overlaps == 'redraw' else 'every pose counted'}"
        )
        return (
            f"{self.method} with {self.gripper} on {self.object}, seed {self.seed} x {self.budget} ({marks})"
        )


class Row(Struct, frozen=True, kw_only=True):
    """One finished run. None, an empty field: there is no such figure."""

    gripper: str
    object: str
    protocol: str
    method: str
    overlaps: str
    settings: str
    seed: int
    budget: int
    version: str
    """Version of this package when the run was begun."""
    code: str
    """Digest of the evaluation's code, which decides whether a row is current."""
    platform: str
    """Digest of all that decides the bits of a result (docs/reproducibility.md), `code` included."""
    scene: str
    """Digest of the scene bundle."""
    journal: str
    """The beginning of the output of `qdgrasp digest`."""
    evaluations: int
    """Counted ones; fewer than the budget where a search ended by itself."""
    simulated: int
    """Poses that the simulator closed a hand on."""
    proposals: int
    """Poses that decoding screened, overlaps included."""
    successes: int
    grasps: int
    robust: int
    cells: int
    """Distinct 1 cm cells with a success."""
    set_size: int | None = None
    """Entries of the reference set."""
    coverage_500: float | None = None
    """De-duplicated coverage of the reference set after so many counted evaluations, 0 to 1."""
    coverage_1k: float | None = None
    coverage_2k: float | None = None
    coverage_5k: float | None = None
    coverage_10k: float | None = None
    coverage_50k: float | None = None
    coverage: float | None = None
    """De-duplicated coverage of the reference set in the end."""
    robust_share: float | None = None
    """The share of the set's entries in which a grasp survived every disturbance."""
    outside: float | None = None
    """The share of the cells with a success that are not in the set, 0 to 1."""
    robust_cells: int | None = None
    """Distinct 1 cm cells with a grasp that survived every disturbance, in the end."""
    robust_cells_500: int | None = None
    """Robust cells after so many counted evaluations."""
    robust_cells_1k: int | None = None
    robust_cells_2k: int | None = None
    robust_cells_5k: int | None = None
    robust_cells_10k: int | None = None
    robust_cells_50k: int | None = None
    robust_cells_5s: int | None = None
    """Robust cells after so many CPU seconds of the workers."""
    robust_cells_7s: int | None = None
    robust_cells_10s: int | None = None
    robust_cells_14s: int | None = None
    robust_cells_20s: int | None = None
    robust_cells_28s: int | None = None
    robust_cells_40s: int | None = None
    robust_cells_56s: int | None = None
    robust_cells_80s: int | None = None
    robust_cells_112s: int | None = None
    robust_cells_160s: int | None = None
    robust_cells_224s: int | None = None
    robust_cells_320s: int | None = None
    qd_score: float | None = None
    """The best fitness in a cell with a success, summed over these cells."""
    mean_best: float | None = None
    """The best fitness in a cell with a success, mean over these cells."""
    niches: int | None = None
    """Niches of position, orientation and synergy with a success."""
    robust_niches: int | None = None
    """Niches with a grasp that survived every disturbance."""
    orientations: float | None = None
    """Orientation bins with a success, of 60: mean over the cells with a success."""
    near_nu: float | None = None
    """Share of the successes that aim at a surface point with nu below pi / 4, 0 to 1."""
    drawn: int | None = None
    """Grasps drawn of the cells that hold, and evaluated again; None: none were yet."""
    drawn_in_bullet: float | None = None
    """The share of them that holds in Bullet too."""
    drawn_eta: float | None = None
    """The mean share of pushes that they survive in trials with small errors, in the run's engine."""
    cpu_seconds: float
    """CPU time of the workers."""
    coverage_per_cpu_second: float | None = None
    success_ms: float | None = None
    """Cost of a success to its worker [ms], fitted to the blocks of the journal."""
    wall_seconds: float | None = None

    @property
    def key(self) -> Key:
        """The wanted run."""
        return Key(*(getattr(self, name) for name in Key._fields))

    @property
    def both_cells(self) -> float | None:
        """Cells that hold, times the share of drawn ones that holds in Bullet too, if some were drawn."""
        if not self.robust_cells or self.drawn_in_bullet is None:
            return self.robust_cells
        return self.robust_cells * self.drawn_in_bullet

    @property
    def outside_share(self) -> float | None:
        """The share of the run's cells that are not in S_G, also of rows from before it was counted."""
        if self.outside is not None or self.coverage is None or not self.cells:
            return self.outside
        return 1 - self.coverage * (self.set_size or 0) / self.cells

    @property
    def screened(self) -> float | None:
        """Poses that were screened for a counted evaluation."""
        return self.proposals / self.evaluations if self.evaluations else None


COLUMNS = tuple(field.name for field in msgspec.structs.fields(Row))
OF_DRAWN = ("drawn", "drawn_in_bullet", "drawn_eta")
NEEDED = tuple(field.name for field in msgspec.structs.fields(Row) if field.required)


def key(spec: RunSpec) -> Key:
    """The key of a spec.

    Raises
    ------
    InputError
        Its gripper or object is a file, which a table that others read cannot name; those of the benchmark
        are named by their stems.
    """
    said = {name: getattr(spec, name) for name in ("method", "overlaps", "seed")}
    return Key(
        **said,
        gripper=_named(spec.gripper),
        object=_named(spec.object),
        protocol=spec.protocol_words,
        settings=_settings(spec),
        budget=spec.evaluations,
    )


def _named(name: str) -> str:
    made = asset_name(name)
    if made is None and (Path(name).name != name or Path(name).suffix):
        raise InputError(
            f"'{name}' is a file of this machine: only runs on named assets, and on those that the benchmark "
            "makes, have a row."
        )
    return made or name


def _settings(spec: RunSpec) -> str:
    """Values of a spec that are in no other column and are not its defaults.

    A surface seed that is the run's seed is called so: runs that differ in both alone are alike.
    """
    said = {
        field.name: getattr(spec, field.name)
        for field in msgspec.structs.fields(RunSpec)
        if field.name not in (*Key._fields, "engine", "evaluations")
        and getattr(spec, field.name) != field.default
    }
    if said.get("surface_seed") == spec.seed:
        said["surface_seed"] = "seed"
    if has_own_mass(spec):
        del said["mass"]
    return " ".join(f"{name}={value}" for name, value in said.items())


def written(value: object) -> str:
    """A figure as text for the table."""
    if isinstance(value, float):
        return f"{value:.{DIGITS}g}" if abs(value) < 10**DIGITS else f"{value:.0f}"
    return "" if value is None else str(value)


Table = Mapping[Key, Row]
HEAD = "restore the head of the table, or move the table away to begin another"
LINE = "restore the line, or delete it to have the run done again"


def read(file: Path) -> dict[Key, Row]:
    """The table in a file; empty where there is none.

    Raises
    ------
    InputError
        It is not such a table: the line and what is wrong with it are named.
    """
    if not file.exists():
        return {}
    with disk_text(file) as lines:
        reader = csv.DictReader(lines, strict=True)
        _check_columns(file, reader.fieldnames or ())
        table: dict[Key, Row] = {}
        for values in _lines(file, reader):
            row = _row(file, reader.line_num, values)
            if table.setdefault(row.key, row) is not row:
                raise _wrong(file, reader.line_num, f"{row.key.words} has a line already")
    return table


def text(table: Table) -> str:
    """A table as CSV, by key; the inverse of `read`."""
    lines = io.StringIO()
    writer = csv.DictWriter(lines, COLUMNS, lineterminator="\n")
    writer.writeheader()
    for _, row in sorted(table.items()):
        writer.writerow({name: written(getattr(row, name)) for name in COLUMNS})
    return lines.getvalue()


def parquet(table: Table) -> bytes:
    """The same table as a Parquet file."""
    kinds = {str: pa.string(), int: pa.int64(), float: pa.float64()}
    fields = [(field.name, kinds[_plain(field.type)]) for field in msgspec.structs.fields(Row)]
    rows = [msgspec.structs.asdict(row) for _, row in sorted(table.items())]
    out = pa.BufferOutputStream()
    pq.write_table(pa.Table.from_pylist(rows, pa.schema(fields)), out)
    return bytes(out.getvalue())


def _plain(kind: Any) -> type:
    """The type of a figure that is not None."""
    some: type = next((one for one in get_args(kind) if one is not type(None)), kind)
    return some


def merged(table: Table, rows: Iterable[Row], current: Collection[str]) -> dict[Key, Row]:
    """A table with these rows, each in the place of the one of its key.

    A row of the current evaluation code is not replaced by one of another. Figures of drawn grasps stay with
    the journal that they were drawn of.

    Parameters
    ----------
    current
        Digests of evaluation code that count as today's.
    """
    whole = dict(table)
    for row in rows:
        old = whole.get(row.key)
        if old is None or row.code in current or old.code not in current:
            is_same = old is not None and old.journal == row.journal and row.drawn is None
            whole[row.key] = (
                structs.replace(row, **{name: getattr(old, name) for name in OF_DRAWN}) if is_same else row
            )
    return dict(sorted(whole.items()))


@contextmanager
def locked(file: Path) -> Iterator[None]:
    """Lock a table against changes by other processes; see `job_folder.hold_lock`."""
    with atomic_files.writing(file.parent):
        file.parent.mkdir(parents=True, exist_ok=True)
    with job_folder.hold_lock(file.parent, f".{file.name}.lock"):
        yield


def write(file: Path, table: Table) -> None:
    """Replace a table."""
    with atomic_files.writing(file.parent):
        atomic_files.write(file, text(table).encode())


@contextmanager
def disk_text(file: Path) -> Iterator[io.StringIO]:
    """A file's text as lines; raises an InputError where it is no CSV."""
    try:
        yield io.StringIO(atomic_files.read(file).decode())
    except (csv.Error, UnicodeDecodeError) as error:
        raise InputError(f"{file} is no table of results: {error}.") from None


def _check_columns(file: Path, columns: Collection[str]) -> None:
    """Check the columns; figures that an older table does not have yet may be missing."""
    if unknown := [name for name in columns if name not in COLUMNS]:
        raise _wrong(file, 1, f"unknown column '{unknown[0]}'", HEAD)
    if missing := [name for name in NEEDED if name not in columns]:
        raise _wrong(file, 1, f"column '{missing[0]}' is missing", HEAD)


def _lines(file: Path, reader: "csv.DictReader[str]") -> Iterator[dict[str, str]]:
    for values in reader:
        if None in values or None in values.values():
            raise _wrong(file, reader.line_num, f"expected {len(reader.fieldnames or ())} fields")
        yield values


def _row(file: Path, line: int, values: Mapping[str, str]) -> Row:
    said = {name: value for name, value in values.items() if value or name in NEEDED}
    try:
        return msgspec.convert(said, Row, strict=False)
    except msgspec.ValidationError as error:
        raise _wrong(file, line, str(error)) from None


def _wrong(file: Path, line: int, what: str, remedy: str = LINE) -> InputError:
    return InputError(f"{file}, line {line}: {what}; {remedy}.")
