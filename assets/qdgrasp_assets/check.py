"""What an asset is and what is wrong with it, in words."""

import hashlib
from collections.abc import Callable
from dataclasses import dataclass

import msgspec

from qdgrasp_assets import catalog, ycb
from qdgrasp_assets.convex import parts_at_hand
from qdgrasp_assets.files import NOT_THERE, amiss, named_path, searched
from qdgrasp_assets.hands.examination import Examination, examine
from qdgrasp_assets.inspection import inspect
from qdgrasp_assets.lock import pin
from qdgrasp_assets.mesh import Mesh
from qdgrasp_assets.mesh_file import read_mesh
from qdgrasp_assets.objects.stand_ins import STAND_INS, stand_in
from qdgrasp_assets.scans import SCANS, differences, fetched_mesh, put_right, size
from qdgrasp_assets.solid import read_draft
from qdgrasp_assets.solidity import faults
from qdgrasp_protocol.errors import QdgraspError, UnknownName
from qdgrasp_protocol.phrases import counted

GRIPPER_SUFFIX = ".toml"


@dataclass(frozen=True)
class Report:
    """What was found of one asset."""

    name: str
    facts: tuple[str, ...] = ()
    faults: tuple[str, ...] = ()
    """Empty when nothing is wrong."""


def check(name: str) -> Report:
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
        return Report(name, faults=(str(error),))


def is_gripper(name: str) -> bool:
    """Whether a name or file means a gripper rather than an object."""
    return name.endswith(GRIPPER_SUFFIX) or name in {listing.name for listing in catalog.every_gripper()}


def _check_of(name: str) -> Callable[[str], Report]:
    if name in STAND_INS:
        return _stand_in
    if name in SCANS:
        return _SCANS[ycb.source(name)]
    if is_gripper(name):
        return _gripper
    if amiss(named_path(name)) != NOT_THERE:
        return _mesh_file
    known = [listing.name for listing in (*catalog.every_gripper(), *catalog.every_object())]
    raise UnknownName("asset", name, known, "Or name a mesh file, or a gripper's TOML file.")


def _stand_in(name: str) -> Report:
    target = stand_in(name)
    return _of_mesh(name, target.mesh, _hulls(len(target.parts)), f"{target.mass:g} kg")


def _on_asset_path(name: str) -> Report:
    target = ycb.read_scan(name, "paper")
    report = _of_mesh(name, target.mesh, _hulls(len(target.parts)), f"{target.mass:g} kg")
    return Report(name, report.facts, report.faults + differences(target.mesh, SCANS[name]))


def _fetched(name: str) -> Report:
    file, scan = fetched_mesh(name), SCANS[name]
    mesh = put_right(read_mesh(file), scan)
    known, found = pin(scan.archive).mesh_sha256, hashlib.sha256(file.read_bytes()).hexdigest()
    report = _of_mesh(
        name, mesh, _known_hulls(mesh), f"sha256 {found}" + ("" if known else " (none is known)")
    )
    tampered = known is not None and known != found
    hashes = (f"its file '{file}' has sha256 {found} instead of {known}; fetch it again",) if tampered else ()
    return Report(name, report.facts, report.faults + differences(mesh, scan) + hashes)


def _absent(name: str) -> Report:
    return Report(name, faults=(f"it is absent ({searched()}); `qdgrasp asset fetch {name}` fetches it",))


_SCANS: dict[str, Callable[[str], Report]] = {
    "asset path": _on_asset_path,
    "fetched": _fetched,
    catalog.ABSENT: _absent,
}


def _mesh_file(name: str) -> Report:
    draft = read_draft(named_path(name))
    found = inspect(draft, name, glued=True, parts=False)
    return Report(name, found.facts + (() if found.faults else (_known_hulls(draft.mesh),)), found.faults)


def _of_mesh(name: str, mesh: Mesh, *more: str) -> Report:
    facts = (
        f"{size(mesh.extents)} m",
        counted(len(mesh.faces), "triangle"),
        f"{mesh.volume * 1e6:.2f} cm3",
        *more,
    )
    return Report(name, tuple(fact for fact in facts if fact), faults(mesh))


def _known_hulls(mesh: Mesh) -> str:
    parts = parts_at_hand(mesh)
    return "convex parts not found yet: CoACD will, at first use" if parts is None else _hulls(len(parts))


def _hulls(number: int) -> str:
    return f"{number} convex part{'s' if number > 1 else ''}"


def examine_gripper(name: str) -> Examination:
    """Everything that is known of a gripper of the catalog, or of a gripper's file.

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


def _gripper(name: str) -> Report:
    found = examine_gripper(name)
    return Report(name, found.facts, found.faults)
