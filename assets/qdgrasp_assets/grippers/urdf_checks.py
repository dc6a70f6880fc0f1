"""Checks of a hand's URDF: faults that the simulator would not take, in words.

Joints, masses and meshes are checked, and all faults listed at once (`urdf` checks that it is one tree).
"""

import xml.etree.ElementTree as ET
from collections.abc import Iterator, Mapping
from pathlib import PurePosixPath

import numpy as np

from qdgrasp_assets.asset_paths import path_problem
from qdgrasp_assets.geometry.mesh import stl_triangles
from qdgrasp_assets.grippers.collision_shapes import FORMS, collision_elements
from qdgrasp_assets.grippers.hand_geometry import rigid_pieces
from qdgrasp_assets.grippers.hand_model import collision_corners
from qdgrasp_assets.grippers.urdf import Urdf, listed, numbers_in
from qdgrasp_protocol.errors import AssetError

REPAIR_ADVICE = "or have `qdgrasp gripper new --repair` do it"
LIMITED = ("revolute", "prismatic")
KINDS = {
    "fixed": "",
    "revolute": "",
    "continuous": "",
    "prismatic": "",
    "floating": "a floating one, which no motor drives, and the simulator would fix it: make it fixed",
    "planar": "a planar one, which no motor drives: make it fixed, or two prismatic joints",
}
"""Kinds of joints of URDF, with the fault of each here; empty if it has no fault."""


def motion_faults(element: ET.Element) -> tuple[str, ...]:
    """Return the faults of the joints of a `<robot>`."""
    joints = {joint.get("name", ""): joint for joint in element.findall("joint")}
    found = [fault for name, joint in joints.items() for fault in _joint_faults(name, joint, joints)]
    return (*found, *_limit_faults(element))


def kind_fault(name: str, kind: str) -> str:
    """Return the fault in a joint's kind; empty if it has no fault."""
    fault = KINDS.get(kind, f"of the type '{kind}', and URDF knows {', '.join(KINDS)}")
    return f"the joint '{name}' is {fault}" if fault else ""


def _joint_faults(name: str, joint: ET.Element, joints: Mapping[str, ET.Element]) -> Iterator[str]:
    kind = joint.get("type", "")
    if fault := kind_fault(name, kind):
        yield fault
        return
    if kind in LIMITED and joint.find("limit") is None:
        yield f"the joint '{name}' is {kind} and has no <limit>: give it lower, upper, effort and velocity"
    axis = joint.find("axis")
    if kind != "fixed" and axis is not None and not any(numbers_in(axis.get("xyz", ""))):
        yield f"the joint '{name}' has the axis '{axis.get('xyz')}'; an axis has a direction, such as '0 0 1'"
    mimic = joint.find("mimic")
    leader = None if mimic is None else mimic.get("joint", "")
    if leader is not None and (leader not in joints or leader == name):
        yield f"the joint '{name}' mimics '{leader}', which is no other joint of the robot; correct the name"
    factors = "1 0" if mimic is None else f"{mimic.get('multiplier', 1)} {mimic.get('offset', 0)}"
    if len(numbers_in(factors)) != 2:
        yield f"the joint '{name}' mimics another by what is no number; correct multiplier and offset"


def _limits(element: ET.Element) -> Iterator[tuple[str, str, float, float]]:
    """Yield the joints of a `<robot>` with limits: name, type, lower and upper [rad or m]."""
    for joint in element.findall("joint"):
        limit = joint.find("limit")
        if joint.get("type") in LIMITED and limit is not None:
            numbers = numbers_in(f"{limit.get('lower', '0')} {limit.get('upper', '0')}")
            if len(numbers) == 2:
                yield joint.get("name", ""), joint.get("type", ""), numbers[0], numbers[1]


