"""The meshes of a hand made ready for the simulator: in metres, as OBJ files, hollow ones in parts."""

import xml.etree.ElementTree as ET
from collections.abc import Callable, Iterator
from pathlib import Path, PurePosixPath

import numpy as np

from qdgrasp_assets.decompose import TookTooLong, decompose, simple
from qdgrasp_assets.hands.body import collisions, corners_of, mesh_bytes
from qdgrasp_assets.hands.hollows import MUCH, is_solid, read_mesh_of
from qdgrasp_assets.hands.meshes import LARGEST, TAKEN
from qdgrasp_assets.hands.overlap import Floats
from qdgrasp_assets.hulls import groups
from qdgrasp_assets.mesh import Mesh, parts_to_obj
from qdgrasp_assets.objects.solids import hull
from qdgrasp_assets.room import Room
from qdgrasp_assets.shapes import numbers
from qdgrasp_assets.stl import triangles
from qdgrasp_assets.urdf import Urdf, origin
from qdgrasp_protocol.errors import AssetError

THRESHOLDS = (0.2, 0.1, 0.05)
"""CoACD's concavities in the order in which they are tried: the first whose parts leave the room is taken."""
TIME_LIMIT = 600.0
"""How long CoACD may take for one mesh at one concavity [s]."""
MILLIMETRES = 0.001
FEW = 4000
"""Meshes of more triangles are thinned before they are split."""
NEAR = 1.5e-3
"""Vertices of such a mesh that are in the same cube of this size become one [m]."""

Tell = Callable[[str], None]


class Splitter:
    """Writes the collision meshes of a hand anew.

    Parameters
    ----------
    path
        The URDF that names them.
    folder
        Where they will lie, relative to the URDF that will be written.
    tell
        Hears what takes long.
    """

    def __init__(self, path: Path, folder: str, tell: Tell) -> None:
        self._path = path
        self._folder = folder
        self._tell = tell
        self.files: dict[str, bytes] = {}
        """By the path that the URDF to be written names them with."""
        self._done: dict[tuple[str, str], tuple[str, str]] = {}
        """The new file of a mesh with its scale, and what was done to it."""

    def mend(self, hand: Urdf) -> Iterator[str]:
        """Have the shapes of a hand, in its element, name meshes that the simulator can take; and say so."""
        for link, shape in collisions(hand):
            mesh = shape.find("geometry/mesh")
            if mesh is None:
                continue
            key = mesh.get("filename", ""), mesh.get("scale", "1 1 1")
            if key not in self._done:
                self._done[key] = self._made(link, mesh)
            file, words = self._done[key]
            mesh.attrib.pop("scale", None)
            mesh.set("filename", file)
            if words:
                yield f"the mesh '{key[0]}' of the link '{link}' {words}"

    def corners(self, hand: Urdf, link: str) -> tuple[Floats, ...]:
        """The corners (v, 3) of the convex parts of a link of the mended hand [m], link frame."""
        return tuple(
            corners
            for name, shape in collisions(hand)
            if name == link
            for corners in self._corners(hand, link, shape)
        )

    def _corners(self, hand: Urdf, link: str, shape: ET.Element) -> Iterator[Floats]:
        mesh = shape.find("geometry/mesh")
        if mesh is None:
            yield from corners_of(hand, link, shape)
            return
        frame = origin(hand.path, shape.find("origin"))
        for corners in groups(self.files[mesh.get("filename", "")].decode()):
            yield corners @ frame[:3, :3].T + frame[:3, 3]

    def _made(self, link: str, element: ET.Element) -> tuple[str, str]:
        """A mesh written anew, its name, and what was done to it."""
        name = element.get("filename", "")
        mesh, words = _in_metres(read_mesh_of(self._path, element))
        parts, more = self._parts(link, name, element, mesh)
        file = self._new_name(PurePosixPath(name).stem)
        self.files[file] = parts_to_obj(parts)
        return file, " and ".join(told for told in (words, more) if told)

    def _parts(self, link: str, name: str, element: ET.Element, mesh: Mesh) -> tuple[tuple[Mesh, ...], str]:
        """The convex parts that stand for a mesh, and what that changes."""
        own = self._own(name, element, mesh)
        room = Room(mesh)
        filled = room.fit(own).filled
        if filled <= MUCH:
            return own, "" if _is_taken(
                self._path, name
            ) else "was made a convex hull, as the simulator reads no such file"
        self._tell(f"splitting the mesh '{name}' of the link '{link}' into convex parts")
        try:
            found, left = _split(mesh, name, room)
        except TookTooLong:
            return (
                own,
                f"stays a hull that fills the room before {100 * filled:.0f} % of its surface: no parts "
                "were found in time",
            )
        return found, (
            f"was split into {len(found)} convex parts: its hull would fill the room before "
            f"{100 * filled:.0f} % of "
            f"its surface, they fill {100 * left:.0f} %"
        )

    def _own(self, name: str, element: ET.Element, mesh: Mesh) -> tuple[Mesh, ...]:
        """The hulls that the simulator would make of a mesh itself, with few corners."""
        shapes = [mesh.vertices]
        if PurePosixPath(name).suffix.lower() == ".obj":
            text = mesh_bytes(self._path, name).decode("utf-8", "replace")
            shapes = [corners * numbers(element, "scale", "1 1 1") for corners in groups(text)]
            factor = np.ptp(mesh.vertices) / max(np.ptp(np.concatenate(shapes)), 1e-12)
            shapes = [corners * factor for corners in shapes]
        solids = tuple(simple(hull(corners)) for corners in shapes if is_solid(corners))
        if not solids:
            raise AssetError(f"The mesh '{name}' is flat: it encloses no volume; give it a thickness.")
        return solids

    def _new_name(self, stem: str) -> str:
        """A name for a mesh that no other has."""
        file, turn = f"{self._folder}/{stem}.obj", 1
        while file in self.files:
            file, turn = f"{self._folder}/{stem}_{turn}.obj", turn + 1
        return file


