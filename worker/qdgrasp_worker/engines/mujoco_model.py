"""MuJoCo's model of a scene as MJCF: the hand at the world's origin, and the object.

A URDF is read as in Bullet: contacts of hulls and cylinders begin `HULL_MARGIN` outside of their surface, and
the inertia of a link is that of a box around its shapes (`box_moments`).

In `physical` joints that the scene does not command are rigid, and drives are actuators. Where the hand is
shaken each joint has dry friction as great as the force of its motor: in each step `mujoco_world` sets the
velocity at which that friction ends, so that it acts as a motor in Bullet.
"""

import math
import xml.etree.ElementTree as ET
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import PurePosixPath

import numpy as np

from qdgrasp_assets.geometry.mesh import parse_parts
from qdgrasp_assets.geometry.rotation import Floats
from qdgrasp_assets.geometry.voxels import convex_hulls
from qdgrasp_assets.grippers.collision_shapes import attribute_numbers, check_convex, geometry_corners
from qdgrasp_assets.grippers.hand_model import couplings
from qdgrasp_assets.grippers.urdf import Urdf, UrdfJoint, parse_origin, scene_robot
from qdgrasp_assets.scene import Joint, Scene, SceneGripper
from qdgrasp_protocol.errors import AssetError
from qdgrasp_worker.contact_margin import HULL_MARGIN
from qdgrasp_worker.physical_episode import TABLE_HALF, FingerDrive

DETECTION_GAP = 5e-4  # Extra distance at which contacts are found; two shapes add theirs [m]
LEAST_MASS, LEAST_MOMENT = 1e-6, 1e-9  # For a link that has none in Bullet [kg, kg m2]
OBJECT, NEIGHBOURS, TABLE = "*object", "*neighbours", "*table"  # Names of bodies beside the hand's links
TABLE_AWAY = "0 0 -20"  # Its place until it is set: away from all bodies
TWELFTH = 0.08333333  # 1/12 as written in Bullet
INFLATIONS = {"box": (0, 0), "sphere": (0, 0), "cylinder": (1, 1), ".stl": (1, 1), ".obj": (3, 0)}
"""Margins that Bullet adds to each side of a shape's box before it is turned, and after."""
OPTIONS = {
    "gravity": "0 0 0",
    "integrator": "implicitfast",
    "cone": "elliptic",
    "solver": "Newton",
    "jacobian": "dense",
    "tolerance": "1e-8",
    "impratio": "10",
}
FLAGS = {"multiccd": "enable", "island": "disable"}
CONTACT = {"solref": f"{1 / 120!r} 1", "solimp": "0.95 0.99 0.001", "gap": repr(DETECTION_GAP)}
"""Contacts give way within a few steps of 1/480 s."""
LIMIT = {"solreflimit": "0.01 1", "solimplimit": "0.95 0.99 0.001"}
BELT = {"solref": f"{1 / 120!r} 1", "solimp": "0.99 0.999 0.001"}
MOTOR = {"frictionloss": "1", "solimpfriction": "0.9999 0.9999 0.001"}
"""Bullet's motor of a joint that is not commanded has a force of 1 N or Nm."""
HAND_GROUP, OBJECT_GROUP = "1", "2"  # The object meets the hand alone
PAIR_FRICTION = (
    "0.25 0 0"  # Sliding friction of two links of the hand; with the object, the object's own holds
)


@dataclass(frozen=True)
class LinkShape:
    """A collision shape of a link: a primitive, or the hulls of a mesh."""

    kind: str
    """A primitive of URDF, or the suffix of a mesh's file."""
    frame: Floats
    """(4, 4), link frame."""
    low: Floats
    """(3,): low corner of the box around it [m], own frame."""
    high: Floats
    hulls: tuple[Floats, ...] = ()
    """Corners (v, 3) [m] of each hull of a mesh, own frame."""


