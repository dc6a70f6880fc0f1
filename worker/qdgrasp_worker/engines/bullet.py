"""The one module that imports PyBullet: a world of its own, and the bodies in it.

Poses are of a body's root link; lengths are metres, quaternions xyzw. Numbers are passed as plain lists:
arrays take PyBullet twice as long to read.
"""

import ctypes
import os
import sys
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import partial
from inspect import isbuiltin
from pathlib import Path
from typing import Any

from qdgrasp_assets.scene import SceneGripper, SceneObject, Vector
from qdgrasp_protocol.errors import AssetError
from qdgrasp_worker.physical_episode import TABLE_HALF
from qdgrasp_worker.world import HAND_FRICTION, Quaternion, indices_by_name


@contextmanager
def quiet() -> Iterator[None]:
    """Keep output of C code on stdout and stderr off the console, for the whole process."""
    flush_streams()
    kept = [os.dup(stream) for stream in (1, 2)]
    nowhere = os.open(os.devnull, os.O_WRONLY)
    try:
        for stream in (1, 2):
            os.dup2(nowhere, stream)
        yield
    finally:
        flush_streams()  # C's buffered output must not appear later
        for stream, copy in zip((1, 2), kept, strict=True):
            os.dup2(copy, stream)
            os.close(copy)
        os.close(nowhere)


def flush_streams() -> None:
    """Write out the buffered output of Python and C."""
    for stream in (sys.stdout, sys.stderr):
        if stream is not None:
            stream.flush()
    ctypes.CDLL(None).fflush(None)


with quiet():
    import pybullet as pb

BASE = -1  # The index of a body's root link
BREAKING_THRESHOLD = 0.02
"""Bullet's default distance at which contacts begin and end, as a share of a shape's size."""
HAND_GROUP, OBJECT_GROUP, TABLE_GROUP = 1, 2, 4
"""Collision groups: an object meets hands, table and neighbours only; a hand meets itself on request."""
TABLE_AWAY = [0.0, 0.0, -20.0]  # Its place when unused, away from all bodies [m]
FIXED_URDF = """<robot name="fixed"><link name="fixed">
<inertial><mass value="0"/><inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial>
<collision><geometry>{geometry}</geometry></collision>
</link></robot>
"""
TABLE_GEOMETRY = f'<box size="{" ".join(str(2.0 * half) for half in TABLE_HALF)}"/>'
OBJECT_URDF = """<robot name="object"><link name="object">
<inertial><mass value="{mass!r}"/><inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial>
<collision><origin xyz="1e-9 0 0"/><geometry><mesh filename="parts.obj"/></geometry></collision>
</link></robot>
"""
"""Inertia and contacts as in the public code's runs, with the shape off the centre of mass.

Bullet takes the inertia from the collision shape, not from here. The offset of a nanometre keeps Bullet from
taking a single shape out of its compound: a bare hull of the rubiks cube has 5 % less inertia, other margins,
and other finger contacts in 6 % of poses.
"""


class Bullet:
    """PyBullet's functions and constants, with a world of their own.

    It has no gravity, and is set up so that the same calls give the same bits. Closing it twice is allowed.
    """

    def __init__(self) -> None:
        with quiet():
            self.client = pb.connect(pb.DIRECT)
        for name, function in vars(pb).items():
            if isbuiltin(function):
                setattr(self, name, partial(function, physicsClientId=self.client))
        self.resetSimulation(pb.RESET_USE_SIMPLE_BROADPHASE)
        # Meshes would be remembered by file name across worlds.
        self.setPhysicsEngineParameter(deterministicOverlappingPairs=1, enableFileCaching=0)

    def __getattr__(self, name: str) -> Any:
        return getattr(pb, name)

    def close(self) -> None:
        """Leave the world, and free it."""
        if self.client >= 0:
            pb.disconnect(physicsClientId=self.client)
            self.client = -1


class BulletBody:
    """A body that is loaded from a URDF with its meshes, without visual shapes.

    Its `body` is its index. Its inertias are those of its collision shapes. Its links pass through each
    other, or with `meets_itself` only those that a joint connects. All of them are of collision group
    `group`, and meet the groups in `mask`. An AssetError if Bullet cannot read it, or a mesh that it names.
    """

    def __init__(
        self,
        bullet: Bullet,
        urdf: str,
        meshes: Mapping[str, bytes],
        *,
        fixed: bool,
        group: int,
        mask: int,
        meets_itself: bool = False,
    ) -> None:
        self._bullet = bullet
        flags = pb.URDF_IGNORE_VISUAL_SHAPES
        if meets_itself:
            flags |= pb.URDF_USE_SELF_COLLISION | pb.URDF_USE_SELF_COLLISION_EXCLUDE_PARENT
        with tempfile.TemporaryDirectory(prefix="qdgrasp-") as name:
            file = write_body(Path(name).resolve(), urdf, meshes)
            try:
                with quiet():
                    self.body: int = bullet.loadURDF(str(file), useFixedBase=fixed, flags=flags)
            except pb.error as error:
                raise AssetError(f"Bullet cannot load a body or one of its meshes: {error}") from None
        self.collide(group, mask)

    def collide(self, group: int, mask: int) -> None:
        """Let all links be of collision group `group` and meet the groups in `mask` only."""
        for link in range(BASE, self._bullet.getNumJoints(self.body)):
            self._bullet.setCollisionFilterGroupMask(self.body, link, group, mask)

    @property
    def pose(self) -> tuple[Vector, Quaternion]:
        """Position [m] and quaternion of the root link, by its centre of mass."""
        pose: tuple[Vector, Quaternion] = self._bullet.getBasePositionAndOrientation(self.body)
        return pose

    def place(self, position: Sequence[float], quaternion: Sequence[float]) -> None:
        """Put the root link, by its centre of mass, at a pose."""
        self._bullet.resetBasePositionAndOrientation(self.body, position, quaternion)

    def inertia(self, link: int = BASE) -> tuple[float, Vector]:
        """The mass [kg] of a link, and its principal moments of inertia [kg m2]."""
        info = self._bullet.getDynamicsInfo(self.body, link)
        return info[0], info[2]

    def set_inertia(self, mass: float, moments: Sequence[float], link: int = BASE) -> None:
        """Set the mass [kg] and principal moments [kg m2] of a link; mass 0 fixes a root link."""
        self._bullet.changeDynamics(self.body, link, mass=mass)
        if mass:  # a change of mass alone makes new moments of the shape
            self._bullet.changeDynamics(self.body, link, localInertiaDiagonal=moments)

    def set_friction(self, lateral: float, rolling: float, spinning: float, link: int = BASE) -> None:
        """Set the friction coefficients of a link."""
        self._bullet.changeDynamics(
            self.body, link, lateralFriction=lateral, rollingFriction=rolling, spinningFriction=spinning
        )


