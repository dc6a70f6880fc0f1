"""Reads a library: objects that a manifest names, or that lie in a folder of meshes.

A manifest is a table in CSV or Parquet, or a TOML file of [[object]] tables, with a row for each object. All
that cannot be used are named at once, or left out and reported where that is asked for. Checks of a mesh are
remembered by its content (`check_mesh`).
"""

import math
import tomllib
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import msgspec
from msgspec import Struct, structs

from qdgrasp_assets.geometry.collision_parts import Tell, ignore_progress
from qdgrasp_assets.geometry.mesh_io import FORMAT_PACKAGES, READABLE_FORMATS, scale_of
from qdgrasp_assets.object_model import MeshCheck, check_mesh
from qdgrasp_coordinator.storage.tables import csv_text, read_csv
from qdgrasp_protocol.build_messages import MeshPreparation
from qdgrasp_protocol.errors import InputError, UnknownKey, UnusableMeshes, check_packages
from qdgrasp_protocol.keys import job_name
from qdgrasp_protocol.spec import ObjectRecord, run_spec

MANIFEST_FORMATS = (".csv", ".parquet", ".toml")
COLUMNS = {
    **dict.fromkeys(("file", "id", "unit", "category", "licence", "source", "split"), str),
    **dict.fromkeys(("scale", "mass", "density", "friction"), float),
    **dict.fromkeys(("remesh", "hull", "glued"), bool),
    "simplify": int,
}
"""Columns of a manifest, with the type of each; all but `file` may be missing or empty."""
PREPARATIONS = tuple(field.name for field in structs.fields(MeshPreparation))
NOTES = tuple(field.name for field in structs.fields(ObjectRecord))
WORDS = {"true": True, "yes": True, "1": True, "false": False, "no": False, "0": False}
MASS_TABLE = "masses.csv"  # The table of masses in a folder of meshes
MASS_COLUMNS = ["file", "mass"]
MASS_DIGITS = 6  # Significant digits of a mass that follows from a density
GREATEST_MASS = 1000  # Greatest mass that a spec allows [kg]
NO_MASS = "it has no mass; say what it weighs with --mass or --density, or in the manifest or " + MASS_TABLE
REPORT_COLUMNS = ("object", "file", "reason", "mend")


class LibraryRules(Struct, frozen=True, kw_only=True):
    """Values of all objects of a library that do not have their own; mass or density, not both."""

    mass: float | None = None
    """Mass [kg]."""
    density: float | None = None
    """Density [kg/m3]."""
    scale: float | None = None
    """Metres to a unit of the files; None: 1."""
    mesh: MeshPreparation | None = None
    """Changes of the meshes; a row that says any has its own alone."""
    skip_unusable: bool = False
    """True: what cannot be used is left out; False: nothing is begun."""


NO_RULES = LibraryRules()


class SkippedObject(Struct, frozen=True):
    """An object that is left out of a campaign."""

    object: str
    file: str
    reason: str
    mend: str
    """Advice; empty: none is known."""


@dataclass(frozen=True)
class Library:
    """The objects of a campaign."""

    objects: dict[str, dict[str, Any]]
    """Values of a spec by the path of the mesh file."""
    skipped: tuple[SkippedObject, ...] = ()


class LibraryRow(Struct, frozen=True, kw_only=True):
    """One object as a library names it; None: not said."""

    name: str
    """Its name in messages."""
    file: Path
    mass: float | None = None
    density: float | None = None
    friction: float | None = None
    scale: float | None = None
    mesh: MeshPreparation | None = None
    about: ObjectRecord | None = None
    fault: str = ""
    """Reason why the row itself cannot be used."""

    @property
    def run_part(self) -> str:
        """Its part in the names of runs."""
        return job_name(f"a-{self.about.id if self.about and self.about.id else self.file.stem}")


def is_manifest(path: Path) -> bool:
    """Return whether a path is a manifest's: a table, or a TOML file with [[object]]."""
    kind = path.suffix.lower()
    if kind != ".toml" or not path.is_file():
        return kind in MANIFEST_FORMATS[:2]
    try:
        return isinstance(tomllib.loads(path.read_text(encoding="utf-8")).get("object"), list)
    except (OSError, ValueError, RecursionError):
        return False


