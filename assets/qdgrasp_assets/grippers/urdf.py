"""URDF reader: links, joints, origins, forward kinematics, sub-trees and mesh references.

Files of other formats that people take for a URDF are refused with advice.
"""

import codecs
import copy
import importlib.util
import os
import re
import xml.etree.ElementTree as ET
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np

from qdgrasp_assets.asset_paths import path_problem
from qdgrasp_assets.geometry.mesh import Floats
from qdgrasp_assets.geometry.rotation import running_sum
from qdgrasp_assets.scene import SceneGripper
from qdgrasp_protocol.errors import AssetError
from qdgrasp_protocol.text import first_few, quoted

ROUNDING = 1e-6  # Resolution to which limits are written [rad or m]
MOVING = frozenset({"revolute", "continuous", "prismatic"})


@dataclass(frozen=True)
class UrdfJoint:
    """A joint between two links."""

    name: str
    kind: str
    parent: str
    child: str
    origin: Floats
    """(4, 4): the joint's frame in the parent's."""
    axis: Floats
    """(3,), unit, joint frame."""
    lower: float
    upper: float
    """Upper limit [rad or m]; no limits where `lower` is equal or greater."""
    effort: float
    velocity: float

    @property
    def moves(self) -> bool:
        """True if it has a degree of freedom."""
        return self.kind in MOVING

    def allows(self, position: float) -> bool:
        """Return whether a position [rad or m] is within its limits, if it has any, to rounding."""
        is_limited = self.lower < self.upper and self.kind != "continuous"
        return not is_limited or self.lower - ROUNDING <= position <= self.upper + ROUNDING

    def motion(self, position: float | Floats) -> Floats:
        """Return the child's frame (..., 4, 4) in the joint's at positions (...) [rad or m]."""
        places = np.asarray(position, dtype=np.float64)[..., None]
        if self.kind == "prismatic":
            return _transform(np.eye(3), self.axis * places)
        if self.moves:
            return _transform(_rotation(self.axis, places[..., None]), np.zeros(3))
        return np.eye(4)


