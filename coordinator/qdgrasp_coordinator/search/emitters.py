"""Emitters propose poses: from the object's surface, or from grasps that hold.

New in this project, but for the priors of the surface, which are the paper's (Huber et al. 2024, III-A).
"""

from typing import Protocol

import numpy as np

from qdgrasp_assets.genes import layout
from qdgrasp_assets.geometry.object_surface import ObjectSurface, cross
from qdgrasp_assets.geometry.rotation import Floats, dot, multiply, rotate, unit
from qdgrasp_assets.priors import PRIORS
from qdgrasp_assets.scene import Scene
from qdgrasp_coordinator.search.grasp_map import GraspMap, Proposals
from qdgrasp_protocol.rows import GIVEN, Gene

SYNERGY = "synergy"


class Emitter(Protocol):
    """Proposes poses to try; what holds of any emitter is in the map that all of them read."""

    def propose(self, n: int, generator: np.random.Generator) -> Proposals:
        """Return some poses, `n` or more of them if it can; none where it has nothing to build on."""


SURFACE_DRAWS = 8  # Draws for each pose asked: most stand for no pose, or for one in a cell that is held


class SurfaceEmitter:
    """Draws of a prior: fingers on opposite points, or a palm that faces the surface."""

    def __init__(self, scene: Scene, prior: str, surface: ObjectSurface) -> None:
        self._hand, self._surface = scene.gripper, surface
        self._prior, self._layout = PRIORS[prior], layout(scene, prior)
        self._own = len(self._layout) - len(posture_genes(scene))
        self._axis = np.array([scene.gripper.approach_axis])

    def propose(self, n: int, generator: np.random.Generator) -> Proposals:
        """Return the poses of uniform genomes."""
        genomes = generator.uniform(-1.0, 1.0, (SURFACE_DRAWS * n, len(self._layout))).astype(np.float32)
        values = self._layout.values(genomes)
        found = self._prior.poses(values[:, : self._own], self._surface, self._hand)
        (alive,) = np.nonzero(~found.dead_ends)
        poses = np.concatenate([found.positions, found.quaternions, values[:, self._own :]], axis=1)[alive]
        if self._hand.synergies:
            poses[:, 7] = np.rint(poses[:, 7])
        approach = rotate(poses[:, 3:7], np.repeat(self._axis, len(poses), axis=0))
        ways = dot(found.surface_points[alive] - poses[:, :3], approach)
        return Proposals(poses.astype(np.float32), poses[:, :3] + ways[:, None] * approach)


MOST_TURN = 0.5 * np.pi  # Greatest turn [rad]


class RotationEmitter:
    """Grasps that hold, turned about the line along which their fingers press."""

    def __init__(self, known: GraspMap) -> None:
        self._map = known

    def propose(self, n: int, generator: np.random.Generator) -> Proposals:
        """Return grasps at random, turned by up to a quarter turn: the contacts stay where they are."""
        known, count = self._map, 4 * n
        if not len(known):
            return Proposals(np.zeros((0, known.genomes.shape[1]), np.float32), np.zeros((0, 3)))
        chosen = generator.integers(len(known), size=count)
        halves = generator.uniform(-0.5 * MOST_TURN, 0.5 * MOST_TURN, count)[:, None]
        turns = np.concatenate([np.sin(halves) * known.lines[chosen], np.cos(halves)], axis=1)
        poses, middles = known.genomes[chosen], known.middles[chosen]
        poses[:, :3] = middles + rotate(turns, poses[:, :3] - middles)
        poses[:, 3:7] = multiply(turns, poses[:, 3:7])
        return Proposals(poses.astype(np.float32), middles)


SPREAD = 0.004  # Half of the share of a cell in which a hand is put, and scatter of what it looks at [m]
ROLL_SIGMA = 0.1  # rad
SYNERGY_REDRAW = 0.15  # The probability that a synergy is drawn anew
JOINT_SIGMA = 0.025  # Scatter of a free joint, in its range
LOOKED_AT = 16  # Cells for each pose asked: from some no parent can reach what it holds
CHANCE = 0.3  # Exponent of chance in the order of cells


