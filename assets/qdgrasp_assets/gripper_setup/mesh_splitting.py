"""Collision meshes for the simulator: in metres, as OBJ, hollow ones split into parts.

The simulator wraps each mesh in its convex hull, and so fills those that are hollow.
"""

import io
import xml.etree.ElementTree as ET
from collections.abc import Iterator
from math import isclose
from pathlib import PurePosixPath

import numpy as np

from qdgrasp_assets.geometry.collision_parts import (
    FingerClearance,
    Tell,
    decompose,
    simplify_part,
)
from qdgrasp_assets.geometry.mesh import Floats, Mesh, parts_to_obj, stl_triangles
from qdgrasp_assets.geometry.primitives import hull
from qdgrasp_assets.grippers.collision_shapes import CONCAVE, attribute_numbers, obj_group_corners
from qdgrasp_assets.grippers.hand_model import collision_corners, collision_elements, mesh_bytes
from qdgrasp_assets.grippers.urdf import Urdf, add_file, parse_origin
from qdgrasp_assets.grippers.urdf_checks import LARGEST_SHAPE, SIMULATOR_FORMATS
from qdgrasp_protocol.errors import AssetError

MUCH_FILLED = 0.1  # A link is hollow where its hull fills the room in front of this share of its surface
VOLUME_TOLERANCE = 0.001  # Volumes that differ by at most this share are taken as equal


def hollow_meshes(hand: Urdf) -> Iterator[tuple[str, float]]:
    """Yield links of hollow meshes, with the share of the surface before which hulls fill room."""
    for link, shape in collision_elements(hand):
        element = shape.find("geometry/mesh")
        if element is None or shape.get(CONCAVE) is not None:
            continue
        parts = tuple(hull(corners) for corners in collision_corners(hand, link, shape) if is_solid(corners))
        mesh, frame = read_mesh_of(hand, element), parse_origin(hand.path, shape.find("origin"))
        surface = Mesh(mesh.vertices @ frame[:3, :3].T + frame[:3, 3], mesh.faces)
        volume = sum(part.volume for part in parts)
        if not parts or isclose(volume, surface.volume, rel_tol=VOLUME_TOLERANCE):
            continue
        filled = FingerClearance(surface).fit(parts).filled
        if filled > MUCH_FILLED:
            yield link, filled


def read_mesh_of(robot: Urdf, element: ET.Element) -> Mesh:
    """Read a robot's `<mesh>`, scaled, equal vertices merged; `AssetError` if it cannot be read."""
    import trimesh

    name = element.get("filename", "")
    content, kind = mesh_bytes(robot, name), PurePosixPath(name).suffix.removeprefix(".").lower()
    try:
        read = trimesh.load_mesh(io.BytesIO(content), file_type=kind)
    except Exception as error:  # noqa: BLE001  # trimesh's readers raise errors of any kind
        raise AssetError(
            f"The mesh '{name}' cannot be read ({type(error).__name__}: {error}); save it as an STL or "
            "OBJ file."
        ) from None
    read.merge_vertices(merge_tex=True, merge_norm=True)
    scale = attribute_numbers(element, "scale", "1 1 1")
    mesh = Mesh(np.asarray(read.vertices, dtype=np.float64) * scale, np.asarray(read.faces, dtype=np.int64))
    return mesh.flipped() if np.prod(scale) < 0 else mesh


def is_solid(corners: Floats) -> bool:
    """Return whether corners (v, 3) span three dimensions."""
    return bool(len(corners) and np.linalg.matrix_rank(corners - corners[0], tol=1e-7) == 3)


THRESHOLDS = (0.2, 0.1, 0.05)
"""Concavities for CoACD, in the order tried: the first whose parts leave the room is taken."""
MILLIMETRES = 0.001
FEW_TRIANGLES = 4000  # Triangles above which a mesh is thinned before it is split
NEAR_VERTICES = 1.5e-3  # Vertices of such a mesh that are in the same cube of this size become one [m]


