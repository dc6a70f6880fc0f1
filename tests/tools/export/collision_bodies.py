"""Hands and objects as convex shapes: read from a run's scene, placed by kinematics of their own.

Nothing of qdgrasp is used: the bundle is msgpack, the hand in it a URDF with meshes, the object an OBJ whose
groups are its convex parts. As in Bullet each group of an OBJ, and each STL, stands for its convex hull.
Bullet grows hulls by a margin, so that two of them touch while they are 2 mm apart; `Bodies` can do so too.
"""

import io
import xml.etree.ElementTree as ET
from collections.abc import Iterable, Mapping
from functools import cached_property
from pathlib import Path
from typing import NamedTuple

import msgpack
import numpy as np
import trimesh
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation

MARGIN = 1e-3  # By which Bullet grows the hulls of meshes [m]; boxes, spheres and cylinders stay as they are
SECTIONS = 64  # Corners of a circle of a cylinder; its sides are off by 0.12 % of the radius


class Convex:
    """The convex hull of points (v, 3), grown by a radius [m]; a sphere is one point."""

    def __init__(self, vertices: np.ndarray, radius: float = 0.0) -> None:
        self.radius = radius
        self.vertices = vertices
        self.normals, self.offsets = np.zeros((0, 3)), np.zeros(0)
        self.triangles = np.zeros((0, 3, 3))
        if len(vertices) > 1:
            hull = ConvexHull(vertices)
            planes = np.unique(hull.equations.round(9), axis=0)
            self.normals, self.offsets = planes[:, :3], -planes[:, 3]
            self.vertices, self.triangles = vertices[hull.vertices], vertices[hull.simplices]

    def placed(self, pose: np.ndarray) -> "Convex":
        """The same at a pose (4, 4)."""
        other = Convex.__new__(Convex)
        turn, origin = pose[:3, :3], pose[:3, 3]
        other.radius = self.radius
        other.vertices = self.vertices @ turn.T + origin
        other.normals = self.normals @ turn.T
        other.offsets = self.offsets + other.normals @ origin
        other.triangles = self.triangles @ turn.T + origin
        return other

    @cached_property
    def box(self) -> tuple[np.ndarray, np.ndarray]:
        """Lowest and highest corner (3,)."""
        return self.vertices.min(axis=0) - self.radius, self.vertices.max(axis=0) + self.radius

    def distances(self, points: np.ndarray) -> np.ndarray:
        """Distance (n,) of points (n, 3) from the solid; 0 inside."""
        if not len(self.normals):
            return np.maximum(np.linalg.norm(points - self.vertices[0], axis=1) - self.radius, 0.0)
        found = np.zeros(len(points))
        for place in np.flatnonzero((points @ self.normals.T - self.offsets).max(axis=1) > 0):
            nearest = trimesh.triangles.closest_point(
                self.triangles, np.tile(points[place], (len(self.triangles), 1))
            )
            found[place] = np.linalg.norm(nearest - points[place], axis=1).min()
        return np.maximum(found - self.radius, 0.0)


def deepest_at_most(one: Convex, other: Convex) -> float:
    """An upper bound of the penetration depth of two shapes [m]; negative: they are apart.

    The depth is the least overlap over all directions; here over the normals of both shapes' faces.
    """
    overlaps = [
        (shape.offsets - (another.vertices @ shape.normals.T).min(axis=0))
        for shape, another in ((one, other), (other, one))
    ]
    return float(np.concatenate(overlaps).min()) + one.radius + other.radius


def depth(one: Convex, other: Convex) -> float:
    """The penetration depth of two shapes [m]; negative: their distance.

    That of the origin in the hull of all differences of their points (Cameron and Culley 1986, "Determining
    the minimum translational distance between two convex polyhedra").
    """
    differences = Convex((one.vertices[:, None] - other.vertices).reshape(-1, 3))
    inside = float(differences.offsets.min())
    if inside < 0:
        inside = -float(differences.distances(np.zeros((1, 3)))[0])
    return inside + one.radius + other.radius


class Contact(NamedTuple):
    """A contact as a file tells it: the hand's link, point and normal (3,), force."""

    link: str
    point: np.ndarray
    normal: np.ndarray
    force: float


