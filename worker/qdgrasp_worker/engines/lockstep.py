"""Episodes of `physical` in lockstep: the worlds of a batch go through its phases together.

`PhysicalEpisode` simulates one pose after the other; here each phase is carried out for all poses of a batch,
and `BatchWorlds` steps the worlds that are still in it. The states of all worlds are arrays here, so that a
world that has ended costs no more steps, and no result depends on other worlds.

Decoding, filters and the placing of the open hand are those of `Evaluator`, in MuJoCo. Rows whose worlds
overflowed their buffers, or whose numbers are not finite, are evaluated there, too.
"""

from collections.abc import Callable, Sequence
from typing import NamedTuple, TypeAlias, cast

import numpy as np
from numpy.typing import NDArray

from qdgrasp_assets.genes import layout
from qdgrasp_assets.geometry.rotation import Floats, conjugate, dot, multiply, rotate, unit
from qdgrasp_assets.scene import Scene
from qdgrasp_protocol.rows import Outcome
from qdgrasp_worker.decoder import HandPose
from qdgrasp_worker.engines.mujoco_simulation import FREE_DOFS, Simulation
from qdgrasp_worker.engines.mujoco_world import MujocoPhysicalWorld
from qdgrasp_worker.episode import EpisodeResult, outcome_of, settled_pose
from qdgrasp_worker.evaluation_protocols import PUSHES, TrialSetup
from qdgrasp_worker.evaluator import Evaluator
from qdgrasp_worker.physical_episode import (
    OUT_OF_THE_WAY,
    REST_SPEED,
    REST_SPIN,
    RESTING_LOOKS,
    FingerControl,
    PhysicalEpisode,
)
from qdgrasp_worker.world import seen_from

Rows: TypeAlias = NDArray[np.intp]
"""Places (k,) of worlds among those of a batch, ascending."""
States: TypeAlias = dict[str, NDArray[np.generic]]
"""Arrays (n, ...) of n worlds, by their names in MuJoCo's data, and three more:

`force` (n, 3) on the object [N], `friction` (n, 3) of hand and object, `damping` (n, 6) of a free object.
"""
MOVING = ("qpos", "qvel", "act", "qacc_warmstart")
"""The states that a step changes."""


class WorldContacts(NamedTuple):
    """Contacts of hands with the object, nearer than `NEAR`, in the order of their worlds."""

    worlds: NDArray[np.intp]
    """(c,): the world of each contact, ascending."""
    links: NDArray[np.intp]
    """(c,): bodies of the hand."""
    distances: Floats
    """(c,): distances of the surfaces [m]; 0 where forces begin."""
    points: Floats
    """(c, 3): places on the object [m], world frame."""
    normals: Floats
    """(c, 3): unit normals into the object."""
    forces: Floats
    """(c,): forces along the normals [N]."""

    def of(self, world: int) -> "WorldContacts":
        """The contacts of one world."""
        first, last = np.searchsorted(self.worlds, [world, world + 1])
        return WorldContacts._make(column[first:last] for column in self)


class StepResult(NamedTuple):
    """Worlds after some steps."""

    states: States
    """The states of `MOVING`."""
    contacts: WorldContacts
    """Contacts that the last step found, at the poses before it."""
    object_poses: tuple[Floats, Floats]
    """Positions (n, 3) [m] and quaternions (n, 4) of the object at that time."""
    failed: NDArray[np.bool_]
    """(n,): True for worlds that are not to be trusted."""


class BufferSizes(NamedTuple):
    """Sizes of the buffers of worlds, or of their used parts."""

    contacts: int
    """`nconmax`: contacts of a world in the mean; also pairs of shapes that come near."""
    constraints: int
    """`njmax`: constraints of a world at most."""


BatchWorlds: TypeAlias = Callable[[States, int], StepResult]
"""Steps n worlds of one model of a scene together, by a number of steps."""


