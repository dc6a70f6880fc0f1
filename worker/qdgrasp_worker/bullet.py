"""Thin typed access to PyBullet, without a decision of its own.

Evaluations reach PyBullet through this module alone; `replay.renderer` imports it too, for contacts in full
and for pictures. Poses are of a body's root link; contacts are those of the last collision detection.
Lengths are metres, quaternions xyzw. Arguments are plain lists: arrays take PyBullet twice as long to read.
"""

import ctypes
import os
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import NamedTuple

from qdgrasp_protocol.errors import AssetError


@contextmanager
def quiet() -> Iterator[None]:
    """Keep what C code prints on stdout and stderr off the console, for the whole process."""
    flush_streams()
    kept = [os.dup(stream) for stream in (1, 2)]
    nowhere = os.open(os.devnull, os.O_WRONLY)
    try:
        for stream in (1, 2):
            os.dup2(nowhere, stream)
        yield
    finally:
        flush_streams()  # what C has buffered must not come out later
        for stream, copy in zip((1, 2), kept, strict=True):
            os.dup2(copy, stream)
            os.close(copy)
        os.close(nowhere)


def flush_streams() -> None:
    """Write out what Python and C hold back."""
    for stream in (sys.stdout, sys.stderr):
        if stream is not None:
            stream.flush()
    ctypes.CDLL(None).fflush(None)


with quiet():
    import pybullet as pb

VERSION = version("pybullet")
STILL = [0.0, 0.0, 0.0]
UPRIGHT = [0.0, 0.0, 0.0, 1.0]
Vector = tuple[float, float, float]
Quaternion = tuple[float, float, float, float]
Box = tuple[Vector, Vector]  # Low and high corner
BASE = -1  # The index of a body's root link


@dataclass(frozen=True)
class Motor:
    """Gains and limits with which a joint is driven to a position."""

    force: float
    """The most it may push [N or Nm]."""
    max_velocity: float
    """[m/s or rad/s]."""
    position_gain: float = 0.1
    """Bullet's kp: this share of the error is made good in a step."""
    velocity_gain: float = 1.0
    """Bullet's kd."""


class BulletLink(NamedTuple):
    """A link with the joint that carries it; both have the same index."""

    joint: str
    link: str
    moves: bool


class Contact(NamedTuple):
    """A point where two bodies touch, or are about to."""

    link: int
    """The first body's link."""
    distance: float
    """Negative where they penetrate [m]."""


class ContactForce(NamedTuple):
    """A point where two bodies touch, with the force there in the last step."""

    link: int
    """The first body's link."""
    point: Vector
    """On the second body [m], world frame."""
    normal: Vector
    """Unit normal into the second body, world frame."""
    distance: float
    """Negative where they penetrate [m]."""
    force: float
    """Along the normal [N]."""


