"""Worlds of the protocols in MuJoCo.

The hand's root stays at the origin; the object is placed in the hand's frame. Before every evaluation
all of a model's state is reset, the start of its solver too.

- Where the hand is shaken each joint has a motor as in Bullet: a row of dry friction with the force of
  the motor as its limit. Between the halves of a step its reference is set to the acceleration that gives
  the joint the commanded velocity.
- `physical` has two models of a scene: while the fingers close the object is fixed, afterwards it is free.
  MuJoCo steps by itself from one look to the next. A finger's drive is an actuator whose target moves at the
  speed that is set at a look; `FingerControl` decides its end, as in Bullet.
"""

from abc import abstractmethod
from collections.abc import Sequence

import numpy as np
from scipy.spatial.transform import Rotation

from qdgrasp_assets.geometry.rotation import conjugate, facing, multiply, rotate, unit
from qdgrasp_assets.grippers.hand_geometry import neighbours
from qdgrasp_assets.scene import RestingPose, Scene, SceneGripper, Vector
from qdgrasp_worker.contact_margin import HULL_MARGIN
from qdgrasp_worker.decoder import HandPose
from qdgrasp_worker.engines.mujoco_model import DETECTION_GAP, SceneModel, reach_of
from qdgrasp_worker.engines.mujoco_simulation import Simulation
from qdgrasp_worker.evaluation_protocols import Physics, TrialSetup
from qdgrasp_worker.physical_episode import (
    NO_TABLE_UP,
    FingerControl,
    FingerDrive,
    PhysicalWorld,
    finger_drives,
    table_middle,
)
from qdgrasp_worker.world import (
    AWAY_POSITION,
    HAND_FRICTION,
    HOLD,
    STILL,
    UPRIGHT,
    Contact,
    GraspContact,
    GraspWorld,
    Quaternion,
    ShakenWorld,
    WorldState,
    free_postures,
    indices_by_name,
    seen_from,
)

TIME_STEP = 1 / 240  # Step where the hand is shaken [s]
BRAKE = 1.0  # Force of Bullet's motor of a joint that is not commanded [N or Nm]
LEAST_FORCE = 1e-9  # So a motor without force keeps its row [N or Nm]


class MujocoWorld(GraspWorld):
    """A hand at the world's origin and an object; an AssetError if the scene cannot be used."""

    sight = 2 * (HULL_MARGIN + DETECTION_GAP)
    free: Simulation
    """The model with a free object."""
    _now: Simulation

    def _prepare(self, scene: Scene, free: Simulation) -> None:
        gripper = scene.gripper
        self.free = self._now = free
        self._target = scene.object
        bodies = {free.model.body(i).name: i for i in range(free.model.nbody)}
        self.finger_links = frozenset(indices_by_name("finger link", gripper.finger_links, bodies))
        self.link_numbers = {bodies[name]: number for number, name in enumerate(gripper.links, start=1)}

    def close(self) -> None:
        """Do nothing: the models are freed with the world."""

    def base_pose(self) -> tuple[Sequence[float], Sequence[float]]:
        """Position [m] and quaternion of the hand's base link: the origin, where nothing carries it."""
        return STILL, UPRIGHT

    @abstractmethod
    def friction(self, trial: TrialSetup) -> tuple[float, float, float]:
        """Friction of hand and object: sliding, spinning [m], rolling [m]."""

    def reset(self, trial: TrialSetup, posture: Sequence[float]) -> None:
        """Put hand and object in place, at rest, without any state of earlier evaluations."""
        self.trial, self._friction = trial, self.friction(trial)
        self._posture = list(posture)
        self._now = self.free
        self._now.reset(posture, self._friction)
        self.place_hand(trial.pose)

    def place_hand(self, pose: HandPose) -> None:
        """Put the hand's base link at a pose: the object is moved, in the hand's frame."""
        back = conjugate(unit(np.array(pose.quaternion)))
        self.free.place(rotate(back, -np.array(pose.position)), back)
        self.free.detect()

    def set_fingers(self, posture: Sequence[float]) -> None:
        """Put the finger joints at `posture` [rad or m], at rest."""
        self._posture = list(posture)
        self._now.data.qpos[self._now.places] = posture

    def contacts(self) -> list[Contact]:
        """The contacts of the hand's links with the object."""
        return [Contact(link, distance) for _, link, distance in self._now.hand_contacts()]

    def state(self) -> WorldState:
        """The present places of all that can move, and contacts; the root is at the origin."""
        now = self._now
        return WorldState((STILL, UPRIGHT), now.joint_positions(), self.object_pose(), now.touches())

    def contact_forces(self) -> list[GraspContact]:
        """The contacts of the hand with the object that bear a force, or are about to.

        They were found before the last step: they belong to the pose that the object had then.
        """
        now, numbers = self._now, self.link_numbers
        seen = [(contact, numbers[link]) for contact, link, _ in now.hand_contacts() if link in numbers]
        found = [(number, *now.force(contact)) for contact, number in seen]
        return seen_from(now.data.xpos[now.object], now.data.xquat[now.object][[1, 2, 3, 0]], found)

    def object_pose(self) -> tuple[Vector, Quaternion]:
        """The object's position and quaternion, in the frame of the hand's root."""
        position, quaternion = self.free.object_pose()
        (x, y, z), (a, b, c, w) = position.tolist(), quaternion.tolist()
        return (x, y, z), (a, b, c, w)

    def finger_positions(self) -> list[float]:
        """The positions of the finger joints, in the gripper's order [rad or m]."""
        positions: list[float] = self._now.data.qpos[self._now.places].tolist()
        return positions