class MeshSplitter:
    """Rewrites the collision meshes of a hand.

    The new meshes go to `folder`, relative to the URDF that will be written. `tell` is called with a sentence
    before each slow step.
    """

    def __init__(self, hand: Urdf, folder: str, tell: Tell) -> None:
        self._hand = hand
        self._folder = folder
        self._tell = tell
        self.files: dict[str, bytes] = {}
        """Contents by the path that the URDF to be written names them with."""
        self._done: dict[tuple[str, str], tuple[str, str]] = {}
        """New file and change in words, by mesh and scale."""

    def repair(self) -> Iterator[str]:
        """Rewrite the meshes of the hand for the simulator, in its element; yields the changes."""
        for link, shape in collision_elements(self._hand):
            mesh = shape.find("geometry/mesh")
            if mesh is None:
                continue
            key = mesh.get("filename", ""), mesh.get("scale", "1 1 1")
            if key not in self._done:
                self._done[key] = self._rewrite(link, mesh)
            file, words = self._done[key]
            mesh.attrib.pop("scale", None)
            mesh.set("filename", file)
            if words:
                yield f"the mesh '{key[0]}' of the link '{link}' {words}"

    def corners(self, hand: Urdf, link: str) -> tuple[Floats, ...]:
        """Return the corners (v, 3) of the repaired link's convex parts [m], link frame."""
        found: list[Floats] = []
        for name, shape in collision_elements(hand):
            if name != link:
                continue
            mesh = shape.find("geometry/mesh")
            if mesh is None:
                found += collision_corners(hand, link, shape)
                continue
            frame = parse_origin(hand.path, shape.find("origin"))
            for corners in obj_group_corners(self.files[mesh.get("filename", "")].decode()):
                found.append(corners @ frame[:3, :3].T + frame[:3, 3])
        return tuple(found)

    def _rewrite(self, link: str, element: ET.Element) -> tuple[str, str]:
        """Write a mesh anew; return its new name and the change."""
        name, words = element.get("filename", ""), []
        mesh = read_mesh_of(self._hand, element)
        side = float(np.ptp(mesh.vertices, axis=0).max())
        if side > LARGEST_SHAPE:
            mesh = mesh.scaled(MILLIMETRES)
            words.append(f"was {side:.4g} m large, and is taken for millimetres")
        parts, change = self._parts(link, name, element, mesh)
        stem = f"{self._folder}/{PurePosixPath(name).stem}"
        file = add_file(self.files, stem, ".obj", parts_to_obj(parts))
        return file, " and ".join([*words, *([change] if change else [])])

    def _parts(self, link: str, name: str, element: ET.Element, mesh: Mesh) -> tuple[tuple[Mesh, ...], str]:
        """Return the fewest parts that leave the free space, else the finest, and the change."""
        own, clearance = self._hulls_of(name, element, mesh), FingerClearance(mesh)
        filled = clearance.fit(own).filled
        if filled <= MUCH_FILLED:
            kind = PurePosixPath(name).suffix.lower()
            is_text = kind == ".stl" and stl_triangles(mesh_bytes(self._hand, name)) is None
            is_read = kind in SIMULATOR_FORMATS and not is_text
            return own, "" if is_read else "was made a convex hull, as the simulator reads no such file"
        self._tell(f"splitting the mesh '{name}' of the link '{link}' into convex parts")
        thin, percent = thin_mesh(mesh), f"{100 * filled:.0f} %"
        for threshold in THRESHOLDS:
            found = decompose(thin, name, threshold)
            left = clearance.fit(found).filled
            if left <= MUCH_FILLED:
                break
        return found, (
            f"was split into {len(found)} convex parts: its hull would fill the room before {percent} of its "
            f"surface, they fill {100 * left:.0f} %"
        )

    def _hulls_of(self, name: str, element: ET.Element, mesh: Mesh) -> tuple[Mesh, ...]:
        """Return the hulls that the simulator itself would make of a mesh, with few corners."""
        shapes = [mesh.vertices]
        if PurePosixPath(name).suffix.lower() == ".obj":
            text = mesh_bytes(self._hand, name).decode("utf-8", "replace")
            shapes = [
                corners * attribute_numbers(element, "scale", "1 1 1") for corners in obj_group_corners(text)
            ]
            factor = np.ptp(mesh.vertices) / max(np.ptp(np.concatenate(shapes)), 1e-12)
            shapes = [corners * factor for corners in shapes]
        solids = tuple(simplify_part(hull(corners)) for corners in shapes if is_solid(corners))
        if not solids:
            raise AssetError(f"The mesh '{name}' is flat: it encloses no volume; give it a thickness.")
        return solids


def thin_mesh(mesh: Mesh) -> Mesh:
    """Merge vertices nearer than `NEAR_VERTICES` in a mesh of many triangles."""
    if len(mesh.faces) <= FEW_TRIANGLES:
        return mesh
    _, which = np.unique(np.round(mesh.vertices / NEAR_VERTICES), axis=0, return_inverse=True)
    which = which.reshape(-1)
    counts = np.bincount(which)
    middles = np.stack([np.bincount(which, mesh.vertices[:, axis]) / counts for axis in range(3)], axis=1)
    faces = which[mesh.faces]
    whole = (faces != np.roll(faces, 1, axis=1)).all(axis=1)
    _, first = np.unique(np.sort(faces[whole], axis=1), axis=0, return_index=True)
    return Mesh(middles, faces[whole][np.sort(first)])
