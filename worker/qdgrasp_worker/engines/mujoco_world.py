"""A world of `physical` in MuJoCo; the one module that imports it.

1. Two models of a scene: while the fingers close the object is fixed, afterwards it is free.
2. MuJoCo steps by itself from one look to the next. A finger's drive is an actuator whose target moves at
   the speed that is set at a look; where it walks to is `FingerControl`'s to say, as in Bullet.
3. Before every evaluation all of a model's state is reset, the start of its solver too.
"""

from collections.abc import Iterable, Sequence
from typing import Any

import mujoco
import numpy as np

from qdgrasp_assets.geometry.rotation import Floats, conjugate, rotate, unit
from qdgrasp_assets.scene import Scene, SceneGripper, Vector
from qdgrasp_protocol.errors import AssetError
from qdgrasp_worker.decoder import HandPose
from qdgrasp_worker.engines.mujoco_model import OBJECT, SceneModel, reach_of
from qdgrasp_worker.evaluation_protocols import Physics, TrialSetup
from qdgrasp_worker.finger_drive import FingerControl, FingerDrive
from qdgrasp_worker.hand_geometry import free_posture, neighbours
from qdgrasp_worker.physical_episode import PhysicalWorld
from qdgrasp_worker.world import (
    AWAY_POSITION,
    FREE_POSTURES,
    NEAR,
    UPRIGHT,
    Contact,
    GraspContact,
    HandFrame,
    Quaternion,
    indices_by_name,
)

FREE_DOFS = 6
mujoco.set_mju_user_warning(lambda _text: None)  # counted in `Simulation.step`; else a file is written


class SimulationDiverged(RuntimeError):
    """MuJoCo met numbers that are not finite, or had no room for its contacts."""


class Simulation:
    """A model of a scene with its state; MuJoCo's own quaternions are wxyz."""

    def __init__(
        self,
        scene: SceneModel,
        drives: Sequence[FingerDrive],
        passing: Iterable[tuple[str, str]],
        *,
        is_free: bool,
    ) -> None:
        try:
            self.model: Any = mujoco.MjModel.from_xml_string(scene.text(drives, passing, is_free=is_free))
        except ValueError as error:
            raise AssetError(f"MuJoCo cannot take this hand with this object: {error}") from None
        self.data: Any = mujoco.MjData(self.model)
        joints = [self.model.joint(joint.name) for joint in scene.joints]
        self.places = np.array([joint.qposadr[0] for joint in joints])
        """(j,): of the finger joints in `qpos`."""
        self.dofs = np.array([joint.dofadr[0] for joint in joints])
        """(j,): of the finger joints in `qvel`."""
        self.object = int(self.model.body(OBJECT).id)
        self._is_free = is_free
        self._couplings = scene.couplings
        self.is_object = self.model.geom_bodyid == self.object
        self.of_object = np.flatnonzero(self.is_object)
        self._force = np.zeros(6)

    def reset(self, posture: Sequence[float], friction: Sequence[float]) -> None:
        """Reset all; the fingers are at `posture`.

        `friction` is that of hand and object: sliding, spinning, rolling.
        """
        mujoco.mj_resetData(self.model, self.data)
        self.model.geom_friction[self.of_object] = friction
        self.damp(0.0)
        self.data.qpos[self.places] = posture

    def damp(self, rate: Floats | float) -> None:
        """Damp the free object's velocity with these forces [N s/m, Nm s/rad]."""
        if self._is_free:
            self.model.dof_damping[-FREE_DOFS:] = rate

    def couple(self, closing: Sequence[str]) -> None:
        """Couple the joints of a jaw that close, and no others."""
        self.data.eq_active[:] = self.coupled(closing)

    def coupled(self, closing: Sequence[str]) -> list[bool]:
        """Return which of the couplings hold while these joints close."""
        return [{coupling.joint, coupling.leader} <= {*closing} for coupling in self._couplings]

    def place(self, position: Floats, quaternion: Floats) -> None:
        """Put the object at a position (3,) [m] and quaternion (4,)."""
        pose = np.array([*position, quaternion[3], *quaternion[:3]])
        if self._is_free:
            self.data.qpos[-7:] = pose
        else:
            self.data.mocap_pos[0], self.data.mocap_quat[0] = pose[:3], pose[3:]

    def object_pose(self) -> tuple[Floats, Floats]:
        """Position (3,) [m] and quaternion (4,) of the free object."""
        pose = self.data.qpos[-7:]
        return pose[:3].copy(), pose[[4, 5, 6, 3]]

    def detect(self) -> None:
        """Find the contacts of the poses as they are."""
        mujoco.mj_fwdPosition(self.model, self.data)

    def step(self, steps: int) -> None:
        """Move on by some steps; a SimulationDiverged where the state is not to be trusted."""
        mujoco.mj_step(self.model, self.data, steps)
        if self.data.warning.number.any():
            raise SimulationDiverged(f"MuJoCo warned: {self.data.warning.number.tolist()}")

    @property
    def buffers_used(self) -> tuple[int, int]:
        """The most contacts, and constraints, that there were at a time since it was reset."""
        return int(self.data.maxuse_con), int(self.data.maxuse_efc)

    def hand_contacts(self) -> list[tuple[int, int, float]]:
        """Number, body of the hand and distance [m] of each contact with the object.

        They are nearer than `NEAR`; the distance is 0 where forces begin.
        """
        data, model = self.data, self.model
        if not data.ncon:
            return []
        contact = data.contact
        distance = contact.dist - contact.includemargin
        geoms = contact.geom
        is_object = self.is_object[geoms]
        chosen = np.flatnonzero((distance < NEAR) & is_object.any(axis=1))
        links = model.geom_bodyid[np.where(is_object[:, 0], geoms[:, 1], geoms[:, 0])]
        return [(i, int(links[i]), float(distance[i])) for i in chosen.tolist()]

    def force(self, contact: int) -> tuple[Floats, Floats, float]:
        """Point (3,) on the object, unit normal (3,) into it, and force along it [N]; world frame."""
        found = self.data.contact[contact]
        mujoco.mj_contactForce(self.model, self.data, contact, self._force)
        normal = found.frame[:3] * (-1.0 if self.is_object[found.geom[0]] else 1.0)
        return found.pos + normal * found.dist / 2, normal, float(self._force[0])

    def touching_links(self) -> set[tuple[str, str]]:
        """The pairs of the hand's links between which there is a contact."""
        bodies = self.model.geom_bodyid[self.data.contact.geom].tolist()
        return {(self.model.body(one).name, self.model.body(other).name) for one, other in bodies}


