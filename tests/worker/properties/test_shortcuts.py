"""Shortcuts change no result: filters of poses, and early ends of closings."""

from dataclasses import replace
from itertools import product

import msgspec
import numpy as np
import pytest
from scipy.spatial import ConvexHull
from tests.worker.properties.test_parity import REFERENCES, recorded

from qdgrasp_assets.genes import layout
from qdgrasp_protocol.rows import RESULT, Outcome
from qdgrasp_worker.decoder import Decoder
from qdgrasp_worker.episode import Episode
from qdgrasp_worker.evaluation_protocols import ROBUST
from qdgrasp_worker.evaluator import Evaluator
from qdgrasp_worker.object_geometry import ObjectSurface
from qdgrasp_worker.world import World

HANDS = ["panda", "barrett", "allegro", "shadow", "robotiq_2f"]
QUICK = {"panda": 200, "robotiq_2f": 300, "barrett": 40, "allegro": 40, "shadow": 40}
OBJECTS = ("rubiks_cube", "mug", "power_drill")
BATCH = 100


def rows_of(scene, prior, genomes, *, shortcuts):
    with Evaluator(scene, shortcuts=shortcuts) as evaluator:
        parts = [
            evaluator.evaluate(prior, part, np.zeros(len(part), np.uint16))
            for part in np.split(genomes, range(BATCH, len(genomes), BATCH))
        ]
    assert not any(part.failures for part in parts)
    return np.concatenate([part.rows for part in parts])


def different(scene, prior, genomes):
    """Number of rows that differ in any result without shortcuts, and the outcomes."""
    rows, plain = (rows_of(scene, prior, genomes, shortcuts=shortcuts) for shortcuts in (True, False))
    differing = sum(ours != theirs for ours, theirs in zip(bits(rows), bits(plain), strict=True))
    return differing, rows["outcome"]


def bits(rows):
    """The results of each row."""
    return [tuple(row[column.name].tobytes() for column in RESULT) for row in rows]


def drawn(scene, prior, n, seed):
    return np.random.default_rng(seed).uniform(-1.0, 1.0, (n, len(layout(scene, prior)))).astype(np.float32)


@pytest.mark.parametrize(
    ("hand", "protocol"), [(hand, "paper") for hand in HANDS] + [("barrett", "released")]
)
def test_a_built_in_hand_has_the_same_rows_without_them(hand, protocol, make_scene):
    scene = make_scene(hand, "mug", protocol)
    differing, outcomes = different(scene, "contact", drawn(scene, "contact", QUICK[hand], seed=4))
    assert differing == 0
    assert (outcomes >= Outcome.MISSED).sum() > 10


def broad_finger(line):
    """An OBJ file of the two sides of a broad finger, with a line before each of them."""
    text, corners = "", np.array(list(product((-0.001, 0.001), (0.0, 0.01), (0.0, 0.054))))
    for first, x in ((1, -0.06), (9, 0.06)):
        placed = corners + np.array([x, 0.0, 0.0])
        text += f"{line} side_{first}\n"
        text += "".join(f"v {x:g} {y:g} {z:g}\n" for x, y, z in placed)
        text += "".join(f"f {a} {b} {c}\n" for a, b, c in ConvexHull(placed).simplices + first)
    return text.encode()


@pytest.mark.parametrize("line", ["usemtl", "o"])
def test_a_hand_whose_mesh_is_of_two_materials_or_objects_has_the_same_rows_without_them(line, make_scene):
    scene = make_scene("panda", "tennis_ball", "paper")
    meshes = scene.gripper.meshes | {"1_finger.obj": broad_finger(line)}
    hand = msgspec.structs.replace(scene.gripper, meshes=meshes)
    scene = msgspec.structs.replace(scene, gripper=hand)
    differing, outcomes = different(scene, "contact", drawn(scene, "contact", 200, seed=6))
    assert differing == 0
    assert (outcomes >= Outcome.MISSED).sum() > 10


@pytest.mark.slow
@pytest.mark.timeout(7200)
@pytest.mark.parametrize("target", OBJECTS)
@pytest.mark.parametrize("hand", sorted(REFERENCES.values()))
def test_reference_hands_have_the_same_rows_without_them_on_recorded_poses(
    hand, target, make_scene, asset_path
):
    poses, _ = recorded(asset_path, hand, target)
    assert different(make_scene(f"ref_{hand}", f"ycb_{target}", "released"), "given", poses)[0] == 0


@pytest.mark.slow
@pytest.mark.timeout(7200)
@pytest.mark.parametrize("target", OBJECTS)
@pytest.mark.parametrize("hand", sorted(REFERENCES.values()))
def test_reference_hands_have_the_same_rows_without_them_on_thousands_of_poses(
    hand, target, make_scene, asset_path
):
    scene = make_scene(f"ref_{hand}", f"ycb_{target}", "released")
    assert different(scene, "contact", drawn(scene, "contact", 6700, seed=5))[0] == 0


@pytest.mark.parametrize(("target", "n", "simulated"), [("tennis_ball", 450, 200), ("mug", 1500, 75)])
@pytest.mark.parametrize("trial", [0, 1])
def test_ending_a_closing_whose_object_has_left_changes_no_verdict(
    target, n, simulated, trial, make_scene, draw
):
    scene = make_scene("panda", target, "robust")
    poses = Decoder(scene, "approach", ObjectSurface(scene))(draw(n))
    trials = [ROBUST.trial(poses[i], trial) for i in range(n)]
    world = World(scene)
    closing_only = replace(ROBUST, shakes=())
    patient = Episode(world, closing_only, stops_early=False)
    early = Episode(world, closing_only)
    verdicts = [patient.run(trial) for trial in trials]
    assert [early.run(trial) for trial in trials] == verdicts
    counts = np.bincount([verdict.outcome for verdict in verdicts], minlength=8)
    assert counts[Outcome.MISSED :].sum() >= simulated
    assert counts[Outcome.BRUSHED] >= simulated / 2
    world.close()