def _limit_faults(element: ET.Element) -> Iterator[str]:
    """Yield faults of limits: ignored by Bullet, without a range, or in other units."""
    limits = list(_limits(element))
    turned = [name for name, _, low, high in limits if low > high]
    still = [name for name, _, low, high in limits if low == high]
    endless = [name for name, _, low, high in limits if max(abs(low), abs(high)) >= NO_LIMIT]
    for kind, (_, _, unit) in LIMIT_UNITS.items():
        if limit_scale(element, kind) != 1.0:
            yield f"limits of its {kind} joints look like {unit}: convert them, {REPAIR_ADVICE}"
    if endless:
        yield f"{listed('joint', endless)} limited so far that it has no limits: give those of the hand"
    if turned:
        yield (
            f"{listed('joint', turned)} limited the wrong way round, lower above upper, which the simulator "
            "takes for no limits: swap them"
        )
    if still:
        yield (
            f"{listed('joint', still)} limited to one place, lower equal to upper: make it fixed, or widen it"
        )


LIMIT_UNITS = {
    "revolute": (4 * np.pi, np.pi / 180, "degrees, and they are in rad"),
    "prismatic": (2.0, 1e-3, "millimetres, and they are in m"),
}
"""Largest limit of a hand's joints [rad or m], with the factor and the unit that a larger one is in."""
NO_LIMIT = 1e4  # Limits that mean that there are none [rad or m]


def limit_scale(element: ET.Element, kind: str) -> float:
    """Return the factor to rad or m of the limits of all joints of a type."""
    most, factor, _ = LIMIT_UNITS.get(kind, (np.inf, 1.0, ""))
    limits = [max(abs(low), abs(high)) for _, each, low, high in _limits(element) if each == kind]
    return factor if max((limit for limit in limits if limit < NO_LIMIT), default=0.0) > most else 1.0


HEAVIEST_HAND = 30.0  # Largest mass of a hand [kg]; a heavier one is given in grams


def weight_faults(element: ET.Element) -> tuple[str, ...]:
    """Return the faults in the masses of a `<robot>`'s links."""
    absent, still = _mass_problems(element)
    faults = []
    if absent:
        faults.append(
            f"{listed('link', absent)} without a mass and an inertia that can be: give both, the mass in kg, "
            f"{REPAIR_ADVICE}"
        )
    if still:
        faults.append(
            f"{listed('link', still)} of mass 0, with all that fixed joints add: a joint that carries no "
            f"mass stands still in the simulator; give it in kg, {REPAIR_ADVICE}"
        )
    total = sum(mass or 0.0 for mass in _masses(element).values())
    if total > HEAVIEST_HAND:
        faults.append(
            f"it weighs {total:.4g} kg, which looks like grams: masses are in kg, so multiply them by 0.001"
        )
    return tuple(faults)


def unweighed(element: ET.Element) -> frozenset[str]:
    """Return the links of a `<robot>` whose masses are missing or have to be changed."""
    return frozenset().union(*_mass_problems(element))


def _mass_problems(element: ET.Element) -> tuple[list[str], list[str]]:
    """Return the links without mass or inertia, and those of mass 0 with all fixed to them.

    A joint without mass beyond it stands still in Bullet, with any motor; a frame of mass 0 that is fixed to
    a link with a mass moves with it.
    """
    masses, pieces = _masses(element), rigid_pieces(element)
    heavy = {pieces[name] for name, mass in masses.items() if mass != 0}
    absent = [name for name, mass in masses.items() if mass is None]
    return absent, [name for name in masses if pieces[name] not in heavy]


def bare_links(element: ET.Element) -> tuple[str, ...]:
    """Return the links that have visual shapes alone, as all that is fixed to them."""
    pieces, links = rigid_pieces(element), element.findall("link")
    shaped = {pieces[link.get("name", "")] for link in links if link.find("collision") is not None}
    seen = (link.get("name", "") for link in links if link.find("visual") is not None)
    return tuple(name for name in seen if pieces[name] not in shaped)


def _masses(element: ET.Element) -> dict[str, float | None]:
    """Return the masses of links by name [kg]; None where a mass or an inertia cannot be."""
    masses: dict[str, float | None] = {}
    for link in element.findall("link"):
        mass, inertia = link.find("inertial/mass"), link.find("inertial/inertia")
        values = [] if mass is None or inertia is None else numbers_in(mass.get("value", ""))
        masses[link.get("name", "")] = values[0] if len(values) == 1 and values[0] >= 0 else None
    return masses