def read_library(where: Path, rules: LibraryRules, tell: Tell = ignore_progress) -> Library:
    """Read a manifest, or all meshes below a folder, and check every mesh.

    `tell` is called with a sentence before each. Raises InputError if there is no such file or folder, or it
    cannot be read as one, and UnusableMeshes for objects that cannot be used, unless these are to be skipped
    and others are left.
    """
    rows, faults = (_manifest_rows(where), {}) if is_manifest(where) else _folder_rows(where)
    faults |= _repeats(rows)
    objects: dict[str, dict[str, Any]] = {}
    for number, row in enumerate(rows, start=1):
        tell(f"checking meshes: {number} of {len(rows)}")
        scale = rules.scale if row.scale is None else row.scale
        mesh = row.mesh or rules.mesh
        if row.fault or row.name in faults:
            faults.setdefault(row.name, row.fault)
            continue
        checked = check_mesh(row.file, scale, mesh)
        mass = _mass(row, rules, checked)
        if fault := mesh_fault(checked, mass):
            faults[row.name] = fault
            continue
        said = {"mass": mass, "scale": scale, "friction": row.friction, "mesh": mesh, "about": row.about}
        objects[str(row.file)] = {k: msgspec.to_builtins(v) for k, v in said.items() if v is not None}
    if faults and not (rules.skip_unusable and objects):
        raise UnusableMeshes(len(faults.keys() | {row.name for row in rows}), faults)
    files = {row.name: str(row.file) for row in rows}
    return Library(objects, tuple(_skipped(name, files.get(name, ""), why) for name, why in faults.items()))


def mesh_fault(checked: MeshCheck, mass: float | None) -> str:
    """Return why no object can be made of a mesh with this mass [kg]; empty: one can."""
    if checked.faults:
        return "; and ".join(checked.faults)
    if mass is None:
        return NO_MASS
    if not 0 < mass <= GREATEST_MASS:
        return f"its mass must be more than 0 and at most {GREATEST_MASS} kg, got {mass:g}"
    return ""


def skip_report(skipped: Iterable[SkippedObject]) -> bytes:
    """Return the objects that are left out as a table in CSV."""
    return csv_text((structs.asdict(each) for each in skipped), REPORT_COLUMNS).encode()


def read_skip_report(report: Path) -> list[SkippedObject]:
    """Read the table of the objects that are left out; a missing one is empty."""
    if not report.is_file():
        return []
    return [
        SkippedObject(*(row[column] for column in REPORT_COLUMNS)) for row in read_csv(report, REPORT_COLUMNS)
    ]


def _mass(row: LibraryRow, rules: LibraryRules, checked: MeshCheck) -> float | None:
    """Return the mass of an object [kg]: the row's own, else by the rules; None: unknown."""
    if row.mass is not None:
        return row.mass
    density = rules.density if row.density is None else row.density
    return rules.mass if density is None else float(f"{density * checked.volume:.{MASS_DIGITS}g}")


def _skipped(name: str, file: str, why: str) -> SkippedObject:
    """Split each fault, which says what is wrong and then what to do."""
    parts = [fault.partition("; ") for fault in why.split("; and ")]
    reasons, mends = (" and ".join(part[i] for part in parts if part[i]) for i in (0, 2))
    return SkippedObject(name, file, reasons, mends)


def _repeats(rows: Sequence[LibraryRow]) -> dict[str, str]:
    """Find rows whose file, or whose runs' names, are those of an earlier row without a fault."""
    files, parts, faults = dict[Path, str](), dict[str, str](), dict[str, str]()
    for row in rows:
        if row.fault:
            continue
        if (other := files.setdefault(row.file, row.name)) != row.name:
            faults[row.name] = f"its file is that of '{other}' too; name each file once"
        elif (other := parts.setdefault(row.run_part, row.name)) != row.name:
            faults[row.name] = f"its runs would be called as those of '{other}'; rename one of the two"
    return faults


def _folder_rows(folder: Path) -> tuple[list[LibraryRow], dict[str, str]]:
    """Return the meshes below a folder, and the faults of its table of masses.

    Meshes in folders of it have their path as their id, as their files may have the same names.
    """
    if not folder.is_dir():
        raise InputError(
            f"There is no folder of meshes at '{folder}', and no manifest ({', '.join(MANIFEST_FORMATS)})."
        )
    kinds = {*READABLE_FORMATS, *FORMAT_PACKAGES}
    found = sorted(file for file in folder.rglob("*") if file.suffix.lower() in kinds and file.is_file())
    if not found:
        raise InputError(
            f"There is no mesh in '{folder}': name a folder of files such as {', '.join(READABLE_FORMATS)}."
        )
    masses, rows = _read_masses(folder / MASS_TABLE), []
    for file in found:
        name = file.relative_to(folder)
        about = ObjectRecord(id=name.with_suffix("").as_posix()) if len(name.parts) > 1 else None
        mass = masses.pop(name.as_posix(), None)
        rows.append(LibraryRow(name=name.as_posix(), file=file.resolve(), mass=mass, about=about))
    return rows, dict.fromkeys(masses, f"{MASS_TABLE} names it, and there is no such mesh")


