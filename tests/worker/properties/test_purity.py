"""Evaluation is a pure function of scene, genome and trial: the same bytes in any order."""

import warnings

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from tests.common import with_gripper
from tests.worker.genomes import Genomes, decoded, draw, elsewhere, evaluated, results

from qdgrasp_assets.genes import layout
from qdgrasp_assets.scene import FreeJoint, Scene, Synergy

LEFT, RIGHT = "panda_finger_joint1", "panda_finger_joint2"


def many_ways(scene: Scene) -> Scene:
    """The Panda as a hand with synergies and a free joint, so that motors differ by pose."""
    return with_gripper(
        scene,
        synergies=(
            Synergy(name="both", joints=(LEFT, RIGHT)),
            Synergy(name="left", joints=(LEFT,)),
            Synergy(name="right", joints=(RIGHT,)),
        ),
        free_joints=(FreeJoint(name=RIGHT, low=0.02, high=0.04),),
    )


CASES = {
    "paper": ("approach", lambda make: make("panda", "rubiks_cube", "paper")),
    "mujoco": ("approach", lambda make: make("panda", "rubiks_cube", "paper", "mujoco")),
    "released": ("approach", lambda make: make("panda", "mug", "released")),
    "synergies": ("approach", lambda make: many_ways(make("panda", "tennis_ball", "released"))),
    "antipodal": ("antipodal", lambda make: make("panda", "mug", "paper")),
    "spherical": ("spherical", lambda make: make("panda", "tennis_ball", "paper")),
    "physical": ("approach", lambda make: many_ways(make("panda", "rubiks_cube", "physical"))),
}


def spherical(scene: Scene, genomes: Genomes) -> Genomes:
    """Genomes (n, 6) of the prior spherical for poses of genomes (n, 7) of the prior approach."""
    grasps = decoded(scene, "approach", genomes)
    x, y, z = grasps.positions.astype(np.float64).T
    with warnings.catch_warnings(action="ignore"):  # scipy says where an angle is not unique
        angles = Rotation.from_quat(grasps.quaternions).as_euler("xyz")
    polar = [np.sqrt(x * x + y * y + z * z), np.arctan2(y, x), np.arctan2(np.hypot(x, y), z)]
    values = np.column_stack([*polar, angles]) % (2 * np.pi)
    high = [gene.high for gene in layout(scene, "spherical").genes]
    return (values / high * 2 - 1).astype(np.float32)


@pytest.fixture(scope="module", params=CASES)
def case(request, make_scene):
    """A scene, a prior and genomes of it."""
    prior, scene = CASES[request.param][0], CASES[request.param][1](make_scene)
    if prior == "antipodal":
        return scene, prior, draw(160, 4, seed=3)
    genomes = draw(160, len(layout(scene, "approach")), seed=3, near=16)
    return scene, prior, spherical(scene, genomes) if prior == "spherical" else genomes


@pytest.fixture(scope="module")
def rows(case):
    return evaluated(*case)


@pytest.mark.parametrize(("batch", "part"), [(1, 0), (37, 1)])
def test_another_order_in_other_batches_gives_the_same_bytes(case, rows, batch, part):
    *case, genomes = case
    place = np.random.default_rng(3).permutation(len(genomes))[part::2]
    assert results(evaluated(*case, genomes[place], batch=batch)) == results(rows[place])


def test_a_world_of_its_own_for_each_genome_gives_the_same_bytes(case, rows):
    *case, genomes = case
    _, first = np.unique(rows["outcome"], return_index=True)  # one of each outcome
    alone = [evaluated(*case, genome[None]) for genome in genomes[first]]
    assert results(np.concatenate(alone)) == results(rows[first])


def test_another_process_gives_the_same_bytes(case, rows):
    *case, genomes = case
    assert results(elsewhere(evaluated, *case, genomes[::3])) == results(rows[::3])