@dataclass(frozen=True)
class Urdf:
    """A robot as described in its file."""

    path: Path
    element: ET.Element
    links: tuple[str, ...]
    joints: tuple[UrdfJoint, ...]
    meshes: Mapping[str, bytes] = field(default_factory=dict)
    """Contents of meshes that are no files, by their names in the element."""

    @property
    def root(self) -> str:
        """The link that is not a child of any joint."""
        children = {joint.child for joint in self.joints}
        return next(link for link in self.links if link not in children)

    @property
    def mass(self) -> float:
        """Mass of all links together [kg]."""
        return running_sum(mass for mass, _ in self.masses.values())

    @property
    def masses(self) -> dict[str, tuple[float, Floats]]:
        """Mass [kg] and its position (3,) [m], link frame, of each link.

        A link without a mass in the file has 1 kg at its origin, as in Bullet.
        """
        return {link.get("name", ""): self._mass(link) for link in self.element.findall("link")}

    def _mass(self, link: ET.Element) -> tuple[float, Floats]:
        mass = link.find("inertial/mass")
        place = parse_origin(self.path, link.find("inertial/origin"))[:3, 3]
        return (1.0, np.zeros(3)) if mass is None else (_numbers(self.path, mass, "value", 1)[0], place)

    def joint(self, name: str) -> UrdfJoint | None:
        """Return the joint of this name, or None."""
        return next((joint for joint in self.joints if joint.name == name), None)

    def forward(
        self, positions: Mapping[str, float] | Mapping[str, Floats], base: Floats | None = None
    ) -> dict[str, Floats]:
        """Return every link's frame (..., 4, 4) in the world.

        The root is at `base`, (4, 4) or (..., 4, 4). Positions are numbers or arrays (...); joints not named
        stand at zero.
        """
        frames = {self.root: np.eye(4) if base is None else base}
        for joint in self.joints_beyond(self.root):
            motion = joint.motion(positions.get(joint.name, 0.0))
            frames[joint.child] = frames[joint.parent] @ joint.origin @ motion
        return frames

    def joints_beyond(self, base: str) -> Iterator[UrdfJoint]:
        """Yield the joints beyond link `base`, each after the one that carries it."""
        reached = [base]
        for link in reached:
            for joint in self.joints:
                if joint.parent == link:
                    reached.append(joint.child)
                    yield joint

    def subtree(self, base: str) -> "Urdf":
        """Return the robot from link `base` outward, alone."""
        joints = {joint.name for joint in self.joints_beyond(base)}
        links = {base, *(joint.child for joint in self.joints_beyond(base))}
        element = copy.deepcopy(self.element)
        for kind, kept in (("link", links), ("joint", joints)):
            for child in element.findall(kind):
                if child.get("name") not in kept:
                    element.remove(child)
        return replace(
            self,
            element=element,
            links=tuple(link for link in self.links if link in links),
            joints=tuple(joint for joint in self.joints if joint.name in joints),
        )

    def bundled(self) -> tuple[ET.Element, dict[str, bytes]]:
        """Return the robot for physics, and the mesh files that it needs by flat name.

        Visual shapes are left out and mesh references rewritten to the flat names; all else is unchanged.
        Errors of `mesh`.
        """
        element, flat = copy.deepcopy(self.element), dict[str, str]()
        drop_visuals(element)
        for mesh in element.iter("mesh"):
            name = mesh.get("filename", "")
            mesh.set("filename", flat.setdefault(name, f"{len(flat)}_{PurePosixPath(name).name}"))
        return element, {new: self.mesh(name) for name, new in flat.items()}

    def mesh(self, name: str) -> bytes:
        """Return a mesh that it names, OBJ without materials; `AssetError` if it cannot be read."""
        if name in self.meshes:
            return self.meshes[name]
        found = next((place for place in _mesh_places(self.path, name) if place.is_file()), None)
        if found is None:
            raise AssetError(f"The URDF '{self.path}' refers to the mesh '{name}', which does not exist.")
        try:
            lines = found.read_bytes().splitlines(keepends=True)
        except OSError as error:
            raise AssetError(
                f"The mesh '{name}' of '{self.path}' cannot be read: {error.strerror}."
            ) from None
        is_text = found.suffix.lower() == ".obj"
        looks = (b"mtllib", b"usemtl", b"#") if is_text else ()
        return b"".join(line for line in lines if not line.startswith(looks))

    def inward(self, link: str) -> Iterator[UrdfJoint]:
        """Yield the joints between a link and the root, from the link inward."""
        arriving = {joint.child: joint for joint in self.joints}
        while link in arriving:
            yield arriving[link]
            link = arriving[link].parent


def read_urdf(path: Path) -> Urdf:
    """Read a robot from a URDF file; errors of `read_robot_element` and `parse_robot`."""
    return parse_robot(path, read_robot_element(path))


def parse_robot(path: Path, element: ET.Element, meshes: Mapping[str, bytes] | None = None) -> Urdf:
    """Return the robot of a `<robot>` element, one tree; its mesh references start at `path`.

    `meshes` are the contents of those that are no files. Raises `AssetError` with all `structure_faults`.
    """
    if faults := structure_faults(element):
        raise AssetError(f"The URDF '{path}' is not one tree of links: {'; and '.join(faults)}.")
    links = tuple(link.get("name", "") for link in element.findall("link"))
    joints = tuple(_joint(path, joint) for joint in element.findall("joint"))
    return Urdf(path, element, links, joints, meshes or {})


MEASURES = frozenset(
    ("xyz", "rpy", "size", "scale", "radius", "length", "lower", "upper", "effort", "velocity", "value")
)
NON_FINITE = frozenset(("nan", "inf", "infinity"))
MOST_NAMED = 4  # Most names listed for each fault


def structure_faults(element: ET.Element) -> tuple[str, ...]:
    """Return the faults that keep links and joints of a `<robot>` from being one tree."""
    checks = _name_faults, _missing_links, _tree_faults, _number_faults
    return tuple(fault for check in checks for fault in check(element))


def _name_faults(element: ET.Element) -> Iterator[str]:
    for kind in ("link", "joint"):
        names = Counter(each.get("name", "") for each in element.findall(kind))
        if names.pop("", 0):
            yield f"a {kind} has no name; give each its own"
        if twice := [name for name, times in names.items() if times > 1]:
            yield f"{listed(kind, twice)} named more than once; give each its own name"
    if element.find("link") is None:
        yield "it has no links"


