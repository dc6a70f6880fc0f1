"""Reach of an arm: its joints at grasps, with a straight way of the open hand to each.

A grasp is reachable if damped least squares (Buss 2004, "Introduction to inverse kinematics") find joints
within their limits at the commanded pose, from one of a few starts, and from there at steps back along the
approach axis. No joint may jump from step to step, and no links of the arm may meet that are apart in the
middle of its range, nor a link what is around the object. pinocchio has the arm's model, its derivatives
and its collisions.
"""

from copy import copy
from pathlib import Path
from typing import Any

import numpy as np

from qdgrasp_assets.geometry.mesh import parse_parts
from qdgrasp_assets.geometry.rotation import Floats
from qdgrasp_assets.grippers.urdf import read_urdf
from qdgrasp_assets.scene import Scene
from qdgrasp_protocol.errors import InputError, UnknownName, check_packages
from qdgrasp_protocol.text import join_numbers
from qdgrasp_tools.export.grasp_table import MESH, Frame, GraspColumn

Pose6 = tuple[float, float, float, float, float, float]
"""x y z [m] and roll pitch yaw [rad] about fixed axes, as in a URDF."""
STARTS = 10  # Joints from which a grasp is looked for: the middle of their ranges, and others
ITERATIONS, DAMPING = 100, 1e-3
POSITION, ANGLE = 1e-4, 1e-3  # Most that the hand is off a pose [m, rad]
WAY_STEPS = 10
JUMP = 0.5  # Most that a joint moves from step to step [rad or m]


