"""Reader of hands in MuJoCo's format (MJCF), such as those of MuJoCo Menagerie, as URDF.

MuJoCo itself reads the file, with its defaults, classes, includes, frames, meshes and masses; the compiled
model is then written as a `<robot>`. A link's frame is its body's, moved to the anchor of the body's last
joint, and positions of joints are the file's. Joints that equalities, linkages and tendons couple become
mimics (`mjcf_couplings`). Damping, friction, gains and sites are not kept.
"""

import re
import xml.etree.ElementTree as ET
from collections import Counter
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from qdgrasp_assets.asset_paths import path_problem
from qdgrasp_assets.geometry.mesh import Floats, Mesh, geodesic, hull, parts_to_obj
from qdgrasp_assets.grippers.mjcf_couplings import Mechanism, command_ranges, efforts, find_couplings
from qdgrasp_assets.grippers.urdf import (
    MOST_LINKS,
    MOST_NAMED,
    Urdf,
    UrdfJoint,
    add_file,
    add_inertial,
    add_joint,
    parse_robot,
)
from qdgrasp_protocol.errors import AssetError
from qdgrasp_protocol.text import counted, first_few, quoted

SOFT = ("composite", "flexcomp", "flex", "deformable", "skin")  # Elements of bodies that bend
CHAIN_MASS, CHAIN_INERTIA = 1e-3, 1e-7  # For links between two joints of a body [kg, kg m2]
ROUND_FREQUENCY = 4  # of the geodesic spheres that capsules and ellipsoids are made of: 162 corners
SMALL_TURN = np.radians(2 * np.pi)  # Hinges that turn by less were written in radians, and read as degrees
UPRIGHT = 1e-9  # Cosine of a pitch that is taken for a right angle


def is_mjcf(path: Path) -> bool:
    """Return whether the root of an XML file is `<mujoco>`; False for other files or none."""
    if path_problem(path):
        return False
    try:
        with path.open("rb") as file:
            root: ET.Element = next(ET.iterparse(file, events=("start",)))[1]  # noqa: S314  # the root alone
            return root.tag == "mujoco"
    except (ET.ParseError, StopIteration, OSError, ValueError):
        return False


def read_mjcf(path: Path) -> tuple[Urdf, tuple[str, ...]]:
    """Read a hand from an MJCF file: as URDF with its meshes, and how it was translated.

    The root is the world, on which the bodies hang. Raises `AssetError` for a file that MuJoCo cannot read,
    with its reason; for soft bodies, and more than `MOST_LINKS` bodies. Ball joints, and slides without
    limits, are left to the checks of a URDF.
    """
    model = _compiled(path)
    translation = _Translation(path, model)
    robot = parse_robot(path, translation.robot, translation.meshes)
    return robot, tuple(translation.notes())


def _compiled(path: Path) -> Any:
    """Return the `mujoco.MjModel` of a file, without looks, sensors and contacts."""
    import mujoco  # takes half a second, and most commands read no such file

    _check_source(path)
    mujoco.set_mju_user_warning(lambda _text: None)  # else a file is written
    try:
        spec = mujoco.MjSpec.from_file(str(path))
        if len(spec.bodies) > MOST_LINKS:
            raise AssetError(f"'{path}' has {len(spec.bodies)} bodies, and at most {MOST_LINKS} are read.")
        _leave_out_looks(spec, mujoco)
        spec.option.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONTACT)
        model = spec.compile()
    except (ValueError, mujoco.FatalError) as error:
        reason = ", ".join(line.strip() for line in str(error).splitlines() if line.strip())
        raise AssetError(
            f"MuJoCo cannot read '{path}': {reason.removeprefix('Error: ').rstrip('.')}."
        ) from None
    return model


def _check_source(path: Path) -> None:
    """Check for content that MuJoCo would take long to read; AssetError."""
    try:
        root = ET.parse(path).getroot()  # noqa: S314  # the user's own file; expat refuses entities that grow
    except (ET.ParseError, ValueError) as error:
        raise AssetError(f"'{path}' is not XML ({error}), and an MJCF file is.") from None
    if soft := sorted({each.tag for each in root.iter() if each.tag in SOFT and len(each.attrib)}):
        raise AssetError(f"'{path}' has soft bodies (<{'>, <'.join(soft)}>), and hands are rigid here.")


