"""The values of a gripper's TOML file: keys that no field has, fields left out, and values of other kinds."""

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import msgspec

from qdgrasp_protocol.errors import AssetError, UnknownKey

Tables = Mapping[str, Any]
"""The struct of each table: of the file itself by an empty name, of `joints` for each of `[joints.NAME]`."""
Vector, Pair, Names = tuple[float, float, float], tuple[float, float], tuple[str, ...]
KINDS: dict[Any, str] = {
    str: "text",
    bool: "true or false",
    float: "a number",
    float | None: "a number",
    Pair: "two numbers",
    Vector: "three numbers",
    Names: "a list of names",
}
"""What a field takes, in words."""
WRITTEN = {
    "joints": "tables [joints.NAME]",
    "synergies": "tables [[synergies]]",
    "free_joints": "tables [free_joints.NAME]",
    "jaw": "a table [jaw]",
}
"""How inner tables are written."""
NEEDED = {
    "urdf": "name the hand's URDF",
    "base_link": "name the link from which the hand goes out",
    "approach_axis": "say which way the palm looks, such as [0, 0, 1]",
    "palm_offset": "say how far the palm is from the base link along approach_axis [m]",
    "standoff": "say how far the palm may stay away, [least, greatest] [m]",
    "finger_links": "name the links whose touch makes a success",
    "joints": "say of each joint that moves where it is open and closed",
    "joints.open": "say where it is in the open posture [rad or m]",
    "synergies.name": "call it something",
    "synergies.joints": "name those that close together",
    "free_joints.low": "say where the least of its gene puts it [rad or m]",
    "free_joints.high": "say where the greatest of its gene puts it [rad or m]",
    "jaw.axis": "say which way one finger is from the other, such as [0, 1, 0]",
    "jaw.opening": "say how far apart the open fingers are [m]",
}
"""What to do about a field that is left out and has no default."""


def check_values(path: Path, values: dict[str, Any], tables: Tables) -> None:
    """Check what the TOML at `path` holds, the inner tables first.

    Raises
    ------
    UnknownKey
        A key that no field has.
    AssetError
        Fields are left out, or one is of another kind.
    """
    for table, label, entry in (*_inner(values, tables), ("", "", values)):
        _check_table(path, table, label, entry, tables[table])


def _inner(values: dict[str, Any], tables: Tables) -> Iterator[tuple[str, str, Any]]:
    """Each inner table by its kind and its name, as far as there are any."""
    for table in tables:
        match values.get(table):
            case dict() as entry if table == "jaw":
                yield table, table, entry
            case dict() as named if table:
                yield from ((table, f"{table}.{name}", entry) for name, entry in named.items())
            case list() as listed:
                yield from ((table, f"{table}.{place}", entry) for place, entry in enumerate(listed))


def _check_table(path: Path, table: str, label: str, values: Any, struct: Any) -> None:
    fields = {field.name: field for field in msgspec.structs.fields(struct)}
    if not isinstance(values, dict):
        raise AssetError(f"'{path}': {label} must be a table, got {values!r}.")
    for name, value in values.items():
        if name not in fields:
            raise UnknownKey(f"{path}: {label}" if label else str(path), name, fields)
        _check_kind(path, f"{label}.{name}" if label else name, value, fields[name].type)
    place = f" in {label}" if label else ""
    missing = [
        f"no {name}{place}: {NEEDED[f'{table}.{name}' if table else name]}"
        for name, field in fields.items()
        if field.required and name not in values
    ]
    if missing:
        raise AssetError(f"'{path}' says {'; '.join(missing)}.")


def _check_kind(path: Path, name: str, value: Any, kind: Any) -> None:
    try:
        msgspec.convert(value, kind)
    except msgspec.ValidationError:
        expected = KINDS.get(kind) or WRITTEN[name]
        raise AssetError(f"'{path}': {name} must be {expected}, got {value!r}.") from None