def write_body(folder: Path, urdf: str, meshes: Mapping[str, bytes]) -> Path:
    """Write a URDF and its meshes into a folder; return its file."""
    for mesh, content in meshes.items():
        path = (folder / mesh).resolve()
        if folder not in path.parents:
            raise AssetError(f"A scene's meshes lie in its own folder, '{mesh}' does not.")
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(content)
    file = folder / "body.urdf"
    file.write_text(urdf, encoding="utf-8")
    return file


class HandBody(BulletBody):
    """A hand on its carrier, with Bullet's indices of its links and joints.

    An AssetError if a joint or link that the scene names is not in the URDF.
    """

    def __init__(self, bullet: Bullet, gripper: SceneGripper, *, meets_itself: bool = False) -> None:
        mask = OBJECT_GROUP | (HAND_GROUP if meets_itself else 0)
        super().__init__(
            bullet,
            gripper.urdf,
            gripper.meshes,
            fixed=True,
            group=HAND_GROUP,
            mask=mask,
            meets_itself=meets_itself,
        )
        infos = [bullet.getJointInfo(self.body, i) for i in range(bullet.getNumJoints(self.body))]
        self.links = [info[12].decode() for info in infos]
        """The names of all links but the root, by index; a link comes after the one that carries it."""
        self.parents = [info[16] for info in infos]
        """The index of the link that carries each."""
        self.moving = moving = {info[1].decode(): info[0] for info in infos if info[2] != pb.JOINT_FIXED}
        """The indices of the joints that move, by name."""
        self.joint_names = {index: name for name, index in moving.items()}
        self.carrier = indices_by_name("carrier joint", (joint.name for joint in gripper.carrier), moving)
        self.fingers = indices_by_name("joint", (joint.name for joint in gripper.joints), moving)
        named = {link: index for index, link in enumerate(self.links)}
        root = bullet.getBodyInfo(self.body)[0].decode()
        self.link_names = {BASE: root} | {index: name for name, index in named.items()}
        self.finger_links = frozenset(indices_by_name("finger link", gripper.finger_links, named))
        self.base_link = named[gripper.base_link]
        self.link_numbers = {named[name]: number for number, name in enumerate(gripper.links, start=1)}
        """The number of each link in rows, by its index."""
        indices = range(BASE, len(self.links))
        self.shaped_links = [i for i in indices if bullet.getCollisionShapeData(self.body, i)]
        others = sorted(set(moving.values()) - {*self.carrier, *self.fingers})
        self.joints = [*self.carrier, *others, *self.fingers]
        self.at_zero = [0.0] * (len(self.carrier) + len(others))
        """Places of all joints before the fingers."""

    def set_joints(self, joints: list[int], places: Sequence[float]) -> None:
        """Put joints at places [rad or m], at rest."""
        still = [[0.0]] * len(joints)
        self._bullet.resetJointStatesMultiDof(self.body, joints, [[place] for place in places], still)

    def positions(self, joints: list[int]) -> list[float]:
        """Positions of joints [m or rad]."""
        return [state[0] for state in self._bullet.getJointStates(self.body, joints)]


class ObjectBody(BulletBody):
    """An object, with its root link at its centre of mass; an AssetError if it cannot be loaded."""

    def __init__(self, bullet: Bullet, target: SceneObject) -> None:
        urdf, meshes = OBJECT_URDF.format(mass=target.mass), {"parts.obj": target.collision}
        super().__init__(bullet, urdf, meshes, fixed=False, group=OBJECT_GROUP, mask=HAND_GROUP)
        self.lateral_friction = target.lateral_friction
        self.frictions = target.rolling_friction, target.spinning_friction
        """Its own coefficients of rolling and spinning friction."""

    def damp(self, rate: float) -> None:
        """Let its velocity decay with this rate [1/s]."""
        self._bullet.changeDynamics(self.body, BASE, linearDamping=rate, angularDamping=rate)


def load_fixed(bullet: Bullet, parts: bytes = b"") -> BulletBody:
    """A body that stands still where it is placed: convex parts as one OBJ file, or a table."""
    urdf = FIXED_URDF.format(geometry='<mesh filename="parts.obj"/>' if parts else TABLE_GEOMETRY)
    mask = HAND_GROUP | OBJECT_GROUP
    body = BulletBody(bullet, urdf, {"parts.obj": parts}, fixed=True, group=TABLE_GROUP, mask=mask)
    body.set_friction(HAND_FRICTION, 0.0, 0.0)
    return body