class MujocoWorld(PhysicalWorld):
    """A hand at the world's origin and an object; an AssetError if the scene cannot be taken."""

    def __init__(self, scene: Scene, physics: Physics) -> None:
        gripper = scene.gripper
        super().__init__(gripper)
        self.physics, self.steps_at_once = physics, physics.look_every
        model = SceneModel(scene, physics.time_step)
        self.drives, self.is_coupled = finger_drives(gripper, model, physics), gripper.jaw is not None
        self._control = FingerControl(self.drives, is_coupled=self.is_coupled)
        passing = passing_links(gripper, model, self.drives)
        self.fixed = Simulation(model, self.drives, passing, is_free=False)
        self.free = Simulation(model, self.drives, passing, is_free=True)
        self._now = self.free
        mass, self._lateral_friction = scene.object.mass, scene.object.lateral_friction
        self.damping = physics.damping * np.array([*[mass] * 3, *model.moments])
        """(6,): forces by which a released object's velocity is damped [N s/m, Nm s/rad]."""
        self.push_force = mass * physics.weight
        """Of each push [N]."""
        bodies = {self.free.model.body(i).name: i for i in range(self.free.model.nbody)}
        self.finger_links = frozenset(indices_by_name("finger link", gripper.finger_links, bodies))
        self.link_numbers = {bodies[name]: number for number, name in enumerate(gripper.links, start=1)}

    def close(self) -> None:
        """Do nothing: the models are freed with the world."""

    def reset(self, trial: TrialSetup, posture: Sequence[float]) -> None:
        """Put hand and object in place, at rest, with nothing left of what happened before."""
        self._friction = self.friction(trial)
        self._posture = list(posture)
        self._now = self.free
        self._now.reset(posture, self._friction)
        self.place_hand(trial.pose)

    def friction(self, trial: TrialSetup) -> tuple[float, float, float]:
        """The friction of hand and object in a trial: sliding, spinning, rolling."""
        return trial.grip * self._lateral_friction, self.physics.spinning, self.physics.rolling

    def place_hand(self, pose: HandPose) -> None:
        """Put the hand's base link at a pose: the object comes to where the hand sees it."""
        back = conjugate(unit(np.array(pose.quaternion)))
        self.free.place(rotate(back, -np.array(pose.position)), back)
        self.free.detect()

    def set_fingers(self, posture: Sequence[float]) -> None:
        """Put the finger joints at `posture` [rad or m], at rest."""
        self._posture = list(posture)
        self._now.data.qpos[self._now.places] = posture

    def close_fingers(self, synergy: int) -> None:
        """Fix the object and begin to close; a ValueError for a synergy that the hand does not have."""
        self._closing = self.closing_joints(synergy)
        self._control.start(self._posture, self._closing)
        place = self.free.object_pose()
        self._now = self.fixed
        self._now.reset(self._posture, self._friction)
        self._now.place(*place)
        self._now.couple(self._closing)

    def release(self) -> None:
        """Let the object go, damped; the targets of a jaw go on, others stay."""
        free, fixed = self.free, self.fixed
        place = free.object_pose()
        free.reset(fixed.data.qpos[fixed.places], self._friction)
        free.data.qvel[free.dofs] = fixed.data.qvel[fixed.dofs]
        free.place(*place)
        free.couple(self._closing)
        free.damp(self.damping)
        self._now = free
        if not self._control.is_coupled:
            self._control.stop()

    def begin_pushes(self) -> None:
        """Let all targets stay, and take the damping off the object."""
        self._now.damp(0.0)
        self._control.stop()

    def push(self, direction: Vector) -> None:
        """Push the object with its weight, during the next steps, along a direction in hand frame."""
        self._now.data.xfrc_applied[self._now.object, :3] = np.multiply(direction, self.push_force)

    def step(self) -> None:
        """Move on to the next look, with the targets of the fingers on their way."""
        self._command()
        self._now.step(self.steps_at_once)

    def closing(self, posture: Sequence[float], synergy: int) -> list[list[float]]:
        """The finger joints [rad or m] while they close on nothing: before, and after each step."""
        self.reset(self._away, posture)
        course = [self.finger_positions()]
        for _ in self.steps_of_closing(synergy):
            self._command()
            for _ in range(self.steps_at_once):
                self._now.step(1)
                course.append(self.finger_positions())
        return course

    def _command(self) -> None:
        """Let the targets walk, during the next steps, to where they are to be then."""
        seconds, data = self.steps_at_once * self.physics.time_step, self._now.data
        data.act[:] = self._control.targets
        data.ctrl[:] = (np.array(self._control.walk(self.finger_positions(), seconds)) - data.act) / seconds

    def is_touching(self) -> bool:
        """Return whether any link of the hand touches the object."""
        return bool(self._now.hand_contacts())

    def contacts(self) -> list[Contact]:
        """The contacts of the hand's links with the object."""
        return [Contact(link, distance) for _, link, distance in self._now.hand_contacts()]

    def contact_forces(self) -> list[GraspContact]:
        """The contacts of the hand with the object that bear a force, or are about to.

        They were found before the last step: they go with the pose that the object had then.
        """
        now, found = self._now, []
        origin = now.data.xpos[now.object].copy()
        back = conjugate(now.data.xquat[now.object][[1, 2, 3, 0]])
        for contact, link, _ in now.hand_contacts():
            if link in self.link_numbers:
                point, normal, force = now.force(contact)
                point, normal = rotate(back, point - origin), rotate(back, normal)
                found.append(GraspContact(self.link_numbers[link], point.tolist(), normal.tolist(), force))
        return found

    def hand_pose(self) -> HandFrame:
        """The hand's base link in the object's frame, as both are now."""
        origin, turn = (np.array(part) for part in self.object_pose())
        back = conjugate(turn)
        return rotate(back, -origin), back

    def object_pose(self) -> tuple[Vector, Quaternion]:
        """The object's position and quaternion; the hand does not move."""
        position, quaternion = self.free.object_pose()
        (x, y, z), (a, b, c, w) = position.tolist(), quaternion.tolist()
        return (x, y, z), (a, b, c, w)

    def finger_positions(self) -> list[float]:
        """The positions of the finger joints, in the gripper's order [rad or m]."""
        positions: list[float] = self._now.data.qpos[self._now.places].tolist()
        return positions