def _split(mesh: Mesh, name: str, room: Room) -> tuple[tuple[Mesh, ...], float]:
    """The fewest convex parts that leave the room before a mesh, else the finest; and the share they fill."""
    thin = thinned(mesh)
    for threshold in THRESHOLDS:
        found = decompose(thin, name, threshold, TIME_LIMIT)
        left = room.fit(found).filled
        if left <= MUCH:
            break
    return found, left


def thinned(mesh: Mesh) -> Mesh:
    """A mesh of many triangles with vertices that are nearer to each other than a finger can tell as one."""
    if len(mesh.faces) <= FEW:
        return mesh
    _, which = np.unique(np.round(mesh.vertices / NEAR), axis=0, return_inverse=True)
    which = which.reshape(-1)
    counts = np.bincount(which)
    middles = np.stack([np.bincount(which, mesh.vertices[:, axis]) / counts for axis in range(3)], axis=1)
    faces = which[mesh.faces]
    whole = (faces != np.roll(faces, 1, axis=1)).all(axis=1)
    _, first = np.unique(np.sort(faces[whole], axis=1), axis=0, return_index=True)
    return Mesh(middles, faces[whole][np.sort(first)])


def _in_metres(mesh: Mesh) -> tuple[Mesh, str]:
    side = float(np.ptp(mesh.vertices, axis=0).max())
    if side <= LARGEST:
        return mesh, ""
    return Mesh(
        mesh.vertices * MILLIMETRES, mesh.faces
    ), f"was {side:.4g} m large, and is taken for millimetres"


def _is_taken(path: Path, name: str) -> bool:
    """Whether the simulator reads a mesh file as it is."""
    kind = PurePosixPath(name).suffix.lower()
    return kind in TAKEN and (kind != ".stl" or triangles(mesh_bytes(path, name)) is not None)