def _leave_out_looks(spec: Any, mujoco: Any) -> None:
    """Delete textures, sensors, keyframes, and the visual meshes that no mass depends on."""
    for each in (*spec.geoms, *spec.sites, *spec.tendons):
        each.material = ""
    for kind in (spec.keys, spec.sensors, spec.skins, spec.materials, spec.textures, spec.tuples):
        for each in kind:
            spec.delete(each)
    from_geoms = spec.compiler.inertiafromgeom == mujoco.mjtInertiaFromGeom.mjINERTIAFROMGEOM_TRUE
    meets = {name for pair in spec.pairs for name in (pair.geomname1, pair.geomname2)}
    for geom in spec.geoms:
        is_weighed = not geom.parent.explicitinertial or from_geoms
        is_looks = not (geom.contype or geom.conaffinity or geom.name in meets)
        weighs = is_weighed and geom.density > 0 and geom.mass != 0 and geom.parent.id > 0
        if geom.type == mujoco.mjtGeom.mjGEOM_MESH and is_looks and not weighs:
            spec.delete(geom)
    used = {geom.meshname for geom in spec.geoms}
    for mesh in spec.meshes:
        if mesh.name not in used:
            spec.delete(mesh)


class _Translation:
    """A compiled model as `<robot>`; AssetError as in `read_mjcf`."""

    def __init__(self, path: Path, model: Any) -> None:
        import mujoco

        self._path, self._model, self._mujoco = path, model, mujoco
        bodies = [model.body(n).name for n in range(model.nbody)]
        joints = [model.joint(n).name for n in range(model.njnt)]
        self._link_names, self._joint_names = set(bodies), set(joints)
        self._links = [name or _new_name(self._link_names, f"body_{n}") for n, name in enumerate(bodies)]
        self._joints = [name or _new_name(self._joint_names, f"joint_{n}") for n, name in enumerate(joints)]
        mechanism = Mechanism(model, self._joints)
        self._couplings = find_couplings(mechanism)
        self._efforts = dict(zip(mechanism.joints, efforts(mechanism), strict=True))
        self._commands = {mechanism.joints[n]: limits for n, limits in command_ranges(mechanism).items()}
        self._anchors = np.zeros((model.nbody, 3))
        """(bodies, 3): origin of each link in its body's frame [m]."""
        self._counts: Counter[str] = Counter()
        self._mesh_files: dict[int, str] = {}
        self.meshes: dict[str, bytes] = {}
        self.robot = ET.Element("robot", name=path.stem)
        self._bodies = self._moved_trees()
        shapes = self._shapes()
        for body in self._bodies:
            link = self._add_body(body)
            for geom in shapes:
                if model.geom_bodyid[geom] == body:
                    self._add_shape(link, geom)

    def notes(self) -> Iterator[str]:
        """Yield how the file was translated."""
        counts, model = self._counts, self._model
        moving, shapes = self.robot.findall("joint/axis"), self.robot.findall("link/collision")
        yield (
            f"{counted(len(self._bodies) - 1, 'body', 'bodies')} with {counted(len(moving), 'joint')} and "
            f"{counted(len(shapes), 'shape')}, translated to a URDF"
        )
        hinges = model.jnt_limited.astype(bool) & (model.jnt_type == int(self._mujoco.mjtJoint.mjJNT_HINGE))
        if hinges.any() and (turn := np.ptp(model.jnt_range[hinges], axis=1).max()) < SMALL_TURN:
            yield (
                f"no hinge turns by more than {turn:.3g} rad, as angles of the file are degrees: if they are "
                'meant as radians, write <compiler angle="radian"/> into it'
            )
        yield from self._couplings.notes
        top = [body for body in range(1, model.nbody) if model.body_rootid[body] == body]
        if others := quoted(self._links[body] for body in top if body not in self._bodies):
            yield f"{first_few(others, MOST_NAMED)} left out, in which no actuator moves a joint"
        joints = [n for n in range(model.njnt) if model.jnt_bodyid[n] in self._bodies]
        following = {*self._couplings.mimics, *(each.leader for each in self._couplings.mimics.values())}
        moved = self._couplings.moved | following
        if model.nu and (idle := [self._joints[n] for n in joints if self._joints[n] not in moved]):
            yield f"no actuator moves {first_few(quoted(idle), MOST_NAMED)}: each gets a motor of its own"
        if counts["looks"]:
            yield "no shape of the file collides, so that the visual ones were taken"
        if counts["chain"]:
            yield (
                f"{counted(counts['chain'], 'link')} of {CHAIN_MASS * 1e3:g} g added, between the joints of "
                "bodies that have more than one"
            )

    def _add_body(self, body: int) -> ET.Element:
        """Add a body's joints and links to the robot; return the last link, which is its own."""
        model, parent = self._model, int(self._model.body_parentid[body])
        name, before = self._links[body], self._links[parent]
        if not body:
            return self._add_inertia(name, 0.0, np.zeros(3), np.eye(4))
        origin = _shift(-self._anchors[parent]) @ _frame(model.body_pos[body], model.body_quat[body])
        first = model.body_jntadr[body]
        joints = [
            joint
            for joint in range(first, first + model.body_jntnum[body])
            if self._joint_kind(joint) != self._mujoco.mjtJoint.mjJNT_FREE
        ]
        anchor = np.zeros(3)
        for number, joint in enumerate(joints):
            is_last = number == len(joints) - 1
            link = name if is_last else _new_name(self._link_names, f"{name}_{self._joints[joint]}")
            turns = self._joint_kind(joint) == self._mujoco.mjtJoint.mjJNT_HINGE
            place = model.jnt_pos[joint] if turns else anchor
            self._add_joint(joint, before, link, origin @ _shift(place - anchor))
            if not is_last:
                self._add_inertia(link, CHAIN_MASS, np.full(3, CHAIN_INERTIA), np.eye(4))
                self._counts["chain"] += 1
            before, origin, anchor = link, np.eye(4), place
        if not joints:
            fixed = _new_name(self._joint_names, f"{name}_fixed")
            add_joint(self.robot, fixed, "fixed", (before, name), **_origin(origin))
        self._anchors[body] = anchor
        inertial = _shift(-anchor) @ _frame(model.body_ipos[body], model.body_iquat[body])
        return self._add_inertia(name, model.body_mass[body], model.body_inertia[body], inertial)

    def _joint_kind(self, number: int) -> Any:
        return self._mujoco.mjtJoint(self._model.jnt_type[number])

    def _add_joint(self, number: int, parent: str, child: str, origin: Floats) -> None:
        """Add a joint whose zero is the file's: at `ref` bodies are as they are written."""
        model, name = self._model, self._joints[number]
        axis, limits = np.array(model.jnt_axis[number]), self._limits(number)
        kinds = {"HINGE": "continuous" if limits is None else "revolute", "SLIDE": "prismatic"}
        kind = kinds.get(self._joint_kind(number).name.removeprefix("mjJNT_"), "ball")
        reference = float(model.qpos0[model.jnt_qposadr[number]])
        motion = UrdfJoint(name, kind, parent, child, origin, axis, 0.0, 0.0, 0.0, 0.0).motion(-reference)
        element = add_joint(self.robot, name, kind, (parent, child), **_origin(origin @ motion))
        ET.SubElement(element, "axis", xyz=_words(axis))
        if limits is not None or kind == "continuous":
            bounds = {} if limits is None else {"lower": _words(limits[:1]), "upper": _words(limits[1:])}
            ET.SubElement(element, "limit", bounds, effort=f"{self._efforts[number]:.6g}", velocity="0")
        if mimic := self._couplings.mimics.get(name):
            factors = {"multiplier": repr(mimic.multiplier), "offset": repr(mimic.offset)}
            ET.SubElement(element, "mimic", factors, joint=mimic.leader)

    def _limits(self, number: int) -> tuple[float, ...] | None:
        """Return a joint's limits [rad, m], or those of its commands; None without either."""
        if self._model.jnt_limited[number]:
            return tuple(self._model.jnt_range[number].tolist())
        return self._commands.get(number)

    def _add_inertia(self, name: str, mass: float, moments: Floats, frame: Floats) -> ET.Element:
        """Add a link with this mass [kg] and principal moments (3,) [kg m2] at `frame`."""
        link = ET.SubElement(self.robot, "link", name=name)
        add_inertial(link, repr(float(mass)), [repr(float(each)) for each in moments], **_origin(frame))
        return link

    def _moved_trees(self) -> list[int]:
        """Return the world and the bodies of those trees on it that have actuators; all if none has."""
        model, moved = self._model, self._couplings.moved
        roots = {
            model.body_rootid[model.jnt_bodyid[n]] for n, name in enumerate(self._joints) if name in moved
        }
        return [
            body for body in range(model.nbody) if not (body and roots) or model.body_rootid[body] in roots
        ]

    def _shapes(self) -> list[int]:
        """Return the geoms that become collision shapes: those that meet others, else all."""
        model, kinds = self._model, self._mujoco.mjtGeom
        endless = np.isin(model.geom_type, (int(kinds.mjGEOM_PLANE), int(kinds.mjGEOM_HFIELD)))
        meets = (model.geom_contype != 0) | (model.geom_conaffinity != 0)
        meets[[*model.pair_geom1, *model.pair_geom2]] = True
        on_body = np.isin(model.geom_bodyid, self._bodies[1:])
        collide, looks = meets & on_body & ~endless, ~meets & on_body & ~endless
        self._counts["looks"] = looks.any() and not collide.any()
        return list(np.flatnonzero(collide if collide.any() else looks))

    def _add_shape(self, link: ET.Element, geom: int) -> None:
        model, kinds, body = self._model, self._mujoco.mjtGeom, int(self._model.geom_bodyid[geom])
        frame = _shift(-self._anchors[body]) @ _frame(model.geom_pos[geom], model.geom_quat[geom])
        collision = ET.SubElement(link, "collision")
        ET.SubElement(collision, "origin", _origin(frame))
        geometry, size = ET.SubElement(collision, "geometry"), model.geom_size[geom]
        match kinds(model.geom_type[geom]):
            case kinds.mjGEOM_BOX:
                ET.SubElement(geometry, "box", size=_words(2 * size))
            case kinds.mjGEOM_SPHERE:
                ET.SubElement(geometry, "sphere", radius=_words(size[:1]))
            case kinds.mjGEOM_CYLINDER:
                ET.SubElement(geometry, "cylinder", radius=_words(size[:1]), length=_words(2 * size[1:2]))
            case kinds.mjGEOM_CAPSULE | kinds.mjGEOM_ELLIPSOID as kind:
                name = f"{link.get('name')}_{'capsule' if kind == kinds.mjGEOM_CAPSULE else 'ellipsoid'}"
                ET.SubElement(geometry, "mesh", filename=self._file(name, _round_solid(kind, size)))
            case _:
                number = int(model.geom_dataid[geom])
                if number not in self._mesh_files:
                    self._mesh_files[number] = self._file(model.mesh(number).name, self._mesh(number))
                ET.SubElement(geometry, "mesh", filename=self._mesh_files[number])

    def _mesh(self, number: int) -> Mesh:
        """Return a mesh of the model, as MuJoCo scaled and moved it."""
        model, first, start = self._model, self._model.mesh_vertadr[number], self._model.mesh_faceadr[number]
        vertices = model.mesh_vert[first : first + model.mesh_vertnum[number]].astype(np.float64)
        return Mesh(vertices, model.mesh_face[start : start + model.mesh_facenum[number]].astype(np.int64))

    def _file(self, name: str, mesh: Mesh) -> str:
        """Write a mesh, and return its file's name, which is like `name`."""
        return add_file(self.meshes, re.sub(r"[^\w.-]+", "_", name), ".obj", parts_to_obj([mesh]))