class FingerControls:
    """The control of n worlds of one hand at once, with the numbers of `FingerControl`."""

    def __init__(self, controls: Sequence[FingerControl]) -> None:
        self._opened, closed, lead, self._speed, self._rest_speed = (
            np.array([getattr(drive, name) for drive in controls[0].drives], dtype=np.float64)
            for name in ("opened", "closed", "lead", "speed", "rest_speed")
        )
        self._is_coupled = controls[0].is_coupled
        self._way = closed - self._opened
        self._ahead = np.array([[control.preload] for control in controls]) * lead
        ways = np.array([control.ways for control in controls], dtype=np.float64)
        self._senses, self._ends = ways[..., 0], ways[..., 1]
        self.targets = np.array([control.targets for control in controls], dtype=np.float64)
        """(n, j): target of each joint [m or rad]."""

    def stop(self) -> None:
        """Stop all targets."""
        self._senses[:] = 0.0

    def walk(self, rows: Rows, positions: Floats, seconds: float) -> Floats:
        """Advance the targets of these worlds by their joints' positions (k, j); return them (k, j)."""
        senses, targets = self._senses[rows], self.targets[rows]
        places = self._mean_places(senses, positions) if self._is_coupled else positions
        ahead = np.minimum(senses * targets + self._speed * seconds, senses * places + self._ahead[rows])
        ahead = np.minimum(ahead, senses * self._ends[rows])
        self.targets[rows] = walked = np.where(senses != 0.0, senses * ahead, targets)
        return walked

    def _mean_places(self, senses: Floats, positions: Floats) -> Floats:
        """Positions (k, j) of joints if each had gone the mean share of the moving ones."""
        total, moving = np.zeros(len(positions)), senses != 0.0
        for i in np.flatnonzero(moving.any(axis=0)):
            total += np.where(moving[:, i], (positions[:, i] - self._opened[i]) / self._way[i], 0.0)
        share = total / np.maximum(moving.sum(axis=1), 1)
        return np.asarray(self._opened + share[:, None] * self._way)

    def rests(self, before: Floats, after: Floats, seconds: float) -> NDArray[np.bool_]:
        """Return in which worlds no joint moved faster than at rest between two looks (n, j)."""
        return np.asarray((np.abs(after - before) < self._rest_speed * seconds).all(axis=1))


