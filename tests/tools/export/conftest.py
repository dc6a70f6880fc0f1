"""Runs with grasps to write: some made by hand, some really evaluated."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from msgspec.structs import replace
from scipy.spatial.transform import Rotation
from tests.coordinator.recorded_runs import record
from tests.coordinator.scenes import made_scene
from tests.tools.export import foreign_files

from qdgrasp_assets.catalog import build_scene, find_gripper
from qdgrasp_assets.genes import layout
from qdgrasp_assets.scene import Jaw, Scene
from qdgrasp_coordinator.storage.run_folder import RunFolder
from qdgrasp_protocol.rows import SHAKES, Outcome, Rows, RowShape
from qdgrasp_protocol.spec import RunSpec
from qdgrasp_tools.export import importer
from qdgrasp_tools.export.importer import ImportedPoses, ObjectFrame
from qdgrasp_worker.evaluator import Evaluator

COM = (0.01, -0.02, 0.03)
"""Centre of mass of the object made by hand, in the frame of its mesh [m]."""
SLOTS = 3
MakeRun = Callable[..., RunFolder]


@pytest.fixture
def scene() -> Scene:
    """A hand with a jaw, and a block whose mesh has its origin elsewhere."""
    made = made_scene()
    jaw = Jaw(axis=(0.0, 1.0, 0.0), opening=0.08)
    hand = replace(made.gripper, jaw=jaw, links=("palm", "left_finger", "right_finger"))
    return replace(made, gripper=hand, object=replace(made.object, com_in_mesh=COM), contact_slots=SLOTS)


def random_rows(scene: Scene, outcomes: list[Outcome], seed: int = 0, prior: str = "contact") -> Rows:
    """Nominal rows with these outcomes at random poses, ten to a generation."""
    random = np.random.default_rng(seed)
    n = len(outcomes)
    shape = RowShape(len(layout(scene, prior)), len(scene.gripper.joints), contact_slots=scene.contact_slots)
    rows = shape.empty(n)
    rows["generation"], rows["index"] = np.divmod(np.arange(n), 10)
    rows["outcome"] = outcomes
    rows["fitness"] = np.clip(rows["outcome"].astype(int) - Outcome.DROPPED, 0, 2)
    rows["genome"] = random.uniform(-1, 1, rows["genome"].shape)
    rows["base_to_object"][:, :3] = random.uniform(-0.1, 0.1, (n, 3))
    rows["base_to_object"][:, 3:] = Rotation.random(n, rng=random).as_quat()
    rows["descriptor"] = rows["base_to_object"][:, :3]
    rows["joints"] = random.uniform(0, 0.04, rows["joints"].shape)
    rows["penetration"] = random.uniform(0, 1e-3, n)
    close(rows, random)
    return rows


def close(rows: Rows, random: np.random.Generator) -> None:
    """Let the hands of successes settle near where they were, with a contact at each link but the last."""
    held = rows["outcome"] >= Outcome.DROPPED
    if not held.any() or not rows["contact_links"].size:
        return
    count = np.count_nonzero(held)
    turns = Rotation.from_quat(rows["base_to_object"][held, 3:])
    turns *= Rotation.from_rotvec(random.normal(0, 0.05, (count, 3)))
    positions = rows["base_to_object"][held, :3] + random.normal(0, 0.01, (count, 3))
    rows["settled"][held] = np.hstack([positions, turns.as_quat()])
    rows["contact_links"][held] = (1, 2, 0)
    contacts = np.zeros((count, SLOTS, 7))
    contacts[:, :2, :3] = random.uniform(-0.03, 0.03, (count, 2, 3))
    contacts[:, :2, 3], contacts[:, :2, 6] = 1.0, random.uniform(1, 50, (count, 2))
    rows["contact_points"][held] = contacts.reshape(count, -1)


@pytest.fixture
def make_run(tmp_path: Path, scene: Scene) -> MakeRun:
    """A run's folder with rows of these outcomes."""

    def make(*outcomes: Outcome, name: str = "run", seed: int = 0, **settings: object) -> RunFolder:
        rows = random_rows(scene, list(outcomes), seed)
        rows["fitness"] *= RunSpec(**{"gripper": "", "object": ""} | settings).disturbances / SHAKES
        return record(tmp_path / name, scene, rows, **{"method": "contact_rand", **settings})

    return make


@pytest.fixture
def run(make_run: MakeRun) -> RunFolder:
    """A run with two rows of each outcome."""
    return make_run(*sorted([*Outcome, *Outcome]))


def evaluated(
    path: Path, gripper: str, object_: str, n: int, prior: str = "contact", **settings: object
) -> RunFolder:
    """A run of n random genomes of a prior."""
    scene = build_scene(RunSpec(gripper=gripper, object=object_, **settings))
    with Evaluator(scene) as evaluator:
        genes = evaluator.shape(prior).genes
        genomes = np.random.default_rng(0).uniform(-1, 1, (n, genes)).astype(np.float32)
        rows = evaluator.evaluate(prior, genomes, np.zeros(n, np.uint16)).rows
    rows["index"] = np.arange(n)
    named = {"gripper": gripper, "object": object_, "mass": None, "method": f"{prior}_rand"} | settings
    return record(path, scene, rows, **named, population=n)


def evaluate_given(scene: Scene, genomes: np.ndarray) -> Rows:
    """Rows of poses, evaluated as `qdgrasp evaluate` has them evaluated."""
    with Evaluator(scene) as evaluator:
        return evaluator.evaluate("given", genomes, np.zeros(len(genomes), np.uint16)).rows


HANDS = {"panda": "antipodal", "allegro": "contact", "barrett": "contact"}
"""Hands with a jaw, with synergies, and with free joints; with a prior that finds grasps."""


@pytest.fixture(scope="session", params=HANDS)
def evaluated_run(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> RunFolder:
    """Poses of a hand on a cube, evaluated."""
    path = tmp_path_factory.mktemp(request.param) / "run"
    return evaluated(path, request.param, "rubiks_cube", 120, HANDS[request.param])


@pytest.fixture(scope="module")
def panda() -> Callable[..., ImportedPoses]:
    """Reads a file for the Panda hand, on an object whose centre of mass is at `COM`."""
    hand = find_gripper("panda").on_carrier("paper")
    return lambda path, **settings: importer.import_poses(
        path, hand, ObjectFrame(foreign_files.COM, 1.0, np.ones(3)), **settings
    )
