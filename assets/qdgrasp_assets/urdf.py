"""A small reader of URDF: links, joints, origins, forward kinematics, sub-trees and mesh references."""

import copy
import importlib.util
import xml.etree.ElementTree as ET
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from qdgrasp_assets.mesh import Floats
from qdgrasp_protocol.errors import AssetError

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
    """Limits [rad or m]; equal, or lower above upper, where there are none."""
    effort: float
    velocity: float

    @property
    def moves(self) -> bool:
        """Whether it has a degree of freedom."""
        return self.kind in MOVING

    def motion(self, position: float | Floats) -> Floats:
        """(..., 4, 4): the child's frame in the joint's at positions (...) [rad or m]."""
        places = np.asarray(position, dtype=np.float64)[..., None]
        if self.kind == "prismatic":
            return _transform(np.eye(3), self.axis * places)
        if self.moves:
            return _transform(_rotation(self.axis, places[..., None]), np.zeros(3))
        return np.eye(4)


@dataclass(frozen=True)
class Urdf:
    """A robot as its file says it."""

    path: Path
    element: ET.Element
    links: tuple[str, ...]
    joints: tuple[UrdfJoint, ...]

    @property
    def root(self) -> str:
        """The link that is no joint's child."""
        children = {joint.child for joint in self.joints}
        return next(link for link in self.links if link not in children)

    @property
    def mass(self) -> float:
        """Of all links together [kg]."""
        return sum(mass for mass, _ in self.masses.values())

    @property
    def masses(self) -> dict[str, tuple[float, Floats]]:
        """Each link's mass [kg] and where it is, (3,) [m], link frame.

        A link whose mass the file does not say has 1 kg at its origin, as Bullet gives it.
        """
        return {link.get("name", ""): self._mass(link) for link in self.element.findall("link")}

    def _mass(self, link: ET.Element) -> tuple[float, Floats]:
        mass = link.find("inertial/mass")
        place = origin(self.path, link.find("inertial/origin"))[:3, 3]
        return (1.0, np.zeros(3)) if mass is None else (_number(self.path, mass, "value"), place)

    def joint(self, name: str) -> UrdfJoint | None:
        """The joint of this name; None when there is none."""
        return next((joint for joint in self.joints if joint.name == name), None)

    def forward(
        self, positions: Mapping[str, float] | Mapping[str, Floats], base: Floats | None = None
    ) -> dict[str, Floats]:
        """Every link's frame (..., 4, 4) in the world, with the root at `base`, (4, 4) or (..., 4, 4).

        Positions are numbers or arrays (...); joints not named stand at zero.
        """
        frames = {self.root: np.eye(4) if base is None else base}
        for joint in self.outward(self.root):
            motion = joint.motion(positions.get(joint.name, 0.0))
            frames[joint.child] = frames[joint.parent] @ joint.origin @ motion
        return frames

    def outward(self, base: str) -> Iterator[UrdfJoint]:
        """The joints beyond link `base`, each after the one that carries it."""
        reached = [base]
        for link in reached:
            for joint in self.joints:
                if joint.parent == link:
                    reached.append(joint.child)
                    yield joint

    def subtree(self, base: str) -> "Urdf":
        """The robot from link `base` outward, alone."""
        joints = {joint.name for joint in self.outward(base)}
        links = {base, *(joint.child for joint in self.outward(base))}
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
        """The robot for physics, and the mesh files that it needs by flat name.

        Visual shapes are left out and mesh references rewritten to the flat names; all else is as it was.

        Raises
        ------
        AssetError
            A mesh, of a visual shape too, is missing.
        """
        element = copy.deepcopy(self.element)
        files = {name: self._mesh_file(name) for name in _mesh_names(element)}
        for link in element.findall("link"):
            for visual in link.findall("visual"):
                link.remove(visual)
        flat: dict[str, str] = {}
        for mesh in element.iter("mesh"):
            name = mesh.get("filename", "")
            mesh.set("filename", flat.setdefault(name, f"{len(flat)}_{files[name].name}"))
        return element, {new: _mesh_bytes(files[name]) for name, new in flat.items()}

    def _mesh_file(self, name: str) -> Path:
        found = next((place for place in _places(self.path, name) if place.is_file()), None)
        if found is None:
            raise AssetError(f"The URDF '{self.path}' refers to the mesh '{name}', which does not exist.")
        return found


def read_urdf(path: Path) -> Urdf:
    """Read a robot.

    Raises
    ------
    AssetError
        It is not there, is not XML, or is not one tree of links and joints.
    """
    try:
        element = ET.fromstring(path.read_text(encoding="utf-8"))  # noqa: S314  # the user's own file
    except OSError as error:
        raise AssetError(f"No URDF can be read at '{path}': {error.strerror or error}.") from None
    except (ET.ParseError, UnicodeDecodeError) as error:
        raise AssetError(f"'{path}' cannot be parsed as a URDF: {error}.") from None
    if element.tag != "robot":
        raise AssetError(
            f"'{path}' cannot be parsed as a URDF: its root element is <{element.tag}>, not <robot>."
        )
    return tree(path, element)


