"""RepairedHand copies of hands that the simulator can take: a URDF and a folder of meshes.

They lie beside the gripper's file and hold the hand alone. Usable parts stay as they are; each change is
described in words. Links without a mass get that of solids of water, which is near that of hollow metal. A
base link in the middle is added where the fingers close beside the line on which the palm looks at objects.
"""

import copy
import xml.etree.ElementTree as ET
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from math import isclose
from pathlib import Path, PurePosixPath

import numpy as np

from qdgrasp_assets.geometry.collision_parts import (
    FingerClearance,
    Tell,
    decompose,
    simplify_part,
)
from qdgrasp_assets.geometry.mesh import (
    Floats,
    Mesh,
    hull,
    parts_to_obj,
    stl_triangles,
    unreadable_as,
)
from qdgrasp_assets.gripper_setup import closing_motion
from qdgrasp_assets.gripper_setup.draft import CENTRE, DraftOverrides, draft_axis, draft_closing
from qdgrasp_assets.gripper_setup.posture_checks import BESIDE
from qdgrasp_assets.grippers.collision_shapes import (
    CONCAVE,
    attribute_numbers,
    collision_elements,
    geometry_corners,
    triangles,
)
from qdgrasp_assets.grippers.hand_model import (
    collision_corners,
    contradicted_limits,
    read_hand_model,
)
from qdgrasp_assets.grippers.urdf import (
    Urdf,
    add_file,
    add_inertial,
    add_joint,
    drop_visuals,
    listed,
    parse_robot,
    read_urdf,
)
from qdgrasp_assets.grippers.urdf_checks import (
    LARGEST_SHAPE,
    SIMULATOR_FORMATS,
    bare_links,
    limit_scale,
    unweighed,
)
from qdgrasp_protocol.errors import AssetError

MUCH_FILLED = 0.1  # A link is hollow where its hull fills the room in front of this share of its surface
VOLUME_TOLERANCE = 0.001  # Volumes that differ by at most this share are taken as equal


def hollow_meshes(hand: Urdf) -> Iterator[tuple[str, float]]:
    """Yield links of hollow meshes, with the share of the surface before which hulls fill room."""
    for link, shape in collision_elements(hand):
        element = shape.find("geometry/mesh")
        if element is None or shape.get(CONCAVE) is not None:
            continue
        mesh = read_mesh_of(hand, element)
        parts = own_hulls(hand, element, mesh)
        volume = sum(part.volume for part in parts)
        if not parts or isclose(volume, mesh.volume, rel_tol=VOLUME_TOLERANCE):
            continue
        filled = FingerClearance(mesh).filled(parts)
        if filled > MUCH_FILLED:
            yield link, filled


def read_mesh_of(robot: Urdf, element: ET.Element) -> Mesh:
    """Read a robot's `<mesh>`, scaled, equal vertices merged; `AssetError` if it cannot be read."""
    name = element.get("filename", "")
    content = robot.mesh(name)
    with unreadable_as("The mesh '{}' cannot be read ({}); save it as an STL or OBJ file.", name):
        mesh = triangles(element, {name: content})
    return mesh.flipped() if np.prod(attribute_numbers(element, "scale", "1 1 1")) < 0 else mesh


def own_hulls(robot: Urdf, element: ET.Element, mesh: Mesh) -> tuple[Mesh, ...]:
    """Return the hulls that the simulator makes of a `<mesh>`, in the size of `mesh`; none flat."""
    name = element.get("filename", "")
    shapes = list(geometry_corners(element, {name: robot.mesh(name)})) or [mesh.vertices]
    factor = np.ptp(mesh.vertices) / max(np.ptp(np.concatenate(shapes)), 1e-12)
    return tuple(hull(factor * corners) for corners in shapes if is_solid(factor * corners))


def is_solid(corners: Floats) -> bool:
    """Return whether corners (v, 3) span three dimensions."""
    return bool(len(corners) and np.linalg.matrix_rank(corners - corners[0], tol=1e-7) == 3)