def finger_drives(gripper: SceneGripper, model: SceneModel, physics: Physics) -> list[FingerDrive]:
    """The drives of the finger joints, in the gripper's order."""
    opened = {joint.name: joint.opened for joint in gripper.joints}
    return [
        FingerDrive.of(
            joint,
            reach_of(model.robot, model.links, opened, found),
            slides=found.kind == "prismatic",
            limits=(found.lower, found.upper),
            in_jaw=gripper.jaw is not None,
            haste=physics.haste,
        )
        for joint, found in zip(gripper.joints, model.joints, strict=True)
    ]


def passing_links(
    gripper: SceneGripper, model: SceneModel, drives: Sequence[FingerDrive]
) -> set[tuple[str, str]]:
    """The pairs of links that pass through each other.

    They are disabled, neighbours, or touch while the hand is open.
    """
    pairs = neighbours(model.robot)
    known = model.links.keys()
    pairs |= {(one, other) for one, other in gripper.disabled_collisions if {one, other} <= known}
    simulation = Simulation(model, drives, pairs, is_free=True)
    for i in range(FREE_POSTURES if gripper.free_joints else 1):
        simulation.reset(free_posture(gripper, i / (FREE_POSTURES - 1)), (0.0, 0.0, 0.0))
        simulation.place(np.array(AWAY_POSITION), np.array(UPRIGHT))
        simulation.detect()
        pairs |= simulation.touching_links()
    return pairs