class MujocoShakenWorld(MujocoWorld, ShakenWorld):
    """A world whose joints have motors like Bullet's."""

    def __init__(self, scene: Scene) -> None:
        super().__init__(scene)
        self._scene = SceneModel(scene, TIME_STEP)
        self._prepare(scene, Simulation(self._scene, self._scene.shaken()))
        joints = [joint.name for joint in self._scene.robot.joints if joint.moves]
        self._row = {name: int(self.free.model.joint(name).dofadr[0]) for name in joints}
        """Row of each joint among the motors, which is its place among the hand's degrees of freedom."""
        n, data = len(joints), self.free.data
        self._motors = n
        self._at, self._velocity = data.qpos[:n], data.qvel[:n]
        self._goals, self._gains, self._damping, self._least, self._most = (np.zeros(n) for _ in range(5))

    def friction(self, trial: TrialSetup) -> tuple[float, float, float]:
        """Friction of hand and object, combined from both as in Bullet."""
        target = self._target
        rolling, spinning = trial.frictions or (target.rolling_friction, target.spinning_friction)
        lateral = trial.grip * target.lateral_friction
        return HAND_FRICTION * lateral, HAND_FRICTION * spinning, HAND_FRICTION * rolling

    def reset(self, trial: TrialSetup, posture: Sequence[float]) -> None:
        """Put hand and object in place, at rest; joints that are not commanded are braked."""
        super().reset(trial, posture)
        for each in (self._goals, self._gains, self._damping, self._least, self._most):
            each[:] = 0.0
        self.free.model.dof_frictionloss[: self._motors] = BRAKE

    def close_fingers(self, synergy: int) -> None:
        """Begin to close as in any engine, with joints coupled that close together."""
        super().close_fingers(synergy)
        self.free.couple(self.closing_joints(synergy))

    def drive(
        self, joint: str, target: float, force: float, velocity: float, gains: tuple[float, float] = HOLD
    ) -> None:
        """Command a joint to a place, with these limits, from the next step on."""
        row, (position_gain, velocity_gain) = self._row[joint], gains
        self._goals[row], self._least[row], self._most[row] = target, -velocity, velocity
        self._gains[row], self._damping[row] = position_gain / TIME_STEP, 1.0 - velocity_gain
        self.free.model.dof_frictionloss[row] = max(force, LEAST_FORCE)

    def step(self) -> None:
        """Move on by 1/240 s; a SimulationDiverged where the state is not to be trusted.

        A motor gives its joint the velocity gain (goal - position) / step + (1 - damping) velocity.
        """
        data, velocity = self.free.data, self._velocity
        self.free.begin_step()
        wanted = (self._goals - self._at) * self._gains + velocity * self._damping
        wanted = np.maximum(np.minimum(wanted, self._most), self._least)
        data.efc_aref[data.ne : data.ne + self._motors] = (wanted - velocity) / TIME_STEP
        self.free.end_step()
        self.steps += 1

    def contacts(self) -> list[Contact]:
        """The contacts of the hand's links with the object, up to a distance of 1 mm."""
        return [Contact(link, distance) for _, link, distance in self.free.hand_contacts(np.inf)]

    def base_pose(self) -> tuple[Vector, Quaternion]:
        """Position [m] and quaternion of the hand's base link."""
        joints = {name: float(self.free.data.qpos[row]) for name, row in self._row.items()}
        frame = self._scene.robot.forward(joints)[self._gripper.base_link]
        (x, y, z), (a, b, c, w) = frame[:3, 3], Rotation.from_matrix(frame[:3, :3]).as_quat()
        return (x, y, z), (a, b, c, w)


