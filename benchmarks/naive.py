"""The naive path: an evaluation as the public code calls the simulator (Huber et al. 2024, commit 0b8f8da).

Every pose is simulated: the overlap is tested by a step, all motors are commanded and all contacts are asked
for at each step, in numpy's numbers, and nothing ends early. Outcomes mean the same as in `Episode`. That
code's decoding of poses, which costs 1.6 to 35 ms more, is left out; its reading of a state file twice in
each evaluation, and its asking for contacts finger by finger, are in `PublishedEvaluator` alone.
"""

from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from numpy.typing import NDArray

from qdgrasp_assets.geometry.rotation import Floats
from qdgrasp_assets.scene import Scene
from qdgrasp_protocol.rows import Outcome
from qdgrasp_worker.decoder import DecodedGrasps, Decoder
from qdgrasp_worker.engines.bullet import Bullet, Motor, pb
from qdgrasp_worker.engines.bullet_world import HandBody, ObjectBody, finger_motor
from qdgrasp_worker.episode import outcome_of
from qdgrasp_worker.evaluation_protocols import CLOSING_STEPS, PROTOCOLS, TARGET_STEPS, Shake
from qdgrasp_worker.object_geometry import ObjectSurface
from qdgrasp_worker.world import STILL, UPRIGHT, closing_joints


class NaiveEvaluator:
    """A world of its own for one scene, until `close`."""

    def __init__(self, scene: Scene) -> None:
        self.scene = scene
        self._protocol = PROTOCOLS[scene.protocol]
        self._surface = ObjectSurface(scene)
        self._bullet = Bullet()
        self._client = self._bullet._client  # for calls that `Bullet` has no method for
        self._hand = HandBody(self._bullet, scene.gripper)
        self._target = ObjectBody(self._bullet, scene.object)
        self._bullet.set_friction(self._target.body, self._target.lateral_friction, *self._target.frictions)
        self._opened = np.array([joint.opened for joint in scene.gripper.joints])
        self._closing = closing_joints(scene.gripper)

    def close(self) -> None:
        self._bullet.close()

    def evaluate(self, prior: str, genomes: NDArray[np.float32]) -> NDArray[np.uint8]:
        """The outcomes (n,) of genomes (n, d)."""
        grasps = Decoder(self.scene, prior, self._surface)(genomes)
        return np.array([self._run(grasps, i) for i in range(len(grasps))], np.uint8)

    def _run(self, grasps: DecodedGrasps, i: int) -> Outcome:
        if grasps.dead_ends[i]:
            return Outcome.DEAD_END
        joints = grasps.joints[i].astype(np.float64)
        self._reset(grasps.positions[i], grasps.quaternions[i])
        if self._protocol.free_joints_first:
            self._set(self._hand.fingers, joints)
        pb.stepSimulation(physicsClientId=self._client)
        if any(point[8] < 0.0 for point in self._contacts()):
            return Outcome.OVERLAP
        if not self._protocol.free_joints_first:
            self._set(self._hand.fingers, joints)
        touched = self._close(int(grasps.synergies[i]))
        if not self._touching_fingers():
            return Outcome.BRUSHED if touched else Outcome.MISSED
        survived = sum(self._survives(shake) for shake in self._protocol.shakes)
        return outcome_of(survived, len(self._protocol.shakes))

    def _reset(self, position: NDArray[np.float32], quaternion: NDArray[np.float32]) -> None:
        carrier = [*self._hand.carrier, *self._hand.others]
        self._set(carrier, np.zeros(len(carrier)))
        self._set(self._hand.fingers, self._opened)
        body = self._target.body
        pb.resetBasePositionAndOrientation(body, STILL, UPRIGHT, physicsClientId=self._client)
        pb.resetBaseVelocity(body, STILL, STILL, physicsClientId=self._client)
        pb.resetBasePositionAndOrientation(
            self._hand.body, position, quaternion, physicsClientId=self._client
        )

    def _set(self, joints: Sequence[int], places: Floats) -> None:
        for joint, place in zip(joints, places, strict=True):
            pb.resetJointState(self._hand.body, joint, place, 0.0, physicsClientId=self._client)

    def _close(self, synergy: int) -> bool:
        touched = False
        for _ in range(CLOSING_STEPS):
            self._command(synergy)
            touched = bool(self._touching_fingers()) or touched
            pb.stepSimulation(physicsClientId=self._client)
        return touched

    def _command(self, synergy: int) -> None:
        gripper, closing = self.scene.gripper, self._closing[synergy]
        for index, held in zip(self._hand.carrier, gripper.carrier, strict=True):
            self._drive(index, np.float64(0.0), Motor(held.force, held.max_velocity))
        for index, joint in zip(self._hand.fingers, gripper.joints, strict=True):
            if joint.driven:
                goal = joint.closed if joint.name in closing else joint.opened
                self._drive(index, np.float64(goal), finger_motor(joint))

    def _drive(self, index: int, goal: np.float64, motor: Motor) -> None:
        self._bullet.drive(self._hand.body, index, goal, motor)

    def _survives(self, shake: Shake) -> bool:
        carrier = zip(self._hand.carrier, self.scene.gripper.carrier, strict=True)
        [(index, joint)] = [(index, joint) for index, joint in carrier if joint.shake == shake.joint]
        motor = Motor(joint.shake_force, joint.max_velocity, shake.position_gain, shake.velocity_gain)
        for target in shake.targets:
            for _ in range(TARGET_STEPS):
                self._drive(index, np.float64(target), motor)
                pb.stepSimulation(physicsClientId=self._client)
            if not self._contacts():
                return False
        return True

    def _contacts(self) -> Sequence[tuple[float, ...]]:
        return pb.getContactPoints(self._hand.body, self._target.body, physicsClientId=self._client)

    def _touching_fingers(self) -> set[float]:
        return {point[3] for point in self._contacts()} & self._hand.finger_links


class PublishedEvaluator(NaiveEvaluator):
    """The naive path with all that the public code's loop does, short of its wrapper around each call."""

    def __init__(self, scene: Scene) -> None:
        super().__init__(scene)
        self._set(self._hand.fingers, self._opened)
        self._folder = TemporaryDirectory()
        self._state = str(Path(self._folder.name) / "state.bullet")
        pb.saveBullet(self._state, physicsClientId=self._client)

    def close(self) -> None:
        self._folder.cleanup()
        super().close()

    def _reset(self, position: NDArray[np.float32], quaternion: NDArray[np.float32]) -> None:
        for _ in range(2):
            pb.restoreState(fileName=self._state, physicsClientId=self._client)
        pb.resetBasePositionAndOrientation(
            self._hand.body, position, quaternion, physicsClientId=self._client
        )

    def _touching_fingers(self) -> set[float]:
        hand, target = self._hand.body, self._target.body
        return {
            link
            for link in self._hand.finger_links
            if pb.getContactPoints(hand, target, linkIndexA=link, physicsClientId=self._client)
        }