def _missing_links(element: ET.Element) -> Iterator[str]:
    links = {link.get("name", "") for link in element.findall("link")}
    for joint in element.findall("joint"):
        for tag in ("parent", "child"):
            if (name := joint_end(joint, tag)) not in links:
                fault = (
                    f"names the {tag} link '{name}', which does not exist" if name else f"has no {tag} link"
                )
                yield f"the joint '{joint.get('name', '')}' {fault}; correct the name or add the link"


def _tree_faults(element: ET.Element) -> Iterator[str]:
    links = [link.get("name", "") for link in element.findall("link")]
    hanging = Counter(child for _, child in edges(element))
    if twice := [name for name, times in hanging.items() if times > 1]:
        yield (
            f"{listed('link', twice)} the child of two joints: it closes a loop, which neither URDF nor the "
            "simulator knows; cut the loop by leaving one of the joints out, and drive the rest alike"
        )
    roots = [name for name in links if name not in hanging]
    if len(roots) > 1:
        yield (
            f"it has {len(roots)} roots ({first_few(quoted(roots), MOST_NAMED)}), and a URDF has one: join "
            "them by fixed joints, or leave out what is no part of the robot"
        )
    outward, reached = list(edges(element)), set(roots)
    while found := {child for parent, child in outward if parent in reached} - reached:
        reached |= found
    if round_about := sorted(set(links) - reached):
        yield f"{listed('link', round_about)} carried by itself in a circle of joints; cut the circle"


def _number_faults(element: ET.Element) -> Iterator[str]:
    """Yield faults of values such as nan and inf, which `float` accepts."""
    for each in element.iter():
        for name, value in each.attrib.items():
            if name in MEASURES and any(word.lower().lstrip("+-") in NON_FINITE for word in value.split()):
                yield f'<{each.tag} {name}="{value}"> holds a number that is not finite; correct it'


def edges(element: ET.Element) -> Iterator[tuple[str, str]]:
    """Yield the parent and child link of each joint; empty where a joint does not name one."""
    for joint in element.findall("joint"):
        yield joint_end(joint, "parent"), joint_end(joint, "child")


def listed(kind: str, names: list[str]) -> str:
    """Names with their kind and its verb: "the link 'a' is", "the links 'a', 'b' are"."""
    many = len(names) > 1
    return f"the {kind}{'s' if many else ''} {first_few(quoted(names), MOST_NAMED)} {'are' if many else 'is'}"


def scene_robot(gripper: SceneGripper) -> Urdf:
    """Return the robot of a scene's hand, without its meshes."""
    return parse_robot(Path(gripper.name), ET.fromstring(gripper.urdf))  # noqa: S314  # checked with the scene


def _joint(path: Path, element: ET.Element) -> UrdfJoint:
    limit = element.find("limit")
    limits = {
        name: 0.0 if limit is None or name not in limit.attrib else _numbers(path, limit, name, 1)[0]
        for name in ("lower", "upper", "effort", "velocity")
    }
    return UrdfJoint(
        name=element.get("name", ""),
        kind=element.get("type", ""),
        parent=joint_end(element, "parent"),
        child=joint_end(element, "child"),
        origin=parse_origin(path, element.find("origin")),
        axis=_axis(path, element.find("axis")),
        **limits,
    )


def joint_end(joint: ET.Element, tag: str) -> str:
    """Return the link that a `<joint>` names as its "parent" or "child"; empty if it names none."""
    end = joint.find(tag)
    return "" if end is None else end.get("link", "")


def _numbers(path: Path, element: ET.Element, name: str, count: int) -> list[float]:
    text = element.get(name, "")
    if len(values := numbers_in(text)) != count:
        raise AssetError(f"The URDF '{path}': <{element.tag} {name}=\"{text}\"> must hold {count} numbers.")
    return values


def numbers_in(text: str) -> list[float]:
    """Return the numbers of an attribute; empty where it holds something else."""
    try:
        return [float(word) for word in text.split()]
    except ValueError:
        return []


def parse_origin(path: Path, element: ET.Element | None) -> Floats:
    """Return the frame (4, 4) of an `<origin>`; `AssetError` without three numbers each."""
    if element is None:
        return np.eye(4)
    place = np.array(_numbers(path, element, "xyz", 3)) if element.get("xyz") else np.zeros(3)
    roll, pitch, yaw = _numbers(path, element, "rpy", 3) if element.get("rpy") else (0.0, 0.0, 0.0)
    x, y, z = np.eye(3)
    return _transform(_rotation(z, yaw) @ _rotation(y, pitch) @ _rotation(x, roll), place)