class LockstepEpisodes:
    """Episodes of some setups; `is_trusted` (n,) says which worlds were simulated well."""

    def __init__(
        self, world: MujocoPhysicalWorld, fixed: BatchWorlds, free: BatchWorlds, setups: Sequence[TrialSetup]
    ) -> None:
        self._world, self._physics = world, world.physics
        self._fixed, self._free = fixed, free
        self._setups, poses = setups, [setup.pose for setup in setups]
        self.is_trusted = np.ones(len(setups), dtype=bool)
        self._steps = np.zeros(len(setups), dtype=np.intp)
        self._joints = np.array([pose.joints for pose in poses], dtype=np.float64)
        self._turns = conjugate(unit(np.array([pose.quaternion for pose in poses])))
        self._places = rotate(self._turns, -np.array([pose.position for pose in poses]))
        self._friction = np.array([world.friction(setup) for setup in setups])

    def run(self) -> list[EpisodeResult]:
        """Close, release, read the grasp and push; results of untrusted worlds are invalid."""
        touched = self._close()
        results = [
            EpisodeResult(Outcome.BRUSHED if each else Outcome.MISSED, setup.pose.joints)
            for each, setup in zip(touched, self._setups, strict=True)
        ]
        grasps = self._settle(np.flatnonzero(touched & self.is_trusted))
        if region := self._world.allowed:
            for row in [row for row, grasp in grasps.items() if not region.holds(grasp.contacts)]:
                results[row] = grasps.pop(row)._replace(outcome=Outcome.BRUSHED)
        for row, survived in zip(grasps, self._push(np.array([*grasps], dtype=np.intp)), strict=True):
            outcome = outcome_of(survived, len(PUSHES))
            results[row] = grasps[row]._replace(outcome=outcome, fitness=survived)
        return [
            result._replace(steps=steps) for result, steps in zip(results, self._steps.tolist(), strict=True)
        ]

    def _start(self, simulation: Simulation) -> States:
        """Worlds at rest, with initial finger joints and the object's pose in the hand's frame."""
        n, model = len(self._setups), simulation.model
        sizes = {"qpos": model.nq, "qvel": model.nv, "act": model.na, "qacc_warmstart": model.nv}
        states: States = {name: np.zeros((n, size)) for name, size in (sizes | {"ctrl": model.nu}).items()}
        couplings = [
            simulation.coupled(self._world.closing_joints(setup.pose.synergy)) for setup in self._setups
        ]
        states["eq_active"] = np.array(couplings, dtype=bool).reshape(n, -1)
        states["force"], states["friction"] = np.zeros((n, 3)), self._friction
        states["qpos"][:, simulation.places] = self._joints
        turns = self._turns[:, [3, 0, 1, 2]]  # neighbours have the frame of the object as it was placed
        states["mocap_pos"] = np.repeat(self._places[:, None], model.nmocap, axis=1)
        states["mocap_quat"] = np.repeat(turns[:, None], model.nmocap, axis=1)
        if simulation is self._world.free:
            states["qpos"][:, -7:] = np.concatenate([self._places, turns], axis=1)
            states["damping"] = np.zeros((n, FREE_DOFS))
        else:
            states["damping"] = np.zeros((n, 0))
        return states

    def _started(self, setup: TrialSetup) -> FingerControl:
        control = FingerControl(self._world.drives, is_coupled=self._world.is_coupled)
        control.start(setup.pose.joints, self._world.closing_joints(setup.pose.synergy), setup.preload)
        return control

    def _close(self) -> NDArray[np.bool_]:
        """Close on the fixed object; return whether a finger touched it (n,)."""
        self._control = FingerControls([self._started(setup) for setup in self._setups])
        self._enter(self._fixed, self._world.fixed)
        touched = np.zeros(len(self._setups), dtype=bool)

        def look(rows: Rows, moved: StepResult) -> None:
            is_finger = np.isin(moved.contacts.links, [*self._world.finger_links])
            touched[rows[moved.contacts.worlds[is_finger]]] = True

        most = np.array([self._world.closing_steps(setup.pose.synergy) for setup in self._setups])
        self._step_to_rest(np.arange(len(touched)), most, look)
        return touched

    def _settle(self, rows: Rows) -> dict[int, EpisodeResult]:
        """Release the object and let it rest; return the grasps whose fingers still touch it."""
        speeds = self._states["qvel"][:, self._world.fixed.dofs]
        self._joints = self._finger_positions()
        self._enter(self._free, self._world.free)
        self._states["qvel"][:, self._world.free.dofs] = speeds
        self._states["damping"][:] = self._world.damping
        if not self._world.is_coupled:
            self._control.stop()
        last: dict[int, tuple[int, StepResult]] = {}

        def look(rows: Rows, moved: StepResult) -> None:
            last.update({row: (world, moved) for world, row in enumerate(rows.tolist())})

        self._step_to_rest(
            rows, np.full(len(self._setups), self._physics.steps(self._physics.settling)), look
        )
        grasps = {row: self._read(row, *last[row]) for row in rows.tolist() if self.is_trusted[row]}
        return {row: grasp for row, grasp in grasps.items() if grasp.finger_links}

    def _read(self, row: int, world: int, moved: StepResult) -> EpisodeResult:
        """Read a grasp after it has settled, `world` among those that moved last."""
        contacts = moved.contacts.of(world)
        position, quaternion = self._object_poses()
        now, numbers = conjugate(quaternion[row]), self._world.link_numbers
        origin, turn = (each[world] for each in moved.object_poses)
        found = [
            (numbers[link], point, normal, float(force))
            for _, link, _, point, normal, force in zip(*contacts, strict=True)
            if link in numbers
        ]
        return EpisodeResult(
            Outcome.DROPPED,
            self._finger_positions()[row].tolist(),
            len({*contacts.links.tolist()} & self._world.finger_links),
            max(0.0, float(-contacts.distances.min(initial=0.0))),
            settled=settled_pose((rotate(now, -position[row]), now), self._setups[row].pose),
            contacts=seen_from(origin, turn, found),
        )

    def _push(self, rows: Rows) -> list[int]:
        """Push the objects along their hands' axes; return how many pushes the hands withstand."""
        self._states["damping"][:] = 0.0
        self._states["mocap_pos"][:] = OUT_OF_THE_WAY
        self._control.stop()
        survived = np.zeros(len(self._setups), dtype=np.intp)
        most = np.full(len(survived), self._physics.steps(self._physics.push_time))
        lost = np.zeros(len(survived), dtype=bool)
        loads = np.array([[setup.load] for setup in self._setups])
        start = self._object_poses()

        def look(rows: Rows, moved: StepResult) -> None:
            touching = np.bincount(moved.contacts.worlds, minlength=len(rows)) > 0
            apart, angle = displacement(start, self._object_poses())
            is_far = (apart > self._physics.lost_distance) | (angle > self._physics.lost_angle)
            lost[rows] = is_far[rows] | ~touching

        held = rows
        for direction in PUSHES:
            self._states["force"][:] = np.multiply(direction, self._world.push_force) * loads
            self._step_to_rest(held, most, look, lost)
            held = held[~lost[held]]
            survived[held] += 1
        return [int(number) for number in survived[rows]]

    def _enter(self, worlds: BatchWorlds, simulation: Simulation) -> None:
        """Begin to step worlds of another model."""
        self._now, self._simulation, self._states = worlds, simulation, self._start(simulation)

    def _finger_positions(self) -> Floats:
        return np.asarray(self._states["qpos"][:, self._simulation.places], dtype=np.float64)

    def _object_poses(self) -> tuple[Floats, Floats]:
        """Positions (n, 3) and quaternions (n, 4) of the objects."""
        if self._simulation is self._world.fixed:
            return self._places, self._turns
        poses = np.asarray(self._states["qpos"][:, -7:], dtype=np.float64)
        return poses[:, :3].copy(), poses[:, [4, 5, 6, 3]]

    def _step_to_rest(
        self,
        rows: Rows,
        most: NDArray[np.intp],
        look: Callable[[Rows, StepResult], None],
        ended: NDArray[np.bool_] | None = None,
    ) -> None:
        """Step worlds until each rests, `most` (n,) steps at most, or has `ended` (n,) at a look."""
        every = self._physics.look_every
        seconds = every * self._physics.time_step
        resting, before = np.zeros(len(most), dtype=np.intp), None
        step = 0
        while True:
            now = self._finger_positions(), self._object_poses()
            if before is not None:
                apart, angle = displacement(before[1], now[1])
                rests = self._control.rests(before[0], now[0], seconds)
                rests &= (apart < REST_SPEED * seconds) & (angle < REST_SPIN * seconds)
                resting = np.where(rests, resting + 1, 0)
            before = now
            goes_on = (resting < RESTING_LOOKS) & (step < most) & self.is_trusted
            rows = rows[goes_on[rows] if ended is None else (goes_on & ~ended)[rows]]
            if not len(rows):
                return
            moved = self._advance(rows, every)
            look(rows, moved)
            step += every

    def _advance(self, rows: Rows, steps: int) -> StepResult:
        """Step worlds, with moving targets of their fingers."""
        states, seconds = self._states, steps * self._physics.time_step
        states["act"][rows] = started = self._control.targets[rows]
        walked = self._control.walk(rows, self._finger_positions()[rows], seconds)
        states["ctrl"][rows] = (walked - started) / seconds
        moved = self._now({name: values[rows] for name, values in states.items()}, steps)
        for name in MOVING:
            states[name][rows] = moved.states[name]
        self.is_trusted[rows[moved.failed]] = False
        self._steps[rows] += steps
        return moved


