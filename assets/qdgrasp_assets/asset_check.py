"""Check of any asset by name or file: what it is and what is wrong with it, in words."""

import hashlib
from collections.abc import Callable
from dataclasses import dataclass

import msgspec

from qdgrasp_assets import catalog, ycb
from qdgrasp_assets.asset_paths import NOT_THERE, named_path, path_problem, searched
from qdgrasp_assets.asset_report import GripperReport, examine, inspect_object
from qdgrasp_assets.geometry.collision_parts import available_parts
from qdgrasp_assets.geometry.mesh import Mesh
from qdgrasp_assets.geometry.mesh_io import read_mesh
from qdgrasp_assets.geometry.mesh_repair import surface_faults
from qdgrasp_assets.object_model import read_draft
from qdgrasp_assets.stand_ins import STAND_INS, stand_in
from qdgrasp_assets.ycb import SCANS, correct_mesh, fetched_mesh, lengths_in_words, read_pin, scan_differences
from qdgrasp_protocol.errors import QdgraspError, UnknownName
from qdgrasp_protocol.text import counted

GRIPPER_SUFFIX = ".toml"


@dataclass(frozen=True)
class AssetSummary:
    """Result of the check of one asset."""

    name: str
    facts: tuple[str, ...] = ()
    faults: tuple[str, ...] = ()
    """Faults in words; empty if there are no faults."""


def check(name: str) -> AssetSummary:
    """Check a gripper or object of the catalog, or a mesh or gripper file.

    Raises
    ------
    UnknownName
        It is none of these.
    """
    try:
        return _check_of(name)(name)
    except UnknownName:
        raise
    except QdgraspError as error:
        return AssetSummary(name, faults=(str(error),))


def is_gripper(name: str) -> bool:
    """Return whether a name or file means a gripper rather than an object."""
    return name.endswith(GRIPPER_SUFFIX) or name in {listing.name for listing in catalog.every_gripper()}


def _check_of(name: str) -> Callable[[str], AssetSummary]:
    if name in STAND_INS:
        return _stand_in
    if name in SCANS:
        return _SCANS[ycb.scan_source(name)]
    if is_gripper(name):
        return _gripper
    if path_problem(named_path(name)) != NOT_THERE:
        return _mesh_file
    known = [listing.name for listing in (*catalog.every_gripper(), *catalog.every_object())]
    raise UnknownName("asset", name, known, "Or name a mesh file, or a gripper's TOML file.")


def _stand_in(name: str) -> AssetSummary:
    target = stand_in(name)
    return _of_mesh(name, target.mesh, _hulls_in_words(len(target.parts)), f"{target.mass:g} kg")


def _on_asset_path(name: str) -> AssetSummary:
    target = ycb.read_scan(name, "paper")
    report = _of_mesh(name, target.mesh, _hulls_in_words(len(target.parts)), f"{target.mass:g} kg")
    return AssetSummary(name, report.facts, report.faults + scan_differences(target.mesh, SCANS[name]))


def _fetched(name: str) -> AssetSummary:
    file, scan = fetched_mesh(name), SCANS[name]
    mesh = correct_mesh(read_mesh(file), scan)
    known, found = read_pin(scan.archive).mesh_sha256, hashlib.sha256(file.read_bytes()).hexdigest()
    report = _of_mesh(
        name, mesh, _known_hulls(mesh), f"sha256 {found}" + ("" if known else " (none is known)")
    )
    tampered = known is not None and known != found
    hashes = (f"its file '{file}' has sha256 {found} instead of {known}; fetch it again",) if tampered else ()
    return AssetSummary(name, report.facts, report.faults + scan_differences(mesh, scan) + hashes)


def _absent(name: str) -> AssetSummary:
    return AssetSummary(
        name, faults=(f"it is absent ({searched()}); `qdgrasp asset fetch {name}` fetches it",)
    )


_SCANS: dict[str, Callable[[str], AssetSummary]] = {
    "asset path": _on_asset_path,
    "fetched": _fetched,
    catalog.ABSENT: _absent,
}


def _mesh_file(name: str) -> AssetSummary:
    draft = read_draft(named_path(name))
    found = inspect_object(draft, name, glued=True, parts=False)
    return AssetSummary(
        name, found.facts + (() if found.faults else (_known_hulls(draft.mesh),)), found.faults
    )


def _of_mesh(name: str, mesh: Mesh, *more: str) -> AssetSummary:
    facts = (
        f"{lengths_in_words(mesh.extents)} m",
        counted(len(mesh.faces), "triangle"),
        f"{mesh.volume * 1e6:.2f} cm3",
        *more,
    )
    return AssetSummary(name, tuple(fact for fact in facts if fact), surface_faults(mesh))


def _known_hulls(mesh: Mesh) -> str:
    parts = available_parts(mesh)
    return (
        "convex parts not found yet: CoACD will, at first use"
        if parts is None
        else _hulls_in_words(len(parts))
    )


def _hulls_in_words(number: int) -> str:
    return f"{number} convex part{'s' if number > 1 else ''}"


def examine_gripper(name: str) -> GripperReport:
    """Examine a gripper of the catalog, or a gripper's file.

    A reference hand is as its authors published it, with limits that have a meaning of their own: what would
    be wrong with another hand is only noted.

    Raises
    ------
    UnknownName
        It is neither.
    """
    found = examine(catalog.gripper_path(name), name)
    if not found.faults or not name.startswith(catalog.REFERENCE):
        return found
    try:
        catalog.find_gripper(name)
    except QdgraspError:
        return found
    return msgspec.structs.replace(found, notes=found.faults, faults=())


def _gripper(name: str) -> AssetSummary:
    found = examine_gripper(name)
    return AssetSummary(name, found.facts, found.faults)