def _axis(path: Path, element: ET.Element | None) -> Floats:
    axis = np.array([1.0, 0.0, 0.0] if element is None else _numbers(path, element, "xyz", 3))
    length = float(np.linalg.norm(axis))
    return axis / length if length else axis


def _rotation(axis: Floats, angle: float | Floats) -> Floats:
    """Return rotations (..., 3, 3) by `angle` [rad] about a unit axis (Rodrigues' formula)."""
    x, y, z = axis
    skew = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.asarray(np.eye(3) + np.sin(angle) * skew + (1.0 - np.cos(angle)) * (skew @ skew))


def _transform(rotation: Floats, translation: Floats) -> Floats:
    batch = np.broadcast_shapes(rotation.shape[:-2], translation.shape[:-1])
    transform = np.tile(np.eye(4), (*batch, 1, 1))
    transform[..., :3, :3], transform[..., :3, 3] = rotation, translation
    return transform


def _mesh_places(urdf: Path, name: str) -> Iterator[Path]:
    """Yield the paths at which a referenced mesh may lie.

    Beside the URDF; for `package://P/...` in a folder P above it, beside one, or of `ROS_PACKAGE_PATH`, else
    in the Python package P.
    """
    if not name.startswith("package://"):
        yield urdf.parent / name.removeprefix("file://")
        return
    package, _, rest = name.removeprefix("package://").partition("/")
    named = map(Path, filter(None, os.environ.get("ROS_PACKAGE_PATH", "").split(os.pathsep)))
    for folder in (*urdf.resolve().parents, *named):
        yield folder / package / rest
        if folder.name == package:
            yield folder / rest
    spec = importlib.util.find_spec(package) if package.isidentifier() else None
    for place in (spec and spec.submodule_search_locations) or ():
        yield Path(place) / rest


def add_inertial(
    link: ET.Element, mass: str, moments: Iterable[str], xyz: str = "0 0 0", rpy: str = "0 0 0"
) -> None:
    """Add the `<inertial>` of a mass [kg] and principal moments (3,) [kg m2] to a `<link>`."""
    inertial, (ixx, iyy, izz) = ET.SubElement(link, "inertial"), moments
    ET.SubElement(inertial, "origin", xyz=xyz, rpy=rpy)
    ET.SubElement(inertial, "mass", value=mass)
    ET.SubElement(inertial, "inertia", ixx=ixx, ixy="0", ixz="0", iyy=iyy, iyz="0", izz=izz)


def add_joint(
    robot: ET.Element, name: str, kind: str, ends: tuple[str, str], xyz: str = "0 0 0", rpy: str = "0 0 0"
) -> ET.Element:
    """Add a joint between two links, parent and child, to a `<robot>`; return it."""
    joint = ET.SubElement(robot, "joint", name=name, type=kind)
    ET.SubElement(joint, "parent", link=ends[0])
    ET.SubElement(joint, "child", link=ends[1])
    ET.SubElement(joint, "origin", xyz=xyz, rpy=rpy)
    return joint


def add_file(files: dict[str, bytes], stem: str, suffix: str, content: bytes) -> str:
    """Add a file, with a number where its path has another content; return its path."""
    path, number = f"{stem}{suffix}", 1
    while files.get(path, content) != content:
        path, number = f"{stem}_{number}{suffix}", number + 1
    files[path] = content
    return path


MOST_LINKS = 1000  # Links of a robot
XACRO_TAG = re.compile(r"\{http[^}]*xacro\}|xacro:")  # Tags that only a xacro file has
XACRO_SUBSTITUTION = re.compile(r"\$[({]")  # Beginning of an expression that xacro replaces, in attributes
PREFIX = re.compile(r"<(?!xacro:)([\w.-]+):")  # Of a tag, such as Drake's, which many files do not declare
XML_ENCODING = re.compile(rb"""(?:\xef\xbb\xbf)?<\?xml[^>]*?\sencoding=["']([\w.:-]+)""")
OTHER_FORMATS = {
    "sdf": "an SDF file, which describes worlds for Gazebo; look for the robot's URDF, or export one from it",
    "mujoco": "a MuJoCo file (MJCF), of which `qdgrasp gripper new` writes a URDF and a gripper's file",
    "mujocoinclude": "a part of a MuJoCo file (MJCF); name the file that includes it, whose root is <mujoco>",
    "gripper": "the description of a gripper for another program; name the robot's URDF",
}
"""Root elements of formats that are not URDF, with advice."""


