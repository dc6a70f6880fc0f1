"""Collision shapes of a robot, as triangles and as the simulator's convex parts.

The simulator wraps an STL in one hull, and each group of an OBJ in one of its own; the parts are never more
than it takes. Round shapes are given by corners on them, so that their hull lies within. Unknown shapes have
no corners.
"""

import io
import xml.etree.ElementTree as ET
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import product
from pathlib import PurePosixPath

import numpy as np

from qdgrasp_assets.geometry.mesh import Floats, Mesh, geodesic, join, parse_parts, stl_triangles
from qdgrasp_assets.grippers.urdf import Urdf, parse_origin, scene_robot
from qdgrasp_assets.scene import SceneGripper
from qdgrasp_protocol.errors import AssetError

FORMS = ("mesh", "box", "cylinder", "sphere")  # The geometries of URDF


@dataclass(frozen=True)
class CollisionShape(Mesh):
    """One collision shape of a link, link frame."""

    link: str


def collision_elements(robot: Urdf) -> Iterator[tuple[str, ET.Element]]:
    """Yield each collision shape with its link's name."""
    for link in robot.element.findall("link"):
        for collision in link.findall("collision"):
            yield link.get("name", ""), collision


def shapes(robot: Urdf, files: Mapping[str, bytes]) -> Iterator[CollisionShape]:
    """Yield links' collision shapes from `files` by name; `AssetError` if a mesh is empty."""
    for link, collision in collision_elements(robot):
        yield from collision_shape(robot, link, collision, files)


def collision_shape(
    robot: Urdf, link: str, collision: ET.Element, files: Mapping[str, bytes]
) -> Iterator[CollisionShape]:
    """Yield the one shape of a `<collision>`, none without a geometry; errors of `shapes`."""
    for element in collision.findall("geometry/*")[:1]:
        mesh = triangles(element, files)
        if not len(mesh.faces):
            raise AssetError(
                f"The URDF '{robot.path}' has an empty collision shape: the mesh of link '{link}' has no "
                "triangles; give it one with a surface, or leave the shape out."
            )
        frame = parse_origin(robot.path, collision.find("origin"))
        yield CollisionShape(mesh.vertices @ frame[:3, :3].T + frame[:3, 3], mesh.faces, link)


def largest_side(robot: Urdf, files: Mapping[str, bytes]) -> float:
    """Return the largest side of the box around all shapes, joints at zero, root frame [m]."""
    frames = robot.forward({})
    corners = [
        shape.vertices @ frames[shape.link][:3, :3].T + frames[shape.link][:3, 3]
        for shape in shapes(robot, files)
    ]
    return float(np.ptp(np.concatenate(corners), axis=0).max()) if corners else 0.0


def triangles(element: ET.Element, files: Mapping[str, bytes]) -> Mesh:
    """Return the triangles of a geometry of URDF, coincident vertices merged.

    Round shapes, Collada files and others are made by trimesh, which takes long to import.
    """
    name, scale = element.get("filename", ""), [1.0, 1.0, 1.0]
    kind = PurePosixPath(name).suffix.lower()
    if element.tag == "mesh":
        corners = stl_triangles(files[name]) if kind == ".stl" else None
        if kind == ".obj":
            parts = parse_parts(files[name].decode("utf-8", "replace"))
            corners = join(parts).corners if parts else np.zeros((0, 3, 3))
        scale = attribute_numbers(element, "scale", "1 1 1")
        if corners is not None:
            vertices, faces = np.unique(corners.reshape(-1, 3), axis=0, return_inverse=True)
            return Mesh(vertices * scale, faces.reshape(-1, 3).astype(np.int64))
    import trimesh

    match element.tag:
        case "mesh":
            mesh = trimesh.load_mesh(io.BytesIO(files[name]), file_type=kind.removeprefix("."))
        case "box":
            mesh = trimesh.creation.box(attribute_numbers(element, "size", "0 0 0"))
        case "cylinder":
            mesh = trimesh.creation.cylinder(float(element.get("radius", 0)), float(element.get("length", 0)))
        case "sphere":
            mesh = trimesh.creation.icosphere(subdivisions=3, radius=float(element.get("radius", 0)))
        case unknown:
            raise KeyError(unknown)
    mesh.merge_vertices(merge_tex=True, merge_norm=True)
    return Mesh(np.array(mesh.vertices) * scale, np.array(mesh.faces))


def attribute_numbers(element: ET.Element, name: str, default: str) -> list[float]:
    """Return the numbers of an attribute."""
    return [float(word) for word in element.get(name, default).split()]


CYLINDER_SIDES = 16
"""Sides of the prism within a cylinder; the simulator's has 32, with these among its edges."""
CONCAVE = "concave"  # Attribute of a collision shape that Bullet takes as bare triangles, without an inside


CONVEX_KINDS = ("box", "sphere", "cylinder", ".stl", ".obj")
"""Shapes that every engine takes, meshes by the suffix of their file; Bullet takes others too."""


def check_convex(gripper: SceneGripper) -> None:
    """Raise an AssetError for a shape that another engine than Bullet does not take."""
    for link, collision in collision_elements(scene_robot(gripper)):
        for shape in collision.iterfind("geometry/*"):
            kind = PurePosixPath(shape.get("filename", "")).suffix.lower() or shape.tag
            if kind not in CONVEX_KINDS or collision.get(CONCAVE) is not None:
                raise AssetError(
                    "Of the engines Bullet alone takes other shapes than boxes, spheres, cylinders and "
                    f"convex meshes (.obj, .stl), and link '{link}' of '{gripper.name}' has one; simulate "
                    "it in bullet."
                )


def part_corners(robot: Urdf, collision: ET.Element, files: Mapping[str, bytes]) -> Iterator[Floats]:
    """Yield the corners (v, 3) of each convex part of a collision shape [m], link frame."""
    for element in collision.findall("geometry/*")[:1] if collision.get(CONCAVE) is None else ():
        frame = parse_origin(robot.path, collision.find("origin"))
        for corners in geometry_corners(element, files) if element.tag in FORMS else ():
            yield corners @ frame[:3, :3].T + frame[:3, 3]


def geometry_corners(element: ET.Element, files: Mapping[str, bytes]) -> Iterator[Floats]:
    """Yield the corners (v, 3) [m] of each part of a geometry of URDF, in its own frame."""
    name = element.get("filename", "")
    kind = PurePosixPath(name).suffix.lower()
    if element.tag == "box":
        yield np.array(list(product((-0.5, 0.5), repeat=3))) * attribute_numbers(element, "size", "0 0 0")
    elif element.tag == "cylinder":
        radius = float(element.get("radius", 0))
        angles = np.arange(CYLINDER_SIDES) * (2 * np.pi / CYLINDER_SIDES)
        height = np.full(CYLINDER_SIDES, float(element.get("length", 0)) / 2)
        ring = np.stack([radius * np.cos(angles), radius * np.sin(angles), height], axis=1)
        yield np.concatenate([ring, ring * (1.0, 1.0, -1.0)])
    elif element.tag == "sphere":
        yield geodesic(float(element.get("radius", 0)), 3).vertices
    elif kind == ".obj":
        for part in parse_parts(files[name].decode("utf-8", "replace")):
            yield part.vertices * attribute_numbers(element, "scale", "1 1 1")
    elif kind == ".stl" and (read := stl_triangles(files[name])) is not None:
        yield np.unique(read.reshape(-1, 3), axis=0) * attribute_numbers(element, "scale", "1 1 1")