LARGEST_SHAPE = 2.0  # Largest side of a link [m]; a larger one was drawn in millimetres
SIZE_ATTRIBUTES = {"box": ("size",), "cylinder": ("radius", "length"), "sphere": ("radius",)}
SIZE_COUNTS = {"box": 3, "cylinder": 2, "sphere": 1}  # Number of values in each of these sizes
PACKAGE = "package://"
SIMULATOR_FORMATS = (".stl", ".obj", ".dae")  # Mesh files that the simulator reads


def hand_faults(hand: Urdf) -> tuple[str, ...]:
    """Return the faults of joints, masses and shapes of a hand without an arm."""
    shapes = dict.fromkeys(_shape_fault(hand, link, shape) for link, shape in collision_elements(hand))
    return (*motion_faults(hand.element), *weight_faults(hand.element), *filter(None, shapes))


def _suffix(name: str) -> str:
    return PurePosixPath(name).suffix.lower()


def _missing_mesh(hand: Urdf, name: str) -> str:
    """Describe why a mesh cannot be read, where it should be, and how to correct that."""
    if not name.startswith(PACKAGE):
        place = hand.path.parent / name.removeprefix("file://")
        return f"{path_problem(place) or 'cannot be read'}: there should be a mesh file at '{place}'"
    package, _, rest = name.removeprefix(PACKAGE).partition("/")
    return (
        f"is not found: a folder '{package}' with '{rest}' is looked for above the URDF, beside it, in "
        f"ROS_PACKAGE_PATH and as a Python package; put the ROS package '{package}' there, or the whole path"
    )


def _shape_fault(hand: Urdf, link: str, shape: ET.Element) -> str:
    """Return the fault of one collision shape; empty if it has no fault."""
    geometry = shape.find("geometry")
    form = geometry[0] if geometry is not None and len(geometry) else None
    if form is None:
        return f"a <collision> of the link '{link}' has no shape in its <geometry>; add one, or leave it out"
    if form.tag not in FORMS:
        return (
            f"the link '{link}' has a collision shape <{form.tag}>, and URDF knows "
            f"{', '.join(FORMS)}: make it one of those"
        )
    if form.tag == "mesh":
        return _mesh_fault(hand, link, shape, form.get("filename", ""))
    size = " ".join(form.get(name, "") for name in SIZE_ATTRIBUTES[form.tag])
    sizes = numbers_in(size)
    if len(sizes) == SIZE_COUNTS[form.tag] and min(sizes) > 0:
        return ""
    return (
        f"the link '{link}' has a collision shape <{form.tag}> of the size '{size}': it takes "
        f"{' and '.join(SIZE_ATTRIBUTES[form.tag])}, {SIZE_COUNTS[form.tag]} in all, greater than 0"
    )


def _mesh_fault(hand: Urdf, link: str, shape: ET.Element, name: str) -> str:
    mesh = f"the mesh '{name}' of the link '{link}'"
    try:
        content = hand.mesh(name)
    except AssetError:
        return f"the mesh '{name}' {_missing_mesh(hand, name)}"
    if _suffix(name) not in SIMULATOR_FORMATS:
        return (
            f"{mesh} is a {_suffix(name) or 'nondescript'} file, and the simulator reads "
            f"{', '.join(SIMULATOR_FORMATS)}: save it as one, or use --repair"
        )
    if _suffix(name) == ".stl" and stl_triangles(content) is None:
        return f"{mesh} is no binary STL file, which alone the simulator reads: save it so, or use --repair"
    try:
        corners = np.concatenate([np.zeros((0, 3)), *collision_corners(hand, link, shape)])
    except AssetError as error:
        return str(error).rstrip(".")
    if not len(corners):
        return f"{mesh} is empty: give it one with a surface, or leave the shape out"
    if not np.isfinite(corners).all():
        return f"{mesh} has vertices that are not finite: export it again"
    side = float(np.ptp(corners, axis=0).max())
    if side > LARGEST_SHAPE:
        return (
            f"{mesh} is {side:.4g} m large, so it looks like millimetres: write "
            '<mesh filename="..." scale="0.001 0.001 0.001"/>, or use --repair'
        )
    return ""