@dataclass(frozen=True)
class HandLink:
    """A link of the hand with its collision shapes."""

    name: str
    mass: float
    """Mass [kg]."""
    inertial: Floats
    """(4, 4): the frame of its principal axes of inertia, link frame."""
    shapes: tuple[LinkShape, ...]

    @property
    def box(self) -> Floats:
        """The box (2, 3) that Bullet puts around its shapes [m], inertial frame."""
        back = np.linalg.inv(self.inertial)
        boxes = [
            inflated_box(
                shape.low, shape.high, back @ shape.frame, *(HULL_MARGIN * n for n in INFLATIONS[shape.kind])
            )
            for shape in self.shapes
        ]
        return np.stack([np.min(boxes, axis=0)[0], np.max(boxes, axis=0)[1]])

    @property
    def moments(self) -> Floats:
        """Its principal moments of inertia (3,) as in Bullet [kg m2]: those of its box."""
        if not self.shapes:
            return np.zeros(3)
        first, around = self.shapes[0], 1
        if len(self.shapes) == 1 and np.array_equal(first.frame, self.inertial):  # Bullet uses no compound
            if first.kind == "sphere":
                return np.full(3, 0.4 * self.mass * first.high[0] ** 2)
            around = INFLATIONS[first.kind][1]
        low, high = self.box
        return box_moments(self.mass, high - low + 2 * around * HULL_MARGIN)


def inflated_box(low: Floats, high: Floats, frame: Floats, before: float, after: float) -> Floats:
    """The box (2, 3) around a box that is put at `frame`, made larger before and after that [m]."""
    centre, half = (low + high) / 2, (high - low) / 2 + before
    middle, side = frame[:3, :3] @ centre + frame[:3, 3], np.abs(frame[:3, :3]) @ half + after
    return np.stack([middle - side, middle + side])


def box_moments(mass: float, sides: Floats) -> Floats:
    """The principal moments (3,) [kg m2] of a box with these sides (3,) [m]."""
    squares = sides**2
    return np.asarray(TWELFTH * mass * (squares.sum() - squares))


def hand_links(robot: Urdf, gripper: SceneGripper) -> dict[str, HandLink]:
    """The links of a hand by name; an AssetError for a shape that MuJoCo cannot take."""
    masses = robot.masses
    return {
        name: HandLink(
            name,
            masses[name][0],
            parse_origin(robot.path, element.find("inertial/origin")),
            tuple(link_shapes(robot, element, gripper)),
        )
        for element in robot.element.findall("link")
        for name in [element.get("name", "")]
    }


def link_shapes(robot: Urdf, link: ET.Element, gripper: SceneGripper) -> Iterator[LinkShape]:
    """Yield the collision shapes of a link."""
    for collision in link.findall("collision"):
        geometry = collision.find("geometry")
        if geometry is None or not len(geometry):
            continue
        element, frame = geometry[0], parse_origin(robot.path, collision.find("origin"))
        kind = PurePosixPath(element.get("filename", "")).suffix.lower() or element.tag
        if element.tag == "mesh":
            if not (hulls := list(geometry_corners(element, gripper.meshes))):
                name = element.get("filename")
                raise AssetError(f"The mesh '{name}' of '{gripper.name}' has no triangles, or is a text STL.")
            yield mesh_shape(kind, frame, hulls)
        else:
            half = primitive_half(element)
            yield LinkShape(kind, frame, -half, half)


def mesh_shape(kind: str, frame: Floats, hulls: Sequence[Floats]) -> LinkShape:
    """The shape of hulls (v, 3) [m] each; flat ones count for its box only."""
    corners = np.concatenate(hulls)
    solid = tuple(each for each in hulls if convex_hulls([each]))
    return LinkShape(kind, frame, corners.min(axis=0), corners.max(axis=0), solid)


def primitive_half(element: ET.Element) -> Floats:
    """Half sides (3,) [m] of the box around a primitive."""
    if element.tag == "box":
        return np.array(attribute_numbers(element, "size", "0 0 0")) / 2
    radius = float(element.get("radius", 0))
    return np.array(
        [radius, radius, radius if element.tag == "sphere" else float(element.get("length", 0)) / 2]
    )


def reach_of(robot: Urdf, links: dict[str, HandLink], opened: dict[str, float], joint: UrdfJoint) -> float:
    """Distance from a joint to the farthest box corner of the links it moves, hand open [m]."""
    frames, moved = robot.forward(opened), robot.subtree(joint.child).links
    boxes = [
        inflated_box(low, high, frames[link.name] @ link.inertial, 0.0, HULL_MARGIN)
        for link in map(links.__getitem__, moved)
        if link.shapes
        for low, high in [link.box]
    ]
    place = frames[joint.child][:3, 3]
    farthest = [np.maximum(np.abs(low - place), np.abs(high - place)) for low, high in boxes]
    return max((math.hypot(*corner) for corner in farthest), default=0.0)