class NeighbourEmitter:
    """Grasps that hold, moved into open cells beside theirs; they look at the same contacts."""

    def __init__(self, scene: Scene, known: GraspMap) -> None:
        self._map = known
        self._axis, self._reach = np.array([scene.gripper.approach_axis]), scene.gripper.reach
        self._posture = posture_genes(scene)

    def propose(self, n: int, generator: np.random.Generator) -> Proposals:
        """Return a pose in each of the `n` open cells with the most held neighbours for their tries."""
        known = self._map
        (beside,) = np.nonzero((known.neighbours > 0) & known.grid.inside)
        open_ = beside[known.worth_many_tries(beside)]
        worth = (known.neighbours[open_] + 0.5) / (known.tries[open_] + 1.0)
        order = np.argsort(-worth * generator.random(len(open_)) ** CHANCE, kind="stable")
        chosen = open_[order[: LOOKED_AT * n]]
        around = known.elite_of[known.grid.around(chosen)]
        ways = (
            known.middles[around] - known.grid.middles(chosen)[:, None]
            if len(known)
            else np.zeros((0, 26, 3))
        )
        is_parent = (around >= 0) & (dot(ways, ways) <= self._reach**2)
        (reached,) = np.nonzero(is_parent.any(axis=1))
        chosen, around = chosen[reached[:n]], around[reached[:n]]
        picks = np.where(is_parent[reached[:n]], generator.random(around.shape), -1.0).argmax(axis=1)
        parents = around[np.arange(len(chosen)), picks]
        poses, middles = known.genomes[parents], known.middles[parents]
        approach = rotate(poses[:, 3:7], np.repeat(self._axis, len(poses), axis=0))
        ahead = np.maximum(dot(middles - poses[:, :3], approach), 0.01)
        aims = poses[:, :3] + ahead[:, None] * approach + generator.normal(0.0, SPREAD, (len(poses), 3))
        poses[:, :3] = known.grid.middles(chosen) + generator.uniform(-SPREAD, SPREAD, (len(poses), 3))
        ways = unit(aims - poses[:, :3])
        halves = generator.normal(0.0, ROLL_SIGMA, len(poses))[:, None] / 2.0
        rolled = np.concatenate([np.sin(halves) * ways, np.cos(halves)], axis=1)
        poses[:, 3:7] = unit(multiply(rolled, multiply(shortest_turns(approach, ways), poses[:, 3:7])))
        self._vary(poses, generator)
        return Proposals(poses.astype(np.float32), middles)

    def _vary(self, poses: Floats, generator: np.random.Generator) -> None:
        """Draw some synergies of poses (n, d) anew, and move free joints a little, in place."""
        is_anew = generator.random(len(poses)) < SYNERGY_REDRAW
        for place, gene in enumerate(self._posture, start=7):
            if gene.name == SYNERGY:
                drawn = generator.integers(0, round(gene.high) + 1, len(poses))
                poses[:, place] = np.where(is_anew, drawn, poses[:, place])
            else:
                low, high = sorted((gene.low, gene.high))
                moved = JOINT_SIGMA * (gene.high - gene.low) * generator.standard_normal(len(poses))
                poses[:, place] = np.clip(poses[:, place] + moved, low, high)


def shortest_turns(before: Floats, after: Floats) -> Floats:
    """Return the rotations (n, 4) that turn unit vectors (n, 3) into others the shortest way."""
    across = cross(before, after)
    return unit(np.concatenate([across, np.maximum(1.0 + dot(before, after), 1e-9)[:, None]], axis=1))


def posture_genes(scene: Scene) -> tuple[Gene, ...]:
    """Return the genes behind the pose: synergy and free joints, with their values' range."""
    return layout(scene, GIVEN).genes[7:]