def _read_masses(table: Path) -> dict[str, float]:
    """Read the masses [kg] in a table by file; empty if there is no table."""
    if not table.is_file():
        return {}
    try:
        return {row["file"]: float(row["mass"]) for row in read_csv(table, MASS_COLUMNS)}
    except ValueError as error:
        raise InputError(f"'{table}' is no table of masses in kg: {error}.") from None


def _manifest_rows(path: Path) -> list[LibraryRow]:
    """Return the rows of a manifest, no two of one name; files are relative to its folder."""
    try:
        tables = list(_READERS[path.suffix.lower()](path))
    except (OSError, ValueError, RecursionError) as error:
        why = getattr(error, "strerror", None) or str(error)
        raise InputError(f"The manifest '{path}' cannot be read: {why}.") from None
    if not tables:
        raise InputError(f"The manifest '{path}' names no object: it needs a row for each, with its file.")
    for key in dict.fromkeys(key for table in tables for key in table):
        if key not in COLUMNS:
            raise UnknownKey(str(path), str(key), COLUMNS)
    if not all(table.get("file") for table in tables):
        number = next(n for n, table in enumerate(tables, 1) if not table.get("file"))
        raise InputError(f"The manifest '{path}' says no file in row {number}: every object needs one.")
    rows = [_row(table, path.absolute().parent) for table in tables]
    counts = Counter(row.name for row in rows)
    return [
        row
        if counts[row.name] == 1
        else structs.replace(row, name=f"{row.name} (row {number}, {row.file.name})")
        for number, row in enumerate(rows, 1)
    ]


def _row(table: Mapping[str, Any], folder: Path) -> LibraryRow:
    """Return a row of plain values; what is wrong with them is its fault."""
    relative = Path(str(table["file"]))
    id_ = str(table.get("id", "")).strip() or relative.with_suffix("").as_posix()
    name, file = id_, (folder / relative).resolve()
    try:
        values = {key: _value(key, value) for key, value in table.items()}
        if values.get("mass") is not None and values.get("density") is not None:
            raise InputError("its row says mass and density; say one of them")
        notes = {key: values[key] for key in NOTES if key in values} | {"id": id_}
        mesh = {key: values[key] for key in PREPARATIONS if key in values}
        scale, friction = scale_of(values.get("unit"), values.get("scale")), values.get("friction")
        known = {"gripper": "", "object": "", "mesh": mesh or None, "about": notes, "friction": friction}
        spec = run_spec({k: v for k, v in known.items() if v is not None}, "row")
    except InputError as error:
        return LibraryRow(name=name, file=file, fault=str(error).rstrip("."))
    physical: dict[str, Any] = {key: values.get(key) for key in ("mass", "density", "friction")}
    return LibraryRow(name=name, file=file, scale=scale, mesh=spec.mesh, about=spec.about, **physical)


def _value(key: str, value: Any) -> Any:
    """Return a cell as its column's type; InputError if it is of another."""
    kind = COLUMNS[key]
    if kind is str:
        return str(value)
    if kind is bool:
        flag = value if isinstance(value, bool) else WORDS.get(str(value).strip().lower())
        if flag is None:
            raise InputError(f"its {key} must be true or false, got {value!r}")
        return flag
    try:
        number = float(value)
    except (TypeError, ValueError):
        number = math.nan
    if not math.isfinite(number) or (kind is int and not number.is_integer()):
        raise InputError(f"its {key} must be a {'whole ' if kind is int else ''}number, got {value!r}")
    return kind(number)


def _csv_rows(path: Path) -> Iterator[dict[str, Any]]:
    for row in read_csv(path):
        yield {key: cell for key, cell in row.items() if cell or key not in COLUMNS}


def _toml_rows(path: Path) -> Iterator[dict[str, Any]]:
    content = tomllib.loads(path.read_text(encoding="utf-8"))
    if unknown := [key for key in content if key != "object"]:
        raise UnknownKey(str(path), unknown[0], ["object"])
    for table in content["object"]:
        if not isinstance(table, dict):
            raise ValueError("each object is a table: [[object]]")  # noqa: TRY004  # told with the others
        yield table


def _parquet_rows(path: Path) -> Iterator[dict[str, Any]]:
    check_packages(str(path), "pyarrow")
    from pyarrow import ArrowException, parquet  # takes its time

    try:
        rows = parquet.read_table(path, use_threads=False).to_pylist()
    except ArrowException as error:
        raise ValueError(str(error)) from None
    for row in rows:
        yield {key: value for key, value in row.items() if value not in (None, "") and value == value}


_READERS = {".csv": _csv_rows, ".parquet": _parquet_rows, ".toml": _toml_rows}
