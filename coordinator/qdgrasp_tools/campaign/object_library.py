"""Reads a library: objects that a manifest names, or that lie in a folder of meshes.

A manifest is a table in CSV or Parquet with a row for each object. All that cannot be used are named at once,
or left out and reported where that is asked for. Checks of a mesh are remembered by its content
(`check_mesh`).
"""

from collections.abc import Iterable, Mapping, Sequence
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
from qdgrasp_protocol.spec import ObjectRecord, run_spec

MANIFEST_FORMATS = (".csv", ".parquet")
PREPARATIONS = tuple(field.name for field in structs.fields(MeshPreparation))
NOTES = tuple(field.name for field in structs.fields(ObjectRecord))
NUMBERS = ("mass", "density", "friction", "scale")
COLUMNS = ("file", "unit", *NUMBERS, *NOTES, *PREPARATIONS)
"""Columns of a manifest; all but `file` may be missing or empty."""
MASS_DIGITS = 6  # Significant digits of a mass that follows from a density
GREATEST_MASS = 1000  # Greatest mass that a spec allows [kg]
NO_MASS = "it has no mass; say what it weighs with --mass or --density, or in a manifest"


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


class SkippedObject(Struct, frozen=True):
    """An object that is left out of a campaign."""

    object: str
    file: str
    reason: str
    """What is wrong, and what to do where that is known."""


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
    def values(self) -> dict[str, Any]:
        """Its values by the keys of a spec, without the mass: plain ones."""
        said = {key: getattr(self, key) for key in ("scale", "friction", "mesh", "about")}
        return {key: msgspec.to_builtins(value) for key, value in said.items() if value is not None}


def is_manifest(path: Path) -> bool:
    """Return whether a path is a manifest's."""
    return path.suffix.lower() in MANIFEST_FORMATS


def read_library(where: Path, rules: LibraryRules, tell: Tell = ignore_progress) -> Library:
    """Read a manifest, or all meshes below a folder, and check every mesh.

    `tell` is called with a sentence before each. Raises InputError if there is no such file or folder, or it
    cannot be read as one, and UnusableMeshes for objects that cannot be used, unless these are to be skipped
    and others are left.
    """
    rows = _manifest_rows(where) if is_manifest(where) else _folder_rows(where)
    faults = _repeats(rows)
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
        used = structs.replace(row, scale=scale, mesh=mesh)
        objects[str(row.file)] = {"mass": mass} | used.values
    if faults and not (rules.skip_unusable and objects):
        raise UnusableMeshes(len(rows), faults)
    files = {row.name: str(row.file) for row in rows}
    return Library(objects, tuple(SkippedObject(name, files[name], why) for name, why in faults.items()))


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
    return csv_text((structs.asdict(each) for each in skipped), SkippedObject.__struct_fields__).encode()


def read_skip_report(report: Path) -> list[SkippedObject]:
    """Read the table of the objects that are left out; a missing one is empty."""
    if not report.is_file():
        return []
    columns = SkippedObject.__struct_fields__
    return [SkippedObject(*(row[name] for name in columns)) for row in read_csv(report, columns)]


def _mass(row: LibraryRow, rules: LibraryRules, checked: MeshCheck) -> float | None:
    """Return the mass of an object [kg]: the row's own, else by the rules; None: unknown."""
    if row.mass is not None:
        return row.mass
    density = rules.density if row.density is None else row.density
    return rules.mass if density is None else float(f"{density * checked.volume:.{MASS_DIGITS}g}")


def _repeats(rows: Sequence[LibraryRow]) -> dict[str, str]:
    """Find rows whose file is that of an earlier row without a fault."""
    files, faults = dict[Path, str](), dict[str, str]()
    for row in rows:
        if row.fault:
            continue
        if (other := files.setdefault(row.file, row.name)) != row.name:
            faults[row.name] = f"its file is that of '{other}' too; name each file once"
    return faults


def _folder_rows(folder: Path) -> list[LibraryRow]:
    """Return the meshes below a folder.

    Those in folders of it have their path as their id, as their files may have the same names.
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
    rows = []
    for file in found:
        name = file.relative_to(folder)
        about = ObjectRecord(id=name.with_suffix("").as_posix()) if len(name.parts) > 1 else None
        rows.append(LibraryRow(name=name.as_posix(), file=file.resolve(), about=about))
    return rows


def _manifest_rows(path: Path) -> list[LibraryRow]:
    """Return the rows of a manifest, no two of one name; files are relative to its folder."""
    tables = _manifest_tables(path)
    if not tables:
        raise InputError(f"The manifest '{path}' names no object: it needs a row for each, with its file.")
    for key in dict.fromkeys(key for table in tables for key in table):
        if key not in COLUMNS:
            raise UnknownKey(str(path), str(key), COLUMNS)
    rows: dict[str, LibraryRow] = {}
    for number, table in enumerate(tables, 1):
        # missing numbers of a Parquet table may be NaN
        said = {key: value for key, value in table.items() if value not in (None, "") and value == value}
        if "file" not in said:
            raise InputError(f"The manifest '{path}' says no file in row {number}: every object needs one.")
        row = _row(said, path.absolute().parent)
        name = f"{row.name} (row {number})" if row.name in rows else row.name
        rows[name] = structs.replace(row, name=name)
    return list(rows.values())


def _manifest_tables(path: Path) -> list[dict[str, Any]]:
    if path.suffix.lower() == ".csv":
        return list[dict[str, Any]](read_csv(path))
    check_packages(str(path), "pyarrow")
    from pyarrow import ArrowException, parquet  # takes its time

    try:
        return list(parquet.read_table(path, use_threads=False).to_pylist())
    except (OSError, ArrowException) as error:
        raise InputError(f"The manifest '{path}' cannot be read: {error}.") from None


def _row(table: Mapping[str, Any], folder: Path) -> LibraryRow:
    """Return a row of plain values; what is wrong with them is its fault."""
    relative = Path(str(table["file"]))
    id_ = str(table.get("id", "")) or relative.with_suffix("").as_posix()
    row = LibraryRow(name=id_, file=(folder / relative).resolve())
    notes, mesh, said = (
        {key: table[key] for key in keys if key in table} for keys in (NOTES, PREPARATIONS, NUMBERS)
    )
    try:
        for one, other in (("mass", "density"), ("unit", "scale")):
            if {one, other} <= table.keys():
                raise InputError(f"its row says {one} and {other}; say one of them")
        if "unit" in table:
            said["scale"] = scale_of(str(table["unit"]))
        said |= {"about": notes | {"id": id_}} | ({"mesh": mesh} if mesh else {})
        found = msgspec.convert(said | {"name": row.name, "file": row.file}, LibraryRow, strict=False)
        run_spec({"gripper": "", "object": ""} | found.values, "row")
    except (msgspec.ValidationError, InputError) as error:
        return structs.replace(row, fault=str(error).rstrip("."))
    return found
