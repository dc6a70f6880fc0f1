"""Typed access to PyBullet; decisions are made elsewhere.

The one module that imports PyBullet. Poses are of a body's root link; contacts are those of the last
collision detection. Lengths are metres, quaternions xyzw. Arguments are plain lists: arrays take PyBullet
twice as long to read.
"""

import ctypes
import os
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

from qdgrasp_assets.scene import Vector
from qdgrasp_protocol.errors import AssetError
from qdgrasp_worker.filters.contact_filter import Box
from qdgrasp_worker.world import STILL, Contact, Quaternion


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


@dataclass(frozen=True)
class Motor:
    """Gains and limits with which a joint is driven to a position."""

    force: float
    """Greatest force or torque [N or Nm]."""
    max_velocity: float
    """Greatest velocity [m/s or rad/s]."""
    position_gain: float = 0.1
    """Bullet's kp: the share of the error that a step corrects."""
    velocity_gain: float = 1.0
    """Bullet's kd."""


class BulletLink(NamedTuple):
    """A link with the joint that carries it; both have the same index."""

    joint: str
    link: str
    moves: bool
    slides: bool = False
    """True for a prismatic joint."""
    lower: float = 0.0
    """Lower limit of the joint in the URDF [m or rad]; there is none where it is above `upper`."""
    upper: float = 0.0
    parent: int = BASE
    """The index of the link that carries it."""


class ContactForce(NamedTuple):
    """A point where two bodies touch, with the force there in the last step."""

    link: int
    """The first body's link."""
    point: Vector
    """Place on the second body [m], world frame."""
    normal: Vector
    """Unit normal into the second body, world frame."""
    distance: float
    """Distance of the bodies [m]; negative where they penetrate."""
    force: float
    """Force along the normal [N]."""


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

    def set_stepping(self, time_step: float, iterations: int) -> None:
        """Set the length of a step [s], and how often the solver iterates in it."""
        pb.setPhysicsEngineParameter(
            fixedTimeStep=time_step, numSolverIterations=iterations, physicsClientId=self._client
        )

    def set_contact_recovery(self, share: float) -> None:
        """Set the share of a penetration that the solver corrects in a step."""
        pb.setPhysicsEngineParameter(contactERP=share, physicsClientId=self._client)

    def set_breaking_threshold(self, share: float) -> None:
        """Set the distance at which contacts begin, as a share of a shape's size, process-wide."""
        pb.setPhysicsEngineParameter(contactBreakingThreshold=share, physicsClientId=self._client)

    def load(self, urdf: Path, *, fixed: bool, meets_itself: bool = False) -> int:
        """Load a URDF without its visual shapes, with the inertias of its collision shapes.

        Its links pass through each other, or with `meets_itself` only those that a joint connects. An
        AssetError if Bullet cannot read it, or a mesh that it names.
        """
        flags = pb.URDF_IGNORE_VISUAL_SHAPES
        if meets_itself:
            flags |= pb.URDF_USE_SELF_COLLISION | pb.URDF_USE_SELF_COLLISION_EXCLUDE_PARENT
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
        return [
            BulletLink(
                info[1].decode(),
                info[12].decode(),
                info[2] != pb.JOINT_FIXED,
                info[2] == pb.JOINT_PRISMATIC,
                info[8],
                info[9],
                info[16],
            )
            for info in infos
        ]

    def root_link(self, body: int) -> str:
        """The name of a body's root link."""
        name: bytes = pb.getBodyInfo(body, physicsClientId=self._client)[0]
        return name.decode()

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

    def pass_through(self, body: int, link: int, other: int) -> None:
        """Let two links of a body pass through each other."""
        pb.setCollisionFilterPair(body, body, link, other, 0, physicsClientId=self._client)

    def set_friction(
        self, body: int, lateral: float, rolling: float, spinning: float, link: int = BASE
    ) -> None:
        """Set the friction coefficients of a body's link."""
        pb.changeDynamics(
            body,
            link,
            lateralFriction=lateral,
            rollingFriction=rolling,
            spinningFriction=spinning,
            physicsClientId=self._client,
        )

    def inertia(self, body: int, link: int = BASE) -> tuple[float, Vector]:
        """The mass [kg] of a link, and its principal moments of inertia [kg m2]."""
        info = pb.getDynamicsInfo(body, link, physicsClientId=self._client)
        return info[0], info[2]

    def set_inertia(self, body: int, mass: float, moments: Sequence[float], link: int = BASE) -> None:
        """Set the mass [kg] and principal moments [kg m2] of a link; mass 0 fixes a root link."""
        pb.changeDynamics(body, link, mass=mass, physicsClientId=self._client)
        if mass:  # a change of mass alone makes new moments of the shape
            pb.changeDynamics(body, link, localInertiaDiagonal=moments, physicsClientId=self._client)

    def set_damping(self, body: int, rate: float) -> None:
        """Let a body's velocity decay with this rate [1/s]."""
        pb.changeDynamics(body, BASE, linearDamping=rate, angularDamping=rate, physicsClientId=self._client)

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
        """Set a body's linear and angular velocity to zero."""
        pb.resetBaseVelocity(body, STILL, STILL, physicsClientId=self._client)

    def velocity(self, body: int) -> Vector:
        """The velocity of a body's root link, by its centre of mass [m/s]."""
        linear: Vector = pb.getBaseVelocity(body, physicsClientId=self._client)[0]
        return linear

    def push(self, body: int, force: Sequence[float], at: Sequence[float]) -> None:
        """Act on a body with a force [N] at a point [m], during the next step alone."""
        pb.applyExternalForce(body, BASE, force, at, pb.WORLD_FRAME, physicsClientId=self._client)

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

    def joint_motion(self, body: int, joints: list[int]) -> list[tuple[float, float]]:
        """Position [m or rad] and velocity [m/s or rad/s] of each joint."""
        return [state[:2] for state in pb.getJointStates(body, joints, physicsClientId=self._client)]

    def joint_place(self, body: int, joint: int) -> Vector:
        """The origin of the frame of a joint's link [m]."""
        place: Vector = pb.getLinkState(body, joint, physicsClientId=self._client)[4]
        return place

    def switch_motors_off(self, body: int, joints: list[int]) -> None:
        """Let joints move freely, except for torques of `apply_torques`."""
        pb.setJointMotorControlArray(
            body,
            joints,
            pb.VELOCITY_CONTROL,
            forces=[0.0] * len(joints),
            physicsClientId=self._client,
        )

    def apply_torques(self, body: int, joints: list[int], torques: list[float]) -> None:
        """Act on joints with forces or torques [N or Nm], during the next step alone."""
        pb.setJointMotorControlArray(
            body, joints, pb.TORQUE_CONTROL, forces=torques, physicsClientId=self._client
        )

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
        """Find the contacts at the present poses, without moving anything."""
        pb.performCollisionDetection(physicsClientId=self._client)

    def step(self) -> None:
        """Simulate one step, 1/240 s if not set otherwise."""
        pb.stepSimulation(physicsClientId=self._client)

    def touching(self, body: int, other: int) -> bool:
        """Return whether there is any contact between two bodies."""
        return bool(pb.getContactPoints(body, other, physicsClientId=self._client))

    def touching_links(self, body: int) -> set[tuple[int, int]]:
        """The pairs of a body's own links between which there is a contact."""
        points = pb.getContactPoints(body, body, physicsClientId=self._client)
        return {(point[3], point[4]) for point in points}

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
