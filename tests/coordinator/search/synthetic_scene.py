"""Built-in hands and a tennis ball, with results by a formula in place of a simulator."""

from functools import cache

import numpy as np

from qdgrasp_assets.catalog import build_scene
from qdgrasp_assets.geometry.rotation import dot, rotate, unit
from qdgrasp_coordinator.metrics.cells import cells
from qdgrasp_coordinator.search.base import SearchSpace, search_space
from qdgrasp_protocol.rows import GIVEN, Gene, Layout, Outcome, Rows, RowShape
from qdgrasp_protocol.spec import RunSpec

BOX = (np.full(3, -0.2), np.full(3, 0.2))
NEAR, FAR = 0.06, 0.14  # Distances from the base to the middle of the ball at which a grasp holds [m]


@cache
def space(hand: str = "panda") -> SearchSpace:
    """The space of poses of a hand around the ball."""
    spec = RunSpec(gripper=hand, object="tennis_ball", protocol="physical", engine="mujoco")
    return search_space(build_scene(spec), GIVEN)


def shape(where: SearchSpace) -> RowShape:
    return RowShape(len(where.layout), 1, contact_slots=2)


def evaluate(where: SearchSpace, generation: int, genomes: np.ndarray) -> Rows:
    """Rows that are a function of the genomes alone: a hand that looks at the ball from near holds it.

    Two links press on opposite sides, and one pose of six drops the ball by chance of its digits.
    """
    rows = shape(where).empty(len(genomes))
    rows["generation"], rows["index"], rows["genome"] = generation, np.arange(len(genomes)), genomes
    poses = genomes[:, :7].astype(np.float64)
    axis = np.array([where.scene.gripper.approach_axis])
    approach = rotate(poses[:, 3:], np.repeat(axis, len(poses), axis=0))
    distances = np.sqrt(dot(poses[:, :3], poses[:, :3]))
    facing = -dot(poses[:, :3], approach) / np.maximum(distances, 1e-9)
    lucky = np.modf(np.abs(poses).sum(axis=1) * 1e5)[0] > 1 / 6
    outcomes = np.where(facing > 0.9, np.where(lucky, Outcome.HELD, Outcome.DROPPED), Outcome.MISSED)
    outcomes = np.where(distances > FAR, Outcome.MISSED, outcomes)
    rows["outcome"] = np.where(distances < NEAR, Outcome.OVERLAP, outcomes)
    rows["fitness"] = np.maximum(rows["outcome"].astype(float) - Outcome.DROPPED, 0)
    rows["steps"] = np.where(rows["outcome"] >= Outcome.DROPPED, 400, 20)
    rows["descriptor"], rows["base_to_object"] = poses[:, :3], poses
    touches = rows["outcome"] >= Outcome.DROPPED
    aside = 0.03 * unit(np.cross(approach, [[0.0, 0.0, 1.0]]) + 1e-9)
    points = np.zeros((len(rows), 2, 7))
    points[:, 0, :3], points[:, 1, :3] = aside, -aside
    rows["contact_points"] = np.where(touches[:, None], points.reshape(len(rows), -1), 0.0)
    rows["contact_links"] = np.where(touches[:, None], [1, 2], 0)
    rows["settled"] = np.where(touches[:, None], poses, 0.0)
    return rows


def play(search, where: SearchSpace, generations: int) -> Rows:
    """The rows of a search's generations."""
    told = []
    for generation in range(generations):
        told.append(evaluate(where, generation, search.ask(generation)))
        search.tell(generation, told[-1])
    return np.concatenate(told)


def covered(rows: Rows, least: Outcome = Outcome.HELD) -> int:
    """Number of cells that hold a success, of such an outcome at least."""
    return len(np.unique(cells(rows[rows["outcome"] >= least]["descriptor"][:, :3]), axis=0))


def plain(genes: int) -> SearchSpace:
    """A space of genes that stand for themselves, around a box of 40 cm."""
    return SearchSpace(
        Layout("contact", tuple(Gene(f"gene {i}", -1.0, 1.0) for i in range(genes))), BOX, None
    )