class Bodies:
    """The hand and the object of a run, as its bundle has them; hulls of meshes grown by `margin` [m]."""

    def __init__(self, bundle: Path, margin: float = 0.0) -> None:
        values = msgpack.unpackb(bundle.read_bytes())
        gripper, body = values["gripper"], values["object"]
        self.root = gripper["base_link"]
        self._robot = ET.fromstring(gripper["urdf"])  # noqa: S314  # of a run that was made here
        self._shapes = {
            link.get("name"): shapes(link, gripper["meshes"], margin) for link in self._robot.iter("link")
        }
        origin = np.eye(4)
        origin[:3, 3] = body["com_in_mesh"]
        self.object = [Convex(part, margin).placed(origin) for part in obj_groups(body["collision"])]
        """Its parts in the frame of its mesh [m]."""

    def hand(self, pose: np.ndarray, joints: Mapping[str, float]) -> dict[str, list[Convex]]:
        """The shapes of each link from the root link on, which is at a pose (4, 4)."""
        placed, todo = {}, [(self.root, pose)]
        while todo:
            link, here = todo.pop()
            placed[link] = [shape.placed(here) for shape in self._shapes[link]]
            for joint in self._robot.iter("joint"):
                if joint.find("parent") is not None and joint.find("parent").get("link") == link:
                    at = here @ origin_of(joint) @ moved(joint, joints)
                    todo.append((joint.find("child").get("link"), at))
        return placed

    def depth(self, hand: Mapping[str, list[Convex]]) -> float:
        """The deepest penetration of hand and object [m], 0 or positive."""
        pairs = [(shape, part) for each in hand.values() for shape in each for part in self.object]
        close = [
            (deepest_at_most(shape, part), shape, part)
            for shape, part in pairs
            if (np.maximum(shape.box[0], part.box[0]) <= np.minimum(shape.box[1], part.box[1])).all()
        ]
        deepest = 0.0
        for most, shape, part in sorted(close, key=lambda pair: -pair[0]):
            if most <= deepest:
                break
            deepest = max(deepest, depth(shape, part))
        return deepest

    def apart(
        self, hand: Mapping[str, list[Convex]], contacts: Iterable[Contact]
    ) -> list[tuple[float, float]]:
        """Distances of each contact's point from the object, and from the link that it names [m]."""
        return [
            (nearest(self.object, contact.point), nearest(hand[contact.link], contact.point))
            for contact in contacts
        ]


def nearest(solids: list[Convex], point: np.ndarray) -> float:
    return min(float(solid.distances(point[None])[0]) for solid in solids)


def shapes(link: ET.Element, meshes: Mapping[str, bytes], margin: float) -> list[Convex]:
    """The collision shapes of a link in its frame."""
    return [
        shape.placed(origin_of(each))
        for each in link.iter("collision")
        for shape in solids(each, meshes, margin)
    ]


def solids(collision: ET.Element, meshes: Mapping[str, bytes], margin: float) -> list[Convex]:
    """The convex shapes of a collision element, without its origin."""
    (kind,) = collision.find("geometry")
    match kind.tag:
        case "box":
            return [Convex(trimesh.creation.box(floats(kind.get("size"))).vertices)]
        case "sphere":
            return [Convex(np.zeros((1, 3)), float(kind.get("radius")))]
        case "cylinder":
            radius, length = float(kind.get("radius")), float(kind.get("length"))
            return [Convex(trimesh.creation.cylinder(radius, length, sections=SECTIONS).vertices)]
        case _:
            name, scale = kind.get("filename"), floats(kind.get("scale", "1 1 1"))
            content = meshes[name]
            if name.lower().endswith(".obj"):
                return [Convex(part * scale, margin) for part in obj_groups(content)]
            mesh = trimesh.load_mesh(io.BytesIO(content), file_type=name.rpartition(".")[2].lower())
            return [Convex(np.asarray(mesh.vertices) * scale, margin)]


def obj_groups(content: bytes) -> list[np.ndarray]:
    """The points (v, 3) that the faces of each group or object of an OBJ use."""
    vertices: list[list[float]] = []
    groups: list[set[int]] = [set()]
    for line in content.decode().splitlines():
        match line.split():
            case ["v", *numbers]:
                vertices.append([float(number) for number in numbers[:3]])
            case ["o" | "g", *_]:
                groups.append(set())
            case ["f", *corners]:
                groups[-1].update(int(corner.split("/")[0]) - 1 for corner in corners)
    return [np.array(vertices)[sorted(group)] for group in groups if group]


def floats(words: str) -> np.ndarray:
    return np.array([float(word) for word in words.split()])


def homogeneous(turn: Rotation, position: np.ndarray) -> np.ndarray:
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = turn.as_matrix(), position
    return pose


def origin_of(element: ET.Element) -> np.ndarray:
    """The pose (4, 4) in an element `origin`; URDF has its angles about fixed axes."""
    origin = element.find("origin")
    if origin is None:
        return np.eye(4)
    turn = Rotation.from_euler("xyz", floats(origin.get("rpy", "0 0 0")))
    return homogeneous(turn, floats(origin.get("xyz", "0 0 0")))


def moved(joint: ET.Element, joints: Mapping[str, float]) -> np.ndarray:
    """How far a joint has moved, (4, 4); the file names all that move."""
    if joint.get("type") == "fixed":
        return np.eye(4)
    axis = floats(joint.find("axis").get("xyz")) if joint.find("axis") is not None else np.array([1.0, 0, 0])
    axis, value = axis / np.linalg.norm(axis), joints[joint.get("name")]
    if joint.get("type") == "prismatic":
        return homogeneous(Rotation.identity(), value * axis)
    return homogeneous(Rotation.from_rotvec(value * axis), np.zeros(3))
