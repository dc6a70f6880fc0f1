"""Check of any asset by name or file: what it is and what is wrong with it, in words."""

from collections.abc import Iterable
from dataclasses import dataclass

import msgspec

from qdgrasp_assets import catalog, ycb
from qdgrasp_assets.asset_paths import NOT_THERE, named_path, path_problem, searched
from qdgrasp_assets.asset_report import GripperReport, examine, inspect_object
from qdgrasp_assets.geometry.collision_parts import known_parts
from qdgrasp_assets.geometry.mesh import Mesh
from qdgrasp_assets.geometry.mesh_repair import surface_faults
from qdgrasp_assets.object_model import read_draft
from qdgrasp_assets.stand_ins import STAND_INS, stand_in
from qdgrasp_assets.ycb import SCANS, lengths_in_words, scan_differences
from qdgrasp_protocol.errors import QdgraspError, UnknownName
from qdgrasp_protocol.text import counted

GRIPPER_SUFFIX = ".toml"


@dataclass(frozen=True)
class AssetSummary:
    """Result of the check of one asset."""

    name: str
    facts: tuple[str, ...] = ()
    faults: tuple[str, ...] = ()


def check(name: str) -> AssetSummary:
    """Check a gripper or object by name or file; `UnknownName` if it is neither."""
    try:
        return _check(name)
    except UnknownName:
        raise
    except QdgraspError as error:
        return AssetSummary(name, faults=(str(error),))


def is_gripper(name: str) -> bool:
    """Return whether a name or file means a gripper rather than an object."""
    return name.endswith(GRIPPER_SUFFIX) or name in {listing.name for listing in catalog.every_gripper()}


def _check(name: str) -> AssetSummary:
    if name in STAND_INS:
        target = stand_in(name)
        return _mesh_summary(name, target.mesh, (_hulls_in_words(target.parts), f"{target.mass:g} kg"))
    if name in SCANS:
        return _check_scan(name)
    if is_gripper(name):
        found = examine_gripper(name)
        return AssetSummary(name, found.facts, found.faults)
    if path_problem(named_path(name)) != NOT_THERE:
        draft = read_draft(named_path(name))
        report = inspect_object(draft, name, glued=True, parts=False)
        hulls = () if report.faults else (_known_hulls(draft.mesh),)
        return AssetSummary(name, report.facts + hulls, report.faults)
    known = [listing.name for listing in (*catalog.every_gripper(), *catalog.every_object())]
    raise UnknownName("asset", name, known, "Or name a mesh file, or a gripper's TOML file.")


def _check_scan(name: str) -> AssetSummary:
    scan, source = SCANS[name], ycb.scan_source(name)
    if source == catalog.ABSENT:
        fault = f"it is absent ({searched()}); `qdgrasp asset fetch {name}` fetches it"
        return AssetSummary(name, faults=(fault,))
    if source == "asset path":
        target = ycb.read_scan(name, "paper")
        facts = _hulls_in_words(target.parts), f"{target.mass:g} kg"
        return _mesh_summary(name, target.mesh, facts, scan_differences(target.mesh, scan))
    mesh = ycb.read_fetched(name)
    return _mesh_summary(name, mesh, (_known_hulls(mesh),), scan_differences(mesh, scan))


def _mesh_summary(name: str, mesh: Mesh, facts: Iterable[str], faults: Iterable[str] = ()) -> AssetSummary:
    size = f"{lengths_in_words(mesh.extents)} m", counted(len(mesh.faces), "triangle")
    volume = f"{mesh.volume * 1e6:.2f} cm3"
    return AssetSummary(name, (*size, volume, *facts), (*surface_faults(mesh), *faults))


def _known_hulls(mesh: Mesh) -> str:
    known = known_parts(mesh)
    return _hulls_in_words(known[1]) if known else "convex parts not found yet: CoACD will, at first use"


def _hulls_in_words(parts: tuple[Mesh, ...]) -> str:
    return counted(len(parts), "convex part")


def examine_gripper(name: str) -> GripperReport:
    """Examine a gripper of the catalog, or a gripper's file; `UnknownName` if it is neither.

    A reference hand is as its authors published it, with limits that have a meaning of their own: faults of
    other hands are only notes for it.
    """
    found = examine(catalog.gripper_path(name), name)
    if not found.faults or not name.startswith(catalog.REFERENCE):
        return found
    try:
        catalog.find_gripper(name)
    except QdgraspError:
        return found
    return msgspec.structs.replace(found, notes=found.faults, faults=())
