"""The collision shapes of a hand: whether the simulator can take them, in words."""

import xml.etree.ElementTree as ET
from collections.abc import Iterator
from pathlib import PurePosixPath

import numpy as np

from qdgrasp_assets.files import amiss
from qdgrasp_assets.hands.body import collisions, corners_of, mesh_bytes
from qdgrasp_assets.shapes import FORMS
from qdgrasp_assets.stl import triangles
from qdgrasp_assets.urdf import Urdf
from qdgrasp_protocol.errors import AssetError
from qdgrasp_protocol.phrases import few, quoted

LARGEST = 2.0
"""No link is so large [m]: what is larger was drawn in millimetres."""
SIZES = {"box": ("size",), "cylinder": ("radius", "length"), "sphere": ("radius",)}
COUNTS = {"box": 3, "cylinder": 2, "sphere": 1}
"""How many numbers that is."""
PACKAGE = "package://"
TAKEN = (".stl", ".obj", ".dae")
"""Mesh files that the simulator reads."""
MOST_NAMED = 3
"""So many meshes of a kind are named."""


def mesh_faults(hand: Urdf) -> tuple[str, ...]:
    """What keeps the shapes of a hand from being simulated; empty when nothing does."""
    missing = missing_meshes(hand)
    if missing:
        return missing
    faults = (_fault(hand, link, shape) for link, shape in collisions(hand))
    return (*_kind_faults(hand), *(fault for fault in faults if fault))


def _kind_faults(hand: Urdf) -> Iterator[str]:
    """Mesh files of kinds that the simulator does not read, one sentence for each kind."""
    kinds: dict[str, list[str]] = {}
    for name in _references(hand):
        kinds.setdefault(_kind(name), []).append(name)
    for kind in sorted(kinds.keys() - TAKEN):
        them, is_one = few(quoted(kinds[kind]), MOST_NAMED), len(kinds[kind]) == 1
        told = f"the mesh {them} is a" if is_one else f"the meshes {them} are"
        yield (
            f"{told} {kind or 'nondescript'} file{'' if is_one else 's'}, and the simulator reads "
            f"{', '.join(TAKEN)}: save {'it as one' if is_one else 'them as such'}, or use --mend"
        )


def _kind(name: str) -> str:
    """The ending of a mesh file's name, with its dot."""
    return PurePosixPath(name).suffix.lower()


def missing_meshes(hand: Urdf) -> tuple[str, ...]:
    """The mesh files of a hand's collision shapes that are not there or cannot be read, in words."""
    return tuple(
        f"the mesh '{name}' of the link{'s' * (len(links) > 1)} {', '.join(quoted(links))} "
        f"{_where(hand, name)}"
        for name, links in _references(hand).items()
        if not _can_be_read(hand, name)
    )


def _can_be_read(hand: Urdf, name: str) -> bool:
    try:
        mesh_bytes(hand.path, name)
    except AssetError:
        return False
    return True


def _references(hand: Urdf) -> dict[str, list[str]]:
    """Mesh files with the links that touch by them, in the order of the file."""
    found: dict[str, list[str]] = {}
    for link, shape in collisions(hand):
        for mesh in shape.iter("mesh"):
            links = found.setdefault(mesh.get("filename", ""), [])
            if link not in links:
                links.append(link)
    return found


def _where(hand: Urdf, name: str) -> str:
    """Why a mesh cannot be read, where it should be, and what to do."""
    if not name.startswith(PACKAGE):
        place = hand.path.parent / name.removeprefix("file://")
        return f"{amiss(place) or 'cannot be read'}: there should be a mesh file at '{place}'"
    package, _, rest = name.removeprefix(PACKAGE).partition("/")
    return (
        f"is not found: a folder '{package}' with '{rest}' is looked for above the URDF, beside one of the "
        f"folders above it, and as a Python package; put the ROS package '{package}' there, "
        "or write the path relative to the URDF"
    )


def _fault(hand: Urdf, link: str, shape: ET.Element) -> str:
    """What is wrong with one collision shape; empty when nothing is."""
    geometry = shape.find("geometry")
    form = geometry[0] if geometry is not None and len(geometry) else None
    if form is None:
        return f"a <collision> of the link '{link}' has no shape in its <geometry>; add one, or leave it out"
    if form.tag not in FORMS:
        return (
            f"the link '{link}' has a collision shape <{form.tag}>, and URDF knows {', '.join(FORMS)}: "
            "make it one of those"
        )
    if form.tag == "mesh":
        return _mesh_fault(hand, link, shape, form.get("filename", ""))
    return _size_fault(link, form)


def _size_fault(link: str, form: ET.Element) -> str:
    """Whether a box, cylinder or sphere has a size that there can be."""
    told = " ".join(form.get(name, "") for name in SIZES[form.tag])
    try:
        sizes = [float(word) for word in told.split()]
    except ValueError:
        sizes = []
    if len(sizes) == COUNTS[form.tag] and min(sizes) > 0:
        return ""
    return (
        f"the link '{link}' has a collision shape <{form.tag}> of the size '{told}': it takes "
        f"{' and '.join(SIZES[form.tag])}, {COUNTS[form.tag]} in all, greater than 0"
    )


def _mesh_fault(hand: Urdf, link: str, shape: ET.Element, name: str) -> str:
    mesh = f"the mesh '{name}' of the link '{link}'"
    if _kind(name) not in TAKEN:
        return ""  # told of all such meshes at once
    if _kind(name) == ".stl" and triangles(mesh_bytes(hand.path, name)) is None:
        return f"{mesh} is no binary STL file, which alone the simulator reads: save it as one, or use --mend"
    try:
        corners = np.concatenate([np.zeros((0, 3)), *corners_of(hand, link, shape)])
    except AssetError as error:
        return str(error).rstrip(".")
    if not len(corners):
        return f"{mesh} is empty: give it one with a surface, or leave the shape out"
    if not np.isfinite(corners).all():
        return f"{mesh} has vertices that are not finite: export it again"
    side = float(np.ptp(corners, axis=0).max())
    if side > LARGEST:
        return (
            f"{mesh} is {side:.4g} m large, so it looks like millimetres: write "
            '<mesh filename="..." scale="0.001 0.001 0.001"/>, or use --mend'
        )
    return ""