MILLIMETRES = 0.001


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
        """Return parts that leave the free space, and the change."""
        own = tuple(map(simplify_part, own_hulls(self._hand, element, mesh)))
        if not own:
            raise AssetError(f"The mesh '{name}' is flat: it encloses no volume; give it a thickness.")
        clearance = FingerClearance(mesh)
        filled = clearance.fit(own).filled
        if filled <= MUCH_FILLED:
            kind = PurePosixPath(name).suffix.lower()
            is_text = kind == ".stl" and stl_triangles(self._hand.mesh(name)) is None
            is_read = kind in SIMULATOR_FORMATS and not is_text
            return own, "" if is_read else "was made a convex hull, as the simulator reads no such file"
        self._tell(f"splitting the mesh '{name}' of the link '{link}' into convex parts")
        found = decompose(mesh, clearance, MUCH_FILLED / 2)
        left = clearance.fit(found).filled
        return found, (
            f"was split into {len(found)} convex parts: its hull would fill the room before "
            f"{100 * filled:.0f} % of its surface, they fill {100 * left:.0f} %"
        )


DENSITY = 1000.0  # Density of links with shapes [kg/m3]
FRAME_MASS = 1e-3  # Mass of links without shapes: frames, tips, mounts [kg]
LEAST_SIDE = 5e-3  # Least side of the box that gives a link its inertia [m]


def weigh(hand: Urdf) -> Iterator[str]:
    """Give a mass and an inertia to each link of a hand that lacks them; yields the changes."""
    given: dict[str, str] = {}
    wrong = unweighed(hand.element)
    for link in hand.element.findall("link"):
        name = link.get("name", "")
        if name not in wrong:
            continue
        for old in link.findall("inertial"):
            link.remove(old)
        shapes = link.findall("collision")
        parts = tuple(part for shape in shapes for part in collision_corners(hand, name, shape))
        given[name] = f"{name} {_add_mass(link, parts):.3g}"
    if given:
        yield (
            f"{listed('link', list(given))} given a mass, by the size of the shapes at {DENSITY:g} kg/m3 "
            f"({', '.join(given.values())} kg)"
        )


def _add_mass(link: ET.Element, parts: tuple[Floats, ...]) -> float:
    """Add the mass of convex parts (v, 3) [m], with their box's inertia; return it [kg]."""
    mass = max(DENSITY * sum(hull(part).volume for part in parts if is_solid(part)), FRAME_MASS)
    corners = np.concatenate([np.zeros((0, 3)), *parts])
    low, high = (corners.min(axis=0), corners.max(axis=0)) if len(corners) else (np.zeros(3), np.zeros(3))
    sides = np.maximum(high - low, LEAST_SIDE) ** 2
    moments = mass / 12 * (sides.sum() - sides)
    middle = " ".join(f"{value:.6g}" for value in (low + high) / 2)
    add_inertial(link, f"{mass:.6g}", [f"{moment:.6g}" for moment in moments], middle)
    return mass


RepairedHand = tuple[ET.Element, dict[str, bytes], tuple[str, ...]]
"""A repaired `<robot>`, its meshes by path, and the changes in words."""


def repair(robot: Urdf, base: str, folder: str, tell: Tell) -> RepairedHand:
    """Repair the hand from link `base` on, of a URDF whose links and joints are one tree.

    Meshes will lie in `folder`, relative to the URDF that will be written. `tell` is called with a sentence
    before each slow step. Raises `AssetError` if a mesh is missing or cannot be read.
    """
    hand = replace(robot, element=robot.subtree(base).element)
    splitter = MeshSplitter(hand, folder, tell)
    changes = [*_joints(hand.path, hand.element), *_shapes(hand.element), *splitter.repair()]
    drop_visuals(hand.element)
    changes += weigh(parse_robot(hand.path, hand.element, {**hand.meshes, **splitter.files}))
    return hand.element, splitter.files, tuple(changes)