class MujocoPhysicalWorld(MujocoWorld, PhysicalWorld):
    """A world of `physical`."""

    def __init__(self, scene: Scene, physics: Physics, table: RestingPose | None = None) -> None:
        gripper = scene.gripper
        super().__init__(scene)
        self.physics, self.table, self.steps_at_once = physics, table, physics.look_every
        self.step_seconds = self.steps_at_once * physics.time_step
        self._up = table.up if table else NO_TABLE_UP
        model = SceneModel(scene, physics.time_step, has_table=table is not None)
        opened = {joint.name: joint.opened for joint in gripper.joints}
        reaches = [reach_of(model.robot, model.links, opened, joint) for joint in model.joints]
        self.drives = finger_drives(gripper, model.joints, reaches, physics.haste)
        self.is_coupled = gripper.jaw is not None
        self._control = FingerControl(self.drives, is_coupled=self.is_coupled)
        passing = passing_links(gripper, model, self.drives)
        self.fixed = Simulation(model, model.driven(self.drives, passing, is_free=False), is_free=False)
        """The model with a fixed object."""
        self._prepare(scene, Simulation(model, model.driven(self.drives, passing, is_free=True)))
        self.damping = physics.damping * np.array([*[scene.object.mass] * 3, *model.moments])
        """(6,): forces by which a released object's velocity is damped [N s/m, Nm s/rad]."""
        self.push_force = scene.object.mass * physics.weight
        """Force of each push [N]."""

    def friction(self, trial: TrialSetup) -> tuple[float, float, float]:
        """Friction of hand and object, which is the object's alone."""
        lateral, physics = trial.grip * self._target.lateral_friction, self.physics
        return lateral, trial.torsion * physics.spinning, physics.rolling

    def reset(self, trial: TrialSetup, posture: Sequence[float]) -> None:
        """Put hand, object and table in place, at rest, without any state of earlier evaluations."""
        super().reset(trial, posture)
        self._origin, self._turn = self.free.object_pose()
        self.lower_surroundings(0.0)

    def close_fingers(self, synergy: int) -> None:
        """Fix the object and begin to close; a ValueError for a synergy that the hand does not have."""
        self._closing = self.closing_joints(synergy)
        self._control.start(self._posture, self._closing, self.trial.preload)
        place = self.free.object_pose()
        self._now = self.fixed
        self._now.reset(self._posture, self._friction)
        self._now.place(*place)
        self._now.couple(self._closing)
        self.lower_surroundings(0.0)

    def release(self) -> None:
        """Release the object, damped; the targets of a jaw move on, others stay."""
        free, fixed = self.free, self.fixed
        place = free.object_pose()
        free.reset(fixed.data.qpos[fixed.places], self._friction)
        free.data.qvel[free.dofs] = fixed.data.qvel[fixed.dofs]
        free.place(*place)
        free.couple(self._closing)
        free.damp(self.damping)
        self._now = free
        self.lower_surroundings(0.0)
        if not self._control.is_coupled:
            self._control.stop()

    def disturb(self) -> None:
        """Stop all targets, and remove the damping of the object."""
        self._now.damp(0.0)
        self._control.stop()

    def push(self, direction: Vector) -> None:
        """Push the object with its weight, during the next steps, along a direction in hand frame."""
        self._now.data.xfrc_applied[self._now.object, :3] = np.multiply(direction, self.push_force)

    def weigh(self, factor: float) -> None:
        """Pull the object towards the table with `factor` times its weight, during the next steps."""
        along = rotate(self._turn, np.array(self._up))
        self._now.data.xfrc_applied[self._now.object, :3] = -factor * self.push_force * along

    def lower_surroundings(self, way: float) -> None:
        """Put table and neighbours, where there are any, `way` [m] below their places at first."""
        down = -way * rotate(self._turn, np.array(self._up))
        self._now.place_neighbours(self._origin + down, self._turn)
        if self.table is not None:
            middle = rotate(self._turn, np.array(table_middle(self.table, way)))
            self._now.place_table(self._origin + middle, multiply(self._turn, facing(self.table.up)))

    def is_on_table(self) -> bool:
        """Return whether the object touches the table."""
        return self._now.is_on_table()

    def step(self) -> None:
        """Simulate up to the next look, with moving targets of the fingers."""
        self._command()
        self._now.step(self.steps_at_once)
        self.steps += self.steps_at_once

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
        """Let the targets move, during the next steps, to their places at the next look."""
        seconds, data = self.step_seconds, self._now.data
        data.act[:] = self._control.targets
        data.ctrl[:] = (np.array(self._control.walk(self.finger_positions(), seconds)) - data.act) / seconds


def passing_links(
    gripper: SceneGripper, model: SceneModel, drives: Sequence[FingerDrive]
) -> set[tuple[str, str]]:
    """The pairs of links that pass through each other.

    They are disabled, neighbours, or touch while the hand is open.
    """
    pairs = neighbours(model.robot)
    known = model.links.keys()
    pairs |= {(one, other) for one, other in gripper.disabled_collisions if {one, other} <= known}
    simulation = Simulation(model, model.driven(drives, pairs, is_free=True))
    for posture in free_postures(gripper):
        simulation.reset(posture, (0.0, 0.0, 0.0))
        simulation.place(np.array(AWAY_POSITION), np.array(UPRIGHT))
        simulation.detect()
        pairs |= simulation.touching_links()
    return pairs