def tree(path: Path, element: ET.Element) -> Urdf:
    """The robot that a `<robot>` element describes; `path` is where its mesh references start."""
    links = tuple(link.get("name", "") for link in element.findall("link"))
    urdf = Urdf(path, element, links, tuple(_joint(path, joint) for joint in element.findall("joint")))
    _check_tree(urdf)
    return urdf


def _check_tree(urdf: Urdf) -> None:
    known = set(urdf.links)
    for joint in urdf.joints:
        for link in (joint.parent, joint.child):
            if link not in known:
                raise AssetError(
                    f"The URDF '{urdf.path}': joint '{joint.name}' names the link '{link}', "
                    "which does not exist."
                )
    roots = known - {joint.child for joint in urdf.joints}
    if len(roots) != 1 or len(urdf.joints) != len(urdf.links) - 1 or len(known) != len(urdf.links):
        raise AssetError(
            f"The URDF '{urdf.path}' is not one tree: {len(urdf.links)} links, "
            f"{len(urdf.joints)} joints, {len(roots)} roots."
        )


def _joint(path: Path, element: ET.Element) -> UrdfJoint:
    limit = element.find("limit")
    limits = {
        name: 0.0 if limit is None else _number(path, limit, name, 0.0)
        for name in ("lower", "upper", "effort", "velocity")
    }
    return UrdfJoint(
        name=element.get("name", ""),
        kind=element.get("type", ""),
        parent=_end(element, "parent"),
        child=_end(element, "child"),
        origin=origin(path, element.find("origin")),
        axis=_axis(path, element.find("axis")),
        **limits,
    )


def _end(joint: ET.Element, tag: str) -> str:
    end = joint.find(tag)
    return "" if end is None else end.get("link", "")


def _number(path: Path, element: ET.Element, name: str, default: float | None = None) -> float:
    text = element.get(name)
    if text is None and default is not None:
        return default
    return _numbers(path, element, name, 1)[0]


def _numbers(path: Path, element: ET.Element, name: str, count: int) -> list[float]:
    text = element.get(name, "")
    try:
        values = [float(word) for word in text.split()]
    except ValueError:
        values = []
    if len(values) != count:
        raise AssetError(f"The URDF '{path}': <{element.tag} {name}=\"{text}\"> must hold {count} numbers.")
    return values


def origin(path: Path, element: ET.Element | None) -> Floats:
    """The frame (4, 4) that an `<origin>` stands for.

    Raises
    ------
    AssetError
        It does not hold three numbers each.
    """
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
    """(..., 3, 3): rotation by `angle` (..., 1, 1) [rad] about a unit axis (Rodrigues' formula)."""
    x, y, z = axis
    skew = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    rotation: Floats = np.eye(3) + np.sin(angle) * skew + (1.0 - np.cos(angle)) * (skew @ skew)
    return rotation


def _transform(rotation: Floats, translation: Floats) -> Floats:
    batch = np.broadcast_shapes(rotation.shape[:-2], translation.shape[:-1])
    transform = np.tile(np.eye(4), (*batch, 1, 1))
    transform[..., :3, :3], transform[..., :3, 3] = rotation, translation
    return transform


def _mesh_names(element: ET.Element) -> list[str]:
    """Mesh references in the order of the file, each once."""
    return list(dict.fromkeys(mesh.get("filename", "") for mesh in element.iter("mesh")))


def _mesh_bytes(path: Path) -> bytes:
    """The file's content; an OBJ without its materials, which would be missing from the bundle."""
    content = path.read_bytes()
    if path.suffix.lower() != ".obj":
        return content
    lines = content.splitlines(keepends=True)
    return b"".join(line for line in lines if not line.startswith((b"mtllib", b"usemtl", b"#")))


def _places(urdf: Path, name: str) -> Iterator[Path]:
    """Where a mesh reference may lie.

    Beside the URDF; for `package://P/...` in a folder P above it or beside one, else in the Python package P.
    """
    if not name.startswith("package://"):
        yield urdf.parent / name.removeprefix("file://")
        return
    package, _, rest = name.removeprefix("package://").partition("/")
    for folder in urdf.resolve().parents:
        yield folder / package / rest
        if folder.name == package:
            yield folder / rest
    spec = importlib.util.find_spec(package) if package.isidentifier() else None
    for place in (spec and spec.submodule_search_locations) or ():
        yield Path(place) / rest