class Arm:
    """An arm that carries the hand, with its base at a pose in the object's `frame`.

    `flange` is the link that the hand is on, at `flange_to_hand`; None: the link `hand` if the arm has it,
    else its last one. Raises InputError if pinocchio is missing, the file is no URDF of an arm, or there is
    no such link.
    """

    def __init__(
        self, urdf: Path, frame: Frame, base: Pose6, hand: str, flange: str | None, flange_to_hand: Pose6
    ) -> None:
        check_packages("--arm", "pinocchio")
        import pinocchio as pin  # takes its time to load

        robot, self._pin, self.frame, self._urdf = read_urdf(urdf), pin, frame, urdf.name
        ends = sorted(set(robot.links) - {joint.parent for joint in robot.joints})
        flange = flange or (hand if hand in robot.links or len(ends) > 1 else ends[0])
        if flange not in robot.links:
            raise UnknownName("link of the arm", flange, robot.links, "Name that with the hand by --flange.")
        try:
            self._model = model = pin.buildModelFromUrdf(str(urdf))
        except (ValueError, RuntimeError) as error:
            raise InputError(f"No arm can be made of '{urdf}': {error}") from None
        self._data, self._flange = model.createData(), model.getFrameId(flange)
        self._base, self._hand = (
            pin.SE3(pin.rpy.rpyToMatrix(*pose[3:]), np.array(pose[:3])) for pose in (base, flange_to_hand)
        )
        carriers = list(model.supports[model.frames[self._flange].parentJoint])[1:]
        self._moving = [model.joints[number] for number in carriers]
        if not carriers:
            raise InputError(f"No joint of '{urdf}' moves its link '{flange}', on which the hand is.")
        self._names = ", ".join(model.names[number] for number in carriers)
        self.words = (
            f"{urdf.name}, base at x y z roll pitch yaw = {join_numbers(base)} in the object's frame, hand "
            f"at {join_numbers(flange_to_hand)} on its link '{flange}' [m, rad], joints {self._names}"
        )
        self._low, self._high = model.lowerPositionLimit, model.upperPositionLimit
        random = np.random.default_rng(0)
        starts = random.uniform(self._low, self._high, (STARTS, model.nq))
        starts[0] = (self._low + self._high) / 2
        starts[0, [joint.idx_q for joint in model.joints if joint.nq > joint.nv]] = 1  # cosines
        self._starts = [pin.normalize(model, start) for start in starts]
        self._solids = self._collision_model(urdf)
        self._known: dict[bytes, Floats] = {}

    def among(self, scene: Scene) -> "Arm":
        """Return the arm with the neighbours of a scene's object in its way.

        Raises InputError if there are some, and the files of the arm's shapes are missing.
        """
        if not scene.neighbours:
            return self
        if self._solids is None:
            raise InputError(
                f"Whether the arm of {self._urdf} meets what is around '{scene.object.name}' cannot be told: "
                "the meshes of its links are not where it names them; put them there."
            )
        pin, solids, made = self._pin, self._solids[0].copy(), copy(self)
        shift = np.array(scene.object.com_in_mesh) * (self.frame == MESH)
        moving = [place for place, link in enumerate(solids.geometryObjects) if link.parentJoint]
        for part in parse_parts(scene.neighbours.decode()):
            corners = pin.coal.StdVec_Vec3s()
            corners.extend([*(part.vertices + shift)])
            hull = pin.coal.Convex.convexHull(corners, True, "Qt")  # with its triangles
            body = pin.GeometryObject(f"neighbour {solids.ngeoms}", 0, self._base.inverse(), hull)
            place = solids.addGeometryObject(body)
            for link in moving:
                solids.addCollisionPair(pin.CollisionPair(link, place))
        made._solids, made._known = (solids, solids.createData()), {}
        return made

    def columns(self, poses: Floats, axis: Floats, distance: float) -> tuple[GraspColumn, ...]:
        """Return whether `way` reaches commanded poses (n, 7), and the joints (n, j) there."""
        joints = np.full((len(poses), len(self._moving)), np.nan)
        for place, pose in enumerate(poses):
            key = pose.tobytes() + axis.tobytes()
            if key not in self._known:
                self._known[key] = self.way(pose, axis, distance)[0]
            joints[place] = self._known[key]
        is_reached = np.asarray(~np.isnan(joints).any(axis=1))
        return (
            GraspColumn("reachable", is_reached, "whether the arm comes to its pose"),
            GraspColumn("arm_joints", joints, f"of the arm there: {self._names} [rad or m]"),
        )

    def way(self, pose: Floats, axis: Floats, distance: float) -> Floats:
        """Return the joints (`WAY_STEPS` + 1, j) from a commanded pose (7,) back on the way.

        The hand comes from `distance` [m] before the pose along its `axis` (3,). NaN where it does not.
        """
        target = self._base.inverse() * self._pin.XYZQUATToSE3(pose)
        offsets = np.linspace(0.0, distance, WAY_STEPS + 1)[:, None] * -axis
        for start in self._starts:
            if found := self._way_from(target, start, offsets):
                return np.array([self._positions(joints) for joints in found])
        return np.full((len(offsets), len(self._moving)), np.nan)

    def _way_from(self, target: Any, joints: Floats, offsets: Floats) -> list[Floats]:
        """Return joints (q,) at offsets of a pose in its own frame; empty: not at all of them."""
        found: list[Floats] = []
        for offset in offsets:
            following = self._solve(target * self._pin.SE3(np.eye(3), offset), found[-1] if found else joints)
            if following is None:
                return []
            if found and np.abs(self._pin.difference(self._model, found[-1], following)).max() > JUMP:
                return []
            found.append(following)
        return found

    def _solve(self, target: Any, joints: Floats) -> Floats | None:
        """Return joints (q,) that put the hand at a pose in the base's frame; None: none."""
        pin, model, data = self._pin, self._model, self._data
        flange = target * self._hand.inverse()
        for _ in range(ITERATIONS):
            pin.framesForwardKinematics(model, data, joints)
            error = pin.log6(data.oMf[self._flange].actInv(flange)).vector
            if np.linalg.norm(error[:3]) < POSITION and np.linalg.norm(error[3:]) < ANGLE:
                is_blocked = self._solids and pin.computeCollisions(model, data, *self._solids, joints, True)
                return None if is_blocked else joints
            slope = pin.computeFrameJacobian(model, data, joints, self._flange, pin.LOCAL)
            step = slope.T @ np.linalg.solve(slope @ slope.T + DAMPING * np.eye(6), error)
            joints = np.clip(pin.integrate(model, joints, step), self._low, self._high)
        return None

    def _positions(self, joints: Floats) -> Floats:
        """Return the joints that move the flange; of a cosine and sine the angle."""
        parts = [joints[joint.idx_q : joint.idx_q + joint.nq] for joint in self._moving]
        return np.array([part[0] if len(part) == 1 else np.arctan2(part[1], part[0]) for part in parts])

    def _collision_model(self, urdf: Path) -> Any:
        """Return the shapes whose pairs must not meet; None where their files are missing."""
        pin, folders = self._pin, [*map(str, urdf.absolute().parents[:2])]
        try:
            solids = pin.buildGeomFromUrdf(self._model, str(urdf), pin.COLLISION, None, folders)
        except (ValueError, RuntimeError):
            return None
        solids.addAllCollisionPairs()
        data, model = solids.createData(), self._model
        pairs = [(pair.first, pair.second) for pair in solids.collisionPairs]
        pin.computeCollisions(model, self._data, solids, data, self._starts[0], False)
        for pair, result in list(zip(pairs, data.collisionResults, strict=True)):
            one, other = sorted(solids.geometryObjects[place].parentJoint for place in pair)
            if result.isCollision() or model.parents[other] == one:
                solids.removeCollisionPair(pin.CollisionPair(*pair))
        return solids, solids.createData()