class SceneModel:
    """MJCF of a scene, with the object free or fixed where it is put.

    An AssetError for a collision shape that MuJoCo cannot take, or a joint that the URDF does not have.
    """

    def __init__(self, scene: Scene, time_step: float, *, has_table: bool = False) -> None:
        gripper = scene.gripper
        check_convex(gripper)
        self._has_table = has_table
        self._time_step = time_step
        self.robot = scene_robot(gripper)
        self.links = hand_links(self.robot, gripper)
        self.joints = [self._joint(joint) for joint in gripper.joints]
        """The joints of the hand that are commanded, in the gripper's order."""
        self.couplings = couplings(self.robot, gripper)
        target = scene.object
        hulls = [part.vertices for part in parse_parts(target.collision.decode())]
        shape = mesh_shape(".obj", np.eye(4), hulls)
        sides = shape.high - shape.low + 2 * (sum(INFLATIONS[".obj"]) + 1) * HULL_MARGIN
        self.moments = box_moments(target.mass, sides)
        """The object's principal moments of inertia (3,) [kg m2]."""
        self._mass, self._shape = target.mass, shape
        around = [part.vertices for part in parse_parts(scene.neighbours.decode())]
        self._neighbours = mesh_shape(".obj", np.eye(4), around) if around else None

    def _joint(self, joint: Joint) -> UrdfJoint:
        found = self.robot.joint(joint.name)
        if found is None or not found.moves:
            raise AssetError(f"The hand has no joint '{joint.name}' that moves.")
        return found

    def driven(
        self, drives: Sequence[FingerDrive], passing: Iterable[tuple[str, str]], *, is_free: bool
    ) -> str:
        """The MJCF of the scene in `physical`; links of the pairs `passing` pass through each other."""
        root = self._scene(
            {drive.name: {"armature": repr(drive.inertia)} for drive in drives},
            is_free=is_free,
            meets_itself=True,
        )
        contact = ET.SubElement(root, "contact")
        for one, other in sorted(passing):
            ET.SubElement(contact, "exclude", body1=one, body2=other)
        actuator = ET.SubElement(root, "actuator")
        for drive in drives:
            ET.SubElement(actuator, "general", drive_attributes(drive))
        return ET.tostring(root, encoding="unicode")

    def shaken(self) -> str:
        """The MJCF of the scene where the hand is shaken; its links pass through each other."""
        joints = {joint.name: MOTOR for joint in self.robot.joints if joint.moves}
        return ET.tostring(self._scene(joints, is_free=True, meets_itself=False), encoding="unicode")

    def _scene(
        self, joints: Mapping[str, Mapping[str, str]], *, is_free: bool, meets_itself: bool
    ) -> ET.Element:
        """MJCF of all bodies; the attributes of the joints that move are in `joints`."""
        root = ET.Element("mujoco")
        ET.SubElement(root, "compiler", angle="radian", autolimits="false", boundmass=repr(LEAST_MASS))
        ET.SubElement(ET.SubElement(root, "option", OPTIONS, timestep=repr(self._time_step)), "flag", FLAGS)
        ET.SubElement(ET.SubElement(root, "default"), "geom", CONTACT)
        meshes, world = ET.SubElement(root, "asset"), ET.SubElement(root, "worldbody")
        group = {"contype": HAND_GROUP, "conaffinity": "3" if meets_itself else OBJECT_GROUP}
        self._add_link(world, meshes, self.robot.root, joints, group | {"friction": PAIR_FRICTION})
        self._add_object(world, meshes, is_free=is_free)
        meeting = {"contype": "0", "conaffinity": "3", "friction": PAIR_FRICTION}
        if self._neighbours:
            around = ET.SubElement(world, "body", name=NEIGHBOURS, mocap="true", pos=TABLE_AWAY)
            add_shape(around, meshes, self._neighbours, meeting)
        if self._has_table:
            table = ET.SubElement(world, "body", name=TABLE, mocap="true", pos=TABLE_AWAY)
            ET.SubElement(table, "geom", meeting, type="box", size=words(TABLE_HALF))
        equality = ET.SubElement(root, "equality")
        for name, led in self.couplings.items():
            polynomial = words([led.offset, led.multiplier, 0.0, 0.0, 0.0])
            ET.SubElement(equality, "joint", BELT, joint1=name, joint2=led.leader, polycoef=polynomial)
        return root

    def _add_link(
        self,
        parent: ET.Element,
        meshes: ET.Element,
        name: str,
        joints: Mapping[str, Mapping[str, str]],
        group: Mapping[str, str],
    ) -> None:
        link = self.links[name]
        joint = next((joint for joint in self.robot.joints if joint.child == name), None)
        body = ET.SubElement(parent, "body", placed(joint.origin if joint else np.eye(4)), name=name)
        moments = np.maximum(link.moments, LEAST_MOMENT)
        inertial = {"mass": repr(max(link.mass, LEAST_MASS)), "diaginertia": words(moments)}
        ET.SubElement(body, "inertial", placed(link.inertial), **inertial)
        if joint and joint.name in joints:
            limited = joint.lower < joint.upper
            ET.SubElement(
                body,
                "joint",
                LIMIT,
                name=joint.name,
                type="slide" if joint.kind == "prismatic" else "hinge",
                axis=words(joint.axis),
                limited=str(limited).lower(),
                range=words([joint.lower, joint.upper]) if limited else "0 0",
                **joints[joint.name],
            )
        for shape in link.shapes:
            add_shape(body, meshes, shape, group)
        for below in self.robot.joints:
            if below.parent == name:
                self._add_link(body, meshes, below.child, joints, group)

    def _add_object(self, world: ET.Element, meshes: ET.Element, *, is_free: bool) -> None:
        body = ET.SubElement(world, "body", name=OBJECT, mocap=str(not is_free).lower())
        inertial = {"mass": repr(self._mass), "diaginertia": words(self.moments)}
        ET.SubElement(body, "inertial", placed(np.eye(4)), **inertial)
        if is_free:
            ET.SubElement(body, "freejoint")
        group = {"contype": OBJECT_GROUP, "conaffinity": HAND_GROUP, "condim": "6", "priority": "1"}
        add_shape(body, meshes, self._shape, group)