def transcribe(robot: Urdf, base: str, folder: str) -> RepairedHand:
    """Return the hand from link `base` on as it is; meshes that are no files yet go to `folder`."""
    element = copy.deepcopy(robot.subtree(base).element)
    files = {}
    for mesh in element.iter("mesh"):
        if (name := mesh.get("filename", "")) in robot.meshes:
            mesh.set("filename", f"{folder}/{name}")
            files[f"{folder}/{name}"] = robot.meshes[name]
    return element, files, ()


def _joints(path: Path, element: ET.Element) -> Iterator[str]:
    """Fix floating joints, and correct limits: the wrong way round, or against a <mimic>."""
    kinds = {joint.get("name", ""): joint.get("type", "") for joint in element.findall("joint")}
    scales = {name: limit_scale(element, kind) for name, kind in kinds.items()}
    if scaled := [name for name, scale in scales.items() if scale != 1.0]:
        yield f"{listed('joint', scaled)} limited in rad and m, as its limits looked like degrees or mm"
    for joint in element.findall("joint"):
        scale = scales[joint.get("name", "")]
        if (limit := joint.find("limit")) is not None:
            _multiply(limit, scale, "lower", "upper")
        if (mimic := joint.find("mimic")) is not None:
            _multiply(mimic, scale, "offset")
            _multiply(mimic, scale / scales.get(mimic.get("joint", ""), 1.0), "multiplier")
    floating, turned = [], []
    for joint in element.findall("joint"):
        limit, name = joint.find("limit"), joint.get("name", "")
        if joint.get("type") == "floating":
            joint.set("type", "fixed")
            floating.append(name)
        elif limit is not None and float(limit.get("lower", "0")) > float(limit.get("upper", "0")):
            lower, upper = limit.get("lower", "0"), limit.get("upper", "0")
            limit.set("lower", upper)
            limit.set("upper", lower)
            turned.append(name)
    widened = []
    for name, (low, high) in contradicted_limits(parse_robot(path, element)).items():
        limit = element.find(f"joint[@name='{name}']/limit")
        if limit is not None:
            limit.set("lower", f"{low:.9g}")
            limit.set("upper", f"{high:.9g}")
            widened.append(name)
    if widened:
        yield f"{listed('joint', widened)} limited to where <mimic> takes it, which its limits did not allow"
    if floating:
        yield f"{listed('joint', floating)} fixed, as no motor drives what floats"
    if turned:
        yield f"{listed('joint', turned)} limited the right way round: lower and upper were swapped"


def _multiply(element: ET.Element, factor: float, *names: str) -> None:
    """Multiply some numbers of an element, where it has them."""
    for name in names:
        if factor != 1.0 and name in element.attrib:
            element.set(name, f"{factor * float(element.attrib[name]):.9g}")


def _shapes(element: ET.Element) -> Iterator[str]:
    """Take the visual shapes for collision where links have no others."""
    taken = bare_links(element)
    for link in element.findall("link"):
        for visual in link.findall("visual") if link.get("name") in taken else ():
            shape = ET.SubElement(link, "collision")
            shape.extend(child for child in visual if child.tag in ("origin", "geometry"))
    if taken:
        yield f"{listed('link', list(taken))} given the visual shapes for collision, as there were no others"


def with_visual_shapes(robot: Urdf) -> Urdf:
    """Return the robot with visual shapes for collision, if no moving link has others."""
    shaped, element = {link for link, _ in collision_elements(robot)}, copy.deepcopy(robot.element)
    is_shaped = any(joint.moves and joint.child in shaped for joint in robot.joints)
    return robot if is_shaped or not tuple(_shapes(element)) else replace(robot, element=element)


@dataclass(frozen=True)
class RepairedCopy:
    """A repaired copy of a hand."""

    robot: Urdf
    base: str
    changes: tuple[str, ...]