def _round_solid(kind: Any, size: Floats) -> Mesh:
    """Return a capsule along z (`size`: radius, half length), or an ellipsoid (half axes) [m]."""
    import mujoco

    if kind == mujoco.mjtGeom.mjGEOM_ELLIPSOID:
        return hull(geodesic(1.0, ROUND_FREQUENCY).vertices * size)
    ball, end = geodesic(float(size[0]), ROUND_FREQUENCY).vertices, np.array([0.0, 0.0, size[1]])
    return hull(np.concatenate([ball + end, ball - end]))


def _new_name(taken: set[str], name: str) -> str:
    """Return a name like this one that is not taken, and take it."""
    free, number = name, 1
    while free in taken:
        free, number = f"{name}_{number}", number + 1
    taken.add(free)
    return free


def _frame(position: Floats, quaternion: Floats) -> Floats:
    """Return the frame (4, 4) of a position (3,) [m] and a unit quaternion (w, x, y, z)."""
    from scipy.spatial.transform import Rotation  # slow to import

    frame = _shift(position)
    frame[:3, :3] = Rotation.from_quat(quaternion, scalar_first=True).as_matrix()
    return frame


def _shift(place: Floats) -> Floats:
    frame = np.eye(4)
    frame[:3, 3] = place
    return frame


def _origin(frame: Floats) -> dict[str, str]:
    """Return the attributes of an `<origin>`; yaw is 0 where pitch is a right angle."""
    rotation, level = frame[:3, :3], float(np.hypot(frame[0, 0], frame[1, 0]))
    pitch = np.arctan2(-rotation[2, 0], level)
    if level > UPRIGHT:
        roll, yaw = np.arctan2(rotation[2, 1], rotation[2, 2]), np.arctan2(rotation[1, 0], rotation[0, 0])
    else:
        roll, yaw = np.arctan2(-rotation[2, 0] * rotation[0, 1], rotation[1, 1]), 0.0
    return {"xyz": _words(frame[:3, 3]), "rpy": _words([roll, pitch, yaw])}


def _words(values: Iterable[float]) -> str:
    return " ".join(repr(float(value) + 0.0) for value in values)
