"""An evaluation is a pure function of scene, genome and trial: the same bytes in any order, anywhere."""

import subprocess
import sys
from pathlib import Path

import msgspec
import numpy as np
import pytest

from qdgrasp_assets.scene import FreeJoint, Scene, Synergy, layout, pack_scene
from qdgrasp_protocol.outcome import Outcome
from qdgrasp_protocol.rows import RESULT
from qdgrasp_worker.evaluate import Evaluator

LEFT, RIGHT = "panda_finger_joint1", "panda_finger_joint2"
ELSEWHERE = """
import sys
from pathlib import Path
import numpy as np
from qdgrasp_assets.scene import unpack_scene
from qdgrasp_worker.evaluate import Evaluator
folder = Path(sys.argv[1])
genomes = np.load(folder / "genomes.npy")
with Evaluator(unpack_scene((folder / "scene").read_bytes())) as evaluator:
    rows = evaluator.evaluate("approach", genomes, np.zeros(len(genomes), np.uint16)).rows
np.save(folder / "rows.npy", rows)
"""


def many_ways(scene: Scene) -> Scene:
    """The Panda as a hand with synergies and a free joint, so that motors differ from pose to pose."""
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


SCENES = {
    "paper": lambda make: make("panda", "rubiks_cube", "paper"),
    "released": lambda make: make("panda", "mug", "released"),
    "synergies": lambda make: many_ways(make("panda", "tennis_ball", "released")),
}


@pytest.fixture(scope="module", params=SCENES)
def scene(request, make_scene):
    return SCENES[request.param](make_scene)


@pytest.fixture(scope="module")
def genomes(scene, draw):
    return draw(320, len(layout(scene, "approach")), seed=3, near=32)


@pytest.fixture(scope="module")
def rows(scene, genomes):
    return evaluate(scene, genomes)


def evaluate(scene, genomes, batch=None):
    batch = batch or len(genomes)
    with Evaluator(scene) as evaluator:
        parts = [
            evaluator.evaluate("approach", part, np.zeros(len(part), np.uint16))
            for part in np.split(genomes, range(batch, len(genomes), batch))
        ]
    assert not any(part.failures for part in parts)
    return np.concatenate([part.rows for part in parts])


def results(rows) -> dict[str, bytes]:
    return {column.name: rows[column.name].tobytes() for column in RESULT}


def test_the_genomes_reach_every_phase(rows):
    outcomes = [Outcome(value) for value in rows["outcome"]]
    assert sum(not outcome.is_simulated for outcome in outcomes) > 50
    assert sum(outcome.is_success for outcome in outcomes) >= 25
    assert sum(outcome.is_grasp for outcome in outcomes) >= 15


@pytest.mark.parametrize("order", ["reversed", "shuffled"])
def test_another_order_gives_the_same_bytes(scene, genomes, rows, order):
    place = np.arange(len(genomes))[::-1]
    if order == "shuffled":
        place = np.random.default_rng(5).permutation(len(genomes))
    assert results(evaluate(scene, genomes[place])) == results(rows[place])


@pytest.mark.parametrize("batch", [1, 37])
def test_another_batch_size_gives_the_same_bytes(scene, genomes, rows, batch):
    assert results(evaluate(scene, genomes, batch)) == results(rows)


def test_a_world_of_its_own_for_each_genome_gives_the_same_bytes(scene, genomes, rows):
    some = slice(20, 60)
    alone = [evaluate(scene, genome[None]) for genome in genomes[some]]
    assert results(np.concatenate(alone)) == results(rows[some])


def test_another_process_gives_the_same_bytes(scene, genomes, rows, tmp_path):
    np.save(tmp_path / "genomes.npy", genomes)
    (tmp_path / "scene").write_bytes(pack_scene(scene).payload)
    subprocess.run([sys.executable, "-c", ELSEWHERE, str(tmp_path)], check=True, timeout=120)
    assert results(np.load(Path(tmp_path, "rows.npy"))) == results(rows)