def centre_base(robot: Urdf, base: str, overrides: DraftOverrides) -> RepairedCopy | None:
    """Add a base link on the fingers' line before `base`; None where they close near its line.

    The hand approaches and closes as in its file, where `overrides` tell nothing else. Raises as
    `draft_gripper` does.
    """
    body = read_hand_model(robot, base)
    closing = draft_closing(body, overrides)
    if not closing.fingers:
        return None
    axis, centre = draft_axis(closing, overrides)[0], closing_motion.grasp_centre(closing)
    if closing_motion.axis_offset(closing, axis) <= (BESIDE if len(closing.fingers) > 1 else BESIDE / 5):
        return None
    place = (centre - (centre @ axis) * axis).round(3) + 0.0
    name, words = base + CENTRE, " ".join(f"{value:g}" for value in place)
    element = copy.deepcopy(body.robot.element)
    link = ET.SubElement(element, "link", name=name)  # with a mass: without one Bullet would hold it still
    add_inertial(link, f"{FRAME_MASS:g}", ["1e-7"] * 3)
    back = " ".join(f"{0.0 - value:g}" for value in place)
    add_joint(element, f"{name}_joint", "fixed", (name, base), back)
    change = (
        f"the base link is '{name}', a new one at ({words}) m in the frame of '{base}', "
        f"on the line on which the fingers close: poses are those of '{name}', and exports say where "
        f"'{base}' is"
    )
    return RepairedCopy(parse_robot(robot.path, element), name, (change,))


HEAD = "<!-- A copy written by `qdgrasp gripper new`, which writes it again where it is told to. -->\n"


def repaired_urdf(toml: Path) -> Path:
    """Return the path of the repaired URDF of a gripper's file."""
    return toml.with_name(f"{toml.stem}_repaired.urdf")


def repaired_meshes(toml: Path) -> Path:
    """Return the path of the folder of the repaired URDF's meshes."""
    return toml.with_name(f"{toml.stem}_meshes")


@contextmanager
def repaired_copy(
    robot: Urdf,
    base: str,
    toml: Path,
    tell: Tell,
    *,
    may_centre: bool,
    overrides: DraftOverrides | None = None,
    as_it_is: bool = False,
) -> Iterator[RepairedCopy]:
    """Write a repaired copy of the hand from link `base` on, beside the gripper's file `toml`.

    With `as_it_is` nothing is repaired: a hand whose file is no URDF becomes one. An older copy is replaced.
    Where the with-block fails, what was written is removed. `tell` is called before each slow step. With
    `may_centre` another base link is put before `base` where the fingers close beside its line of approach,
    with the `overrides` that the draft of its file will have. Raises `AssetError` if a mesh is missing or
    cannot be read, or the copy cannot be written; and the
    errors of `draft_gripper`.
    """
    urdf, folder = repaired_urdf(toml), repaired_meshes(toml)
    folder_name = folder.name
    element, meshes, changes = (
        transcribe(robot, base, folder_name) if as_it_is else repair(robot, base, folder_name, tell)
    )
    written = [urdf, *(urdf.parent / name for name in meshes)]
    try:
        for path, content in zip(written[1:], meshes.values(), strict=True):
            _write(path, content)
        _write(urdf, _urdf_text(element, robot.path.name))
        copy = RepairedCopy(read_urdf(urdf), base, changes)
        centred = centre_base(copy.robot, base, overrides or DraftOverrides()) if may_centre else None
        if centred is not None:
            _write(urdf, _urdf_text(centred.robot.element, robot.path.name))
            copy = RepairedCopy(read_urdf(urdf), centred.base, (*changes, *centred.changes))
        yield copy
    except BaseException:
        for path in written:
            path.unlink(missing_ok=True)
        with suppress(OSError):  # not empty, or not there
            folder.rmdir()
        raise


def _urdf_text(element: ET.Element, origin: str) -> bytes:
    ET.indent(element)
    source = f"<!-- It was made from '{origin.replace('--', '- -')}'. -->\n"  # a comment holds no two hyphens
    return (HEAD + source + ET.tostring(element, encoding="unicode") + "\n").encode()


def _write(path: Path, content: bytes) -> None:
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(content)
    except OSError as error:
        raise AssetError(
            f"The repaired hand cannot be written to '{path}': {error.strerror or error}."
        ) from None