def drive_attributes(drive: FingerDrive) -> dict[str, str]:
    """The actuator of a drive: a PD law about a target that moves with the commanded speed."""
    return {
        "name": drive.name,
        "joint": drive.name,
        "dyntype": "integrator",
        "actearly": "true",
        "biastype": "affine",
        "gainprm": repr(drive.stiffness),
        "biasprm": words([0.0, -drive.stiffness, -drive.damping]),
        "forcelimited": "true",
        "forcerange": words([-drive.limit, drive.limit]),
    }


def add_shape(body: ET.Element, meshes: ET.Element, shape: LinkShape, group: Mapping[str, str]) -> None:
    """Add the geoms of a shape to a body, and its meshes to the assets."""
    for corners in shape.hulls:
        name = f"hull_{len(meshes)}"
        ET.SubElement(meshes, "mesh", name=name, vertex=words(corners.ravel()), inertia="convex")
        margin = {"margin": repr(HULL_MARGIN)}
        ET.SubElement(body, "geom", placed(shape.frame) | {**group}, type="mesh", mesh=name, **margin)
    if shape.kind in ("box", "sphere", "cylinder"):
        sizes = {"box": shape.high, "sphere": shape.high[:1], "cylinder": shape.high[[0, 2]]}
        margin = {"margin": repr(HULL_MARGIN)} if shape.kind == "cylinder" else {}
        size = words(sizes[shape.kind])
        ET.SubElement(body, "geom", placed(shape.frame) | {**group}, type=shape.kind, size=size, **margin)


def placed(frame: Floats) -> dict[str, str]:
    """The attributes of a place in the parent's frame."""
    return {"pos": words(frame[:3, 3]), "xyaxes": words(frame[:3, :2].T.ravel())}


def words(numbers: Iterable[float]) -> str:
    """Numbers in the form of MJCF, each to the last bit."""
    return " ".join(repr(float(number)) for number in numbers)