def read_robot_element(path: Path) -> ET.Element:
    """Read the `<robot>` element of a URDF, or of a xacro file where xacro is installed.

    `AssetError` for other XML or no file.
    """
    if why := path_problem(path):
        raise AssetError(f"No URDF can be read at '{path}': it {why}; name the robot's .urdf file.")
    try:
        text = _expanded(path) if path.suffix.lower() == ".xacro" else _decoded(path.read_bytes())
        undeclared = [f' xmlns:{each}="0"' for each in {*PREFIX.findall(text)} if f"xmlns:{each}" not in text]
        text = text.replace("<robot", "".join(["<robot", *undeclared]), 1)
        element = ET.fromstring(text)  # noqa: S314  # the user's own file; expat refuses entities that grow
        ET.tostring(element)
    except RecursionError:
        raise AssetError(f"'{path}' nests elements too deeply for a robot.") from None
    except OSError as error:
        raise AssetError(f"No URDF can be read at '{path}': {error.strerror or error}.") from None
    except (UnicodeError, LookupError):
        raise AssetError(f"'{path}' is not XML but binary data; name the robot's .urdf file.") from None
    except ET.ParseError as error:
        if "<xacro:" in text:
            raise AssetError(_xacro_advice(path)) from None
        raise AssetError(
            f"'{path}' is not XML ({error}), and a URDF is; name the robot's .urdf file."
        ) from None
    is_xacro = any(  # tags or expressions of xacro, outside of comments
        XACRO_TAG.match(each.tag) or any(map(XACRO_SUBSTITUTION.search, each.attrib.values()))
        for each in element.iter()
    )
    if is_xacro:
        raise AssetError(_xacro_advice(path))
    if element.tag != "robot":
        unknown = f"an XML file whose root is <{element.tag}>, and a URDF's is <robot>"
        raise AssetError(f"'{path}' is no URDF but {OTHER_FORMATS.get(element.tag, unknown)}.")
    return element


def _decoded(content: bytes) -> str:
    """Return the text of an XML file, in the encoding that it declares; UTF-8 where it does not."""
    declared = XML_ENCODING.match(content)
    is_utf_16 = content.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE))
    return content.decode(declared[1].decode() if declared else "utf-16" if is_utf_16 else "utf-8-sig")


def _expanded(path: Path) -> str:
    """Return the URDF that xacro makes of a file; its `$(find P)` is found as `package://P` is."""
    try:
        xacro = importlib.import_module("xacro")
        arguments: Any = importlib.import_module("xacro.substitution_args")
    except ImportError:
        raise AssetError(_xacro_advice(path)) from None

    def find(package: str) -> str:
        found = next(filter(Path.is_dir, _mesh_places(path, f"package://{package}/")), None)
        if found is None:
            raise LookupError(f"the folder of the ROS package '{package}' is needed, from --package-path")
        return str(found.resolve())

    arguments._eval_find = find  # else ROS's own index is asked
    try:
        return str(xacro.process_file(str(path)).toxml())
    except Exception as error:  # noqa: BLE001  # xacro evaluates expressions: any error may come
        reason = getattr(error, "exc", None) or error
        raise AssetError(f"xacro makes no URDF of '{path}': {reason}.") from None


def _xacro_advice(path: Path) -> str:
    stem = path.name.removesuffix(".xacro").removesuffix(".urdf")
    name = f"{stem}.urdf" if path.name != f"{stem}.urdf" else f"{stem}_plain.urdf"
    return (
        f"'{path}' is a xacro file, of which a URDF is made: run `xacro {path.name} > {name}` "
        "(from ROS) and name that file, or `pip install xacro` here and name a file that ends in .xacro."
    )


def drop_visuals(element: ET.Element) -> None:
    """Remove the visual shapes of a `<robot>`."""
    for link in element.findall("link"):
        for visual in link.findall("visual"):
            link.remove(visual)