def displacement(before: tuple[Floats, Floats], after: tuple[Floats, Floats]) -> tuple[Floats, Floats]:
    """Distances (n,) [m] and angles (n,) [rad] between positions (n, 3) and quaternions (n, 4).

    The angle is not computed from the cosine, which near 1 is too coarse where quaternions were rounded to
    float32.
    """
    offsets, turn = after[0] - before[0], multiply(conjugate(before[1]), after[1])
    half = np.arctan2(np.sqrt(dot(turn, turn)), np.abs(turn[:, 3]))
    return np.sqrt(dot(offsets, offsets)), np.asarray(2.0 * half)


LEAST_BUFFERS, BUFFER_FACTOR = BufferSizes(32, 64), 2  # Least use, and factor from use to size
BUFFER_POSES, BUFFER_PRIOR = 128, "contact"  # Poses that are simulated to measure the use


def next_power(number: int) -> int:
    """The least power of two that is not below a number."""
    return 1 << (number - 1).bit_length()


class LockstepEvaluator(Evaluator):
    """Evaluates batches in worlds that `make_worlds` makes of a scene's models."""

    def __init__(
        self,
        scene: Scene,
        make_worlds: Callable[[Simulation, BufferSizes], BatchWorlds],
        *,
        shortcuts: bool = True,
    ) -> None:
        super().__init__(scene, shortcuts=shortcuts)
        self._mujoco = cast(MujocoPhysicalWorld, self._worlds[0])
        buffers = self._measured_buffers()
        models = self._mujoco.fixed, self._mujoco.free
        self._fixed, self._free = (make_worlds(model, buffers) for model in models)
        self.redone = 0
        """Rows that were evaluated again, one by one."""

    def _measured_buffers(self) -> BufferSizes:
        """Twice what poses use in MuJoCo, as powers of two; the same for the same scene."""
        genes = len(layout(self.scene, BUFFER_PRIOR))
        genomes = np.random.default_rng(0).uniform(-1.0, 1.0, (BUFFER_POSES, genes)).astype(np.float32)
        grasps = self._decoder(BUFFER_PRIOR)(genomes)
        episode = PhysicalEpisode(self._mujoco, self._protocol)
        most = LEAST_BUFFERS
        for i in np.flatnonzero(~grasps.dead_ends & grasps.are_finite).tolist():
            if episode.run(TrialSetup(grasps[i])).outcome is not Outcome.OVERLAP:
                used = self._mujoco.fixed.buffers_used, self._mujoco.free.buffers_used
                most = BufferSizes(*map(max, most, *used))
        return BufferSizes(*(next_power(BUFFER_FACTOR * number) for number in most))

    def _simulate(self, poses: dict[int, tuple[HandPose, int]]) -> dict[int, EpisodeResult | str]:
        """Return the results of poses in their trials, or the reasons of failures."""
        episode, results, setups = self._episode, {}, {}
        for row, pose in poses.items():
            placed = episode.place(self._protocol.trial(*pose))
            if isinstance(placed, EpisodeResult):
                results[row] = placed
            else:
                setups[row] = placed
        if setups:
            episodes = LockstepEpisodes(self._mujoco, self._fixed, self._free, [*setups.values()])
            simulated = zip(setups, episodes.run(), episodes.is_trusted, strict=True)
            results |= {row: result for row, result, is_trusted in simulated if is_trusted}
        self.redone += len(poses) - len(results)
        return {
            row: results[row] if row in results else self._simulate_one(*pose) for row, pose in poses.items()
        }