class Bullet:
    """A world of its own, without gravity, set up so that the same calls give the same bits."""

    def __init__(self) -> None:
        with quiet():
            self._client = pb.connect(pb.DIRECT)
        pb.resetSimulation(pb.RESET_USE_SIMPLE_BROADPHASE, physicsClientId=self._client)
        pb.setPhysicsEngineParameter(
            deterministicOverlappingPairs=1,
            enableFileCaching=0,  # meshes would be remembered by file name across worlds
            physicsClientId=self._client,
        )

    def close(self) -> None:
        """Leave the world, and free it. Closing twice is allowed."""
        if self._client >= 0:
            pb.disconnect(physicsClientId=self._client)
            self._client = -1

    def load(self, urdf: Path, *, fixed: bool) -> int:
        """Load a URDF without its visual shapes; its inertias are those of the collision shapes.

        An AssetError if Bullet cannot read it, or a mesh that it names.
        """
        flags = pb.URDF_IGNORE_VISUAL_SHAPES
        try:
            with quiet():
                body: int = pb.loadURDF(
                    str(urdf), useFixedBase=fixed, flags=flags, physicsClientId=self._client
                )
        except pb.error as error:
            raise AssetError(f"Bullet cannot load '{urdf.name}' or a mesh that it names: {error}") from None
        return body

    def links(self, body: int) -> list[BulletLink]:
        """All links but the root, by index."""
        count = pb.getNumJoints(body, physicsClientId=self._client)
        infos = [pb.getJointInfo(body, i, physicsClientId=self._client) for i in range(count)]
        return [BulletLink(info[1].decode(), info[12].decode(), info[2] != pb.JOINT_FIXED) for info in infos]

    def shaped_links(self, body: int) -> list[int]:
        """The links that have a collision shape, the root link among them."""
        links = range(BASE, pb.getNumJoints(body, physicsClientId=self._client))
        return [i for i in links if pb.getCollisionShapeData(body, i, physicsClientId=self._client)]

    def box(self, body: int, link: int) -> Box:
        """The axis-aligned box around a link's collision shapes [m]."""
        box: Box = pb.getAABB(body, link, physicsClientId=self._client)
        return box

    def collide(self, body: int, group: int, mask: int) -> None:
        """Let all links of a body be of collision group `group` and meet the groups in `mask` only."""
        for link in range(BASE, pb.getNumJoints(body, physicsClientId=self._client)):
            pb.setCollisionFilterGroupMask(body, link, group, mask, physicsClientId=self._client)

    def set_friction(self, body: int, lateral: float, rolling: float, spinning: float) -> None:
        """Set the friction coefficients of a body's root link."""
        pb.changeDynamics(
            body,
            BASE,
            lateralFriction=lateral,
            rollingFriction=rolling,
            spinningFriction=spinning,
            physicsClientId=self._client,
        )

    def place(self, body: int, position: Sequence[float], quaternion: Sequence[float]) -> None:
        """Put a body's root link, by its centre of mass, at a pose."""
        pb.resetBasePositionAndOrientation(body, position, quaternion, physicsClientId=self._client)

    def position(self, body: int) -> Vector:
        """The position of a body's root link, by its centre of mass [m]."""
        return self.pose(body)[0]

    def pose(self, body: int) -> tuple[Vector, Quaternion]:
        """Position [m] and quaternion of a body's root link, by its centre of mass."""
        pose: tuple[Vector, Quaternion] = pb.getBasePositionAndOrientation(body, physicsClientId=self._client)
        return pose

    def link_pose(self, body: int, link: int) -> tuple[Vector, Quaternion]:
        """Position [m] and quaternion of the frame of a link that is not the root."""
        state = pb.getLinkState(body, link, computeForwardKinematics=1, physicsClientId=self._client)
        return state[4], state[5]

    def halt(self, body: int) -> None:
        """Take a body's linear and angular velocity away."""
        pb.resetBaseVelocity(body, STILL, STILL, physicsClientId=self._client)

    def velocity(self, body: int) -> Vector:
        """The velocity of a body's root link, by its centre of mass [m/s]."""
        linear: Vector = pb.getBaseVelocity(body, physicsClientId=self._client)[0]
        return linear

    def set_joints(self, body: int, joints: list[int], positions: Sequence[float]) -> None:
        """Put joints at positions, at rest."""
        pb.resetJointStatesMultiDof(
            body,
            joints,
            [[position] for position in positions],
            [[0.0]] * len(joints),
            physicsClientId=self._client,
        )

    def joints(self, body: int, joints: list[int]) -> list[float]:
        """Positions of joints [m or rad]."""
        return [state[0] for state in pb.getJointStates(body, joints, physicsClientId=self._client)]

    def drive(self, body: int, joint: int, target: float, motor: Motor) -> None:
        """Command a joint to a position, from the next step on."""
        pb.setJointMotorControl2(
            body,
            joint,
            pb.POSITION_CONTROL,
            targetPosition=target,
            force=motor.force,
            maxVelocity=motor.max_velocity,
            positionGain=motor.position_gain,
            velocityGain=motor.velocity_gain,
            physicsClientId=self._client,
        )

    def detect(self) -> None:
        """Find the contacts of the poses as they are, without moving anything."""
        pb.performCollisionDetection(physicsClientId=self._client)

    def step(self) -> None:
        """Move on by 1/240 s."""
        pb.stepSimulation(physicsClientId=self._client)

    def touching(self, body: int, other: int) -> bool:
        """Return whether there is any contact between two bodies."""
        return bool(pb.getContactPoints(body, other, physicsClientId=self._client))

    def contacts(self, body: int, other: int) -> list[Contact]:
        """The contacts between two bodies."""
        points = pb.getContactPoints(body, other, physicsClientId=self._client)
        return [Contact(point[3], point[8]) for point in points]

    def contact_forces(self, body: int, other: int) -> list[ContactForce]:
        """The contacts between two bodies, with their forces."""
        points = pb.getContactPoints(body, other, physicsClientId=self._client)
        return [
            ContactForce(point[3], point[6], (-point[7][0], -point[7][1], -point[7][2]), point[8], point[9])
            for point in points
        ]
