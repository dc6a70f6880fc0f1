"""Evaluation is a pure function of scene, genome and trial: the same bytes in any order."""

import subprocess
import sys
import warnings
from functools import partial
from pathlib import Path

import msgspec
import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from tests.common import PATIENCE
from tests.worker.aimed_genomes import CANDIDATES, LOOSENESS, WEIGHTS, encoded, facing

from qdgrasp_assets.genes import layout
from qdgrasp_assets.scene import FreeJoint, Scene, Synergy, pack_scene
from qdgrasp_protocol.rows import RESULT, Outcome
from qdgrasp_worker.decoder import Decoder
from qdgrasp_worker.evaluator import Evaluator
from qdgrasp_worker.object_geometry import ObjectSurface

LEFT, RIGHT = "panda_finger_joint1", "panda_finger_joint2"
ELSEWHERE = """
import sys
from pathlib import Path
import numpy as np
from qdgrasp_assets.scene import unpack_scene
from qdgrasp_worker.evaluator import Evaluator
folder = Path(sys.argv[1])
genomes = np.load(folder / "genomes.npy")
with Evaluator(unpack_scene((folder / "scene").read_bytes())) as evaluator:
    rows = evaluator.evaluate(sys.argv[2], genomes, np.zeros(len(genomes), np.uint16)).rows
np.save(folder / "rows.npy", rows)
"""


def many_ways(scene: Scene) -> Scene:
    """The Panda as a hand with synergies and a free joint, so that motors differ by pose."""
    gripper = msgspec.structs.replace(
        scene.gripper,
        synergies=(
            Synergy(name="both", joints=(LEFT, RIGHT)),
            Synergy(name="left", joints=(LEFT,)),
            Synergy(name="right", joints=(RIGHT,)),
        ),
        free_joints=(FreeJoint(name=RIGHT, low=0.02, high=0.04),),
    )
    return msgspec.structs.replace(scene, gripper=gripper)


CASES = {
    "paper": ("approach", lambda make: make("panda", "rubiks_cube", "paper")),
    "released": ("approach", lambda make: make("panda", "mug", "released")),
    "synergies": ("approach", lambda make: many_ways(make("panda", "tennis_ball", "released"))),
    "antipodal": ("antipodal", lambda make: make("panda", "mug", "paper")),
    "spherical": ("spherical", lambda make: make("panda", "tennis_ball", "paper")),
    "aimed": ("aimed", lambda make: many_ways(make("panda", "rubiks_cube", "paper"))),
}
MANY = {"synergies": (160, 16), "spherical": (160, 16), "aimed": (240, 96)}
"""Number of genomes, and of those from near by, where that is not 320 and 32."""


def spherical(scene: Scene, genomes: NDArray[np.float32]) -> NDArray[np.float32]:
    """Genomes (n, 6) of the prior spherical for poses of genomes (n, 7) of the prior approach."""
    grasps = Decoder(scene, "approach", ObjectSurface(scene))(genomes)
    x, y, z = grasps.positions.astype(np.float64).T
    with warnings.catch_warnings(action="ignore"):  # scipy says where an angle is not unique
        angles = Rotation.from_quat(grasps.quaternions).as_euler("xyz")
    polar = [np.sqrt(x * x + y * y + z * z), np.arctan2(y, x), np.arctan2(np.hypot(x, y), z)]
    values = np.column_stack([*polar, angles]) % (2 * np.pi)
    high = [gene.high for gene in layout(scene, "spherical").genes]
    return (values / high * 2 - 1).astype(np.float32)


def aimed(scene: Scene, genomes: NDArray[np.float32]) -> NDArray[np.float32]:
    """Genomes of the prior aimed: at cells beside the poses of genomes of the prior approach."""
    grasps = Decoder(scene, "approach", ObjectSurface(scene))(genomes)
    random, n = np.random.default_rng(4), len(genomes)
    values = facing(scene, n, candidates=1)
    values[:, :3] = grasps.positions + random.integers(0, 2, (n, 3)) * 0.01
    values[:, 3:6] = grasps.surface_points
    values[:, LOOSENESS] = random.choice([0.0, 0.5, 1.0], n, p=[0.8, 0.1, 0.1])
    values[:, CANDIDATES] = random.choice([1.0, 4.0, 32.0], n)
    values[::2, WEIGHTS] = random.uniform(-8.0, 8.0, (len(values[::2]), 6))
    return encoded(scene, values)


RECAST = {"spherical": spherical, "aimed": aimed}
"""The priors whose genomes are made from those of approach."""


@pytest.fixture(scope="module", params=CASES)
def name(request):
    return request.param


@pytest.fixture(scope="module")
def case(name):
    return CASES[name]


@pytest.fixture(scope="module")
def scene(case, make_scene):
    return case[1](make_scene)


@pytest.fixture(scope="module")
def evaluate(case, scene):
    return partial(evaluated, scene, case[0])


@pytest.fixture(scope="module")
def genomes(name, case, scene, draw):
    if case[0] == "antipodal":
        return draw(320, 4, seed=3)
    n, many = MANY.get(name, (320, 32))
    near = draw(n, len(layout(scene, "approach")), seed=3, near=many)
    return RECAST[case[0]](scene, near) if case[0] in RECAST else near


@pytest.fixture(scope="module")
def rows(evaluate, genomes):
    return evaluate(genomes)


def evaluated(scene, prior, genomes, batch=None):
    batch = batch or len(genomes)
    with Evaluator(scene) as evaluator:
        parts = [
            evaluator.evaluate(prior, part, np.zeros(len(part), np.uint16))
            for part in np.split(genomes, range(batch, len(genomes), batch))
        ]
    assert not any(part.failures for part in parts)
    return np.concatenate([part.rows for part in parts])


def results(rows) -> dict[str, bytes]:
    return {column.name: rows[column.name].tobytes() for column in RESULT}


def test_the_genomes_reach_every_phase(rows):
    outcomes = [Outcome(value) for value in rows["outcome"]]
    assert sum(not outcome.is_simulated for outcome in outcomes) > 50
    assert sum(outcome.is_success for outcome in outcomes) >= 20
    assert sum(outcome.is_grasp for outcome in outcomes) >= 15


@pytest.mark.parametrize(("batch", "part"), [(1, 0), (37, 1)])
def test_another_order_in_other_batches_gives_the_same_bytes(evaluate, genomes, rows, batch, part):
    place = np.random.default_rng(3).permutation(len(genomes))[part::2]
    assert results(evaluate(genomes[place], batch)) == results(rows[place])


def test_a_world_of_its_own_for_each_genome_gives_the_same_bytes(evaluate, genomes, rows):
    _, first = np.unique(rows["outcome"], return_index=True)  # one of each outcome
    alone = [evaluate(genome[None]) for genome in genomes[first]]
    assert results(np.concatenate(alone)) == results(rows[first])


def test_another_process_gives_the_same_bytes(case, scene, genomes, rows, tmp_path):
    genomes, rows = genomes[::3], rows[::3]
    np.save(tmp_path / "genomes.npy", genomes)
    (tmp_path / "scene").write_bytes(pack_scene(scene).payload)
    subprocess.run([sys.executable, "-c", ELSEWHERE, str(tmp_path), case[0]], check=True, timeout=PATIENCE)
    assert results(np.load(Path(tmp_path, "rows.npy"))) == results(rows)
