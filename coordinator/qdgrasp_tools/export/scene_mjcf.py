"""MJCF of a scene for plain MuJoCo: true surfaces, servos as the drives of `physical`."""

import xml.etree.ElementTree as ET
from collections.abc import Iterable
from importlib import resources

import numpy as np
from numpy.typing import ArrayLike

from qdgrasp_assets.geometry.mesh import Mesh, parse_parts, parts_to_obj
from qdgrasp_assets.geometry.rotation import Floats
from qdgrasp_assets.geometry.voxels import convex_hulls
from qdgrasp_assets.grippers.collision_shapes import collision_elements, part_corners
from qdgrasp_assets.grippers.hand_model import couplings
from qdgrasp_assets.grippers.urdf import Urdf, UrdfJoint, scene_robot
from qdgrasp_assets.scene import Joint, Scene, Vector
from qdgrasp_protocol.drives import DAMPING_RATIO, JAW_PRELOAD, DriveGains

OPTIONS = {"timestep": "0.002", "integrator": "implicitfast", "cone": "elliptic", "impratio": "10"}
OF_HAND, OF_OBJECT = {"contype": "1", "conaffinity": "2"}, {"contype": "2", "conaffinity": "1"}
OF_NEIGHBOURS = {"contype": "3", "conaffinity": "3"}
BOUNDS = {"boundmass": "1e-3", "boundinertia": "1e-6"}  # Links without shapes [kg, kg m2]


def replay_files(scene: Scene, com: Vector) -> dict[str, bytes]:
    """Return the files that a replay takes, by path; the object's centre of mass is at `com`."""
    robot = scene_robot(scene.gripper).subtree(scene.gripper.base_link)
    parts, around = (
        [part.moved(com) for part in parse_parts(file.decode())]
        for file in (scene.object.collision, scene.neighbours)
    )
    script = resources.files("qdgrasp_worker.engines").joinpath("lift_replay.py")
    return {
        "scene.xml": scene_mjcf(scene, robot, parts, around, com),
        "replay.py": script.read_bytes(),
        "hand/hand.urdf": ET.tostring(robot.element),
        **{f"hand/{name}": content for name, content in scene.gripper.meshes.items()},
        "object/parts.obj": parts_to_obj(parts),
    }


def scene_mjcf(
    scene: Scene, robot: Urdf, parts: Iterable[Mesh], neighbours: Iterable[Mesh], com: Vector
) -> bytes:
    """Return MJCF of a hand without its carrier, and an object between fixed neighbours.

    The hand's root link is at the body `mount`, whose place a replay sets. The joint `lift` carries it
    upwards; it is so heavy that fingers and object hardly change the velocity that it is given.
    """
    hand, body = scene.gripper, scene.object
    root = ET.Element("mujoco", model=f"{hand.name} and {body.name}")
    ET.SubElement(root, "compiler", BOUNDS, angle="radian")
    ET.SubElement(ET.SubElement(root, "option", OPTIONS), "flag", multiccd="enable")
    assets, world, equality, actuators = (
        ET.SubElement(root, tag) for tag in ("asset", "worldbody", "equality", "actuator")
    )
    carrier = ET.SubElement(world, "body", name="carrier")
    ET.SubElement(carrier, "joint", name="lift", type="slide", axis="0 0 1", armature="1000")
    mount = ET.SubElement(carrier, "body", name="mount")
    places = {robot.root: ET.SubElement(mount, "body", name=robot.root)}
    for found in robot.joints_beyond(robot.root):
        frame = {"pos": _text(found.origin[:3, 3]), "xyaxes": _text(found.origin[:3, :2].T)}
        places[found.child] = ET.SubElement(places[found.parent], "body", frame, name=found.child)
    for joint, found, drive in _commanded(robot, scene):
        limit = joint.rated_effort or min(joint.effort or drive.effort, drive.effort)
        stiffness, force = limit / drive.lag, limit * (JAW_PRELOAD if hand.jaw else 1.0)
        kind = "slide" if found.kind == "prismatic" else "hinge"
        armature = _text(stiffness / drive.frequency**2)
        dynamics = {"type": kind, "axis": _text(found.axis), "armature": armature}
        if found.lower < found.upper:
            dynamics["range"] = _text([found.lower, found.upper])
        damping = 2 * DAMPING_RATIO * stiffness / drive.frequency
        gains = {"kp": _text(stiffness), "kv": _text(damping)}
        gains["forcerange"] = _text([-force, force])
        ET.SubElement(places[found.child], "joint", dynamics, name=joint.name)
        ET.SubElement(actuators, "position", gains, name=joint.name, joint=joint.name)
    for link, collision in collision_elements(robot):
        _add_hulls(places[link], assets, part_corners(robot, collision, hand.meshes), OF_HAND)
    if hand.jaw:
        for name, led in couplings(robot, hand).items():
            polynomial = _text([led.offset, led.multiplier, 0, 0, 0])
            ET.SubElement(equality, "joint", joint1=name, joint2=led.leader, polycoef=polynomial)
    thing = ET.SubElement(world, "body", name="object")
    ET.SubElement(thing, "freejoint")
    squares = np.subtract(scene.object_high, scene.object_low) ** 2
    moments = body.mass / 12 * (squares.sum() - squares)  # of its box
    ET.SubElement(thing, "inertial", pos=_text(com), mass=_text(body.mass), diaginertia=_text(moments))
    friction = {"friction": f"{body.lateral_friction:.9g} 0.005 0.0001", "condim": "6", "priority": "1"}
    _add_hulls(thing, assets, (part.vertices for part in parts), OF_OBJECT | friction)
    _add_hulls(world, assets, (part.vertices for part in neighbours), OF_NEIGHBOURS)
    ET.indent(root)
    return bytes(ET.tostring(root))


def closing_speeds(scene: Scene) -> list[float]:
    """Return the speeds with which the joints of a hand close [m/s or rad/s]."""
    found = _commanded(scene_robot(scene.gripper), scene)
    return [joint.rated_velocity or gains.speed for joint, _, gains in found]


def _commanded(robot: Urdf, scene: Scene) -> list[tuple[Joint, UrdfJoint, DriveGains]]:
    """Return the joints of a hand, each with that of the URDF and the gains of its drive."""
    known = {joint.name: joint for joint in robot.joints}
    pairs = [(joint, known[joint.name]) for joint in scene.gripper.joints]
    return [(one, two, DriveGains.of(two.kind)) for one, two in pairs]


def _add_hulls(body: ET.Element, assets: ET.Element, parts: Iterable[Floats], group: dict[str, str]) -> None:
    """Add the convex hulls of corners (v, 3) [m] to a body; flat ones are left out."""
    for corners in parts:
        if convex_hulls([corners]):
            name = f"hull_{len(assets)}"
            ET.SubElement(assets, "mesh", name=name, vertex=_text(corners), inertia="convex")
            ET.SubElement(body, "geom", group, type="mesh", mesh=name)


def _text(numbers: ArrayLike) -> str:
    return " ".join(f"{number:.9g}" for number in np.ravel(numbers))
