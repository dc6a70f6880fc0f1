"""Shortcuts change no result: filters of poses, and early ends of closings."""

from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from scipy.spatial import ConvexHull
from tests.common import with_gripper
from tests.worker.genomes import HANDS, decoded, draw, evaluated
from tests.worker.properties.test_parity import REFERENCES, recorded

from qdgrasp_assets.genes import layout
from qdgrasp_protocol.rows import Outcome
from qdgrasp_worker.engines.bullet_world import BulletShakenWorld
from qdgrasp_worker.episode import ShakenEpisode
from qdgrasp_worker.evaluation_protocols import ROBUST

QUICK = {"panda": 200, "robotiq_2f": 300, "barrett": 40, "allegro": 40, "shadow": 40}
OBJECTS = ("rubiks_cube", "mug", "power_drill")


def different(scene, prior, genomes):
    """Number of rows that differ in anything without shortcuts, and the rows."""
    rows, plain = (evaluated(scene, prior, genomes, batch=100, shortcuts=each) for each in (True, False))
    return sum(ours.tobytes() != theirs.tobytes() for ours, theirs in zip(rows, plain, strict=True)), rows


def assert_same_without(scene, n, seed):
    """Rows of the prior contact are the same without shortcuts, and not all spared."""
    differing, rows = different(scene, "contact", draw(n, len(layout(scene, "contact")), seed))
    assert differing == 0
    assert (rows["outcome"] >= Outcome.MISSED).sum() > 10


@pytest.mark.parametrize(
    ("hand", "protocol"),
    [(hand, "paper") for hand in HANDS] + [pytest.param("barrett", "released", marks=pytest.mark.slow)],
)
def test_a_built_in_hand_has_the_same_rows_without_them(hand, protocol, make_scene):
    assert_same_without(make_scene(hand, "mug", protocol), QUICK[hand], seed=4)


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
    assert_same_without(with_gripper(scene, meshes=meshes), 200, seed=6)


@pytest.mark.slow
@pytest.mark.timeout(7200)
@pytest.mark.parametrize("target", OBJECTS)
@pytest.mark.parametrize("hand", sorted(REFERENCES.values()))
def test_reference_hands_have_the_same_rows_without_them_on_thousands_of_poses(
    hand, target, make_scene, asset_path
):
    scene = make_scene(f"ref_{hand}", f"ycb_{target}", "released")
    assert_same_without(scene, 6700, seed=5)
    assert different(scene, "given", recorded(asset_path, hand, target)[0])[0] == 0


@pytest.mark.parametrize(("target", "n", "simulated"), [("tennis_ball", 450, 200), ("mug", 1500, 75)])
@pytest.mark.parametrize("trial", [0, 1])
def test_ending_a_closing_whose_object_has_left_changes_no_verdict(target, n, simulated, trial, make_scene):
    scene = make_scene("panda", target, "robust")
    poses = decoded(scene, "approach", draw(n))
    trials = [ROBUST.trial(poses[i], trial) for i in range(n)]
    world = BulletShakenWorld(scene)
    patient = ShakenEpisode(world, replace(ROBUST, shakes=()), stops_early=False)
    verdicts = [patient.run(trial) for trial in trials]
    early = replace(patient, stops_early=True)
    assert [early.run(trial) for trial in trials] == verdicts
    counts = np.bincount([verdict.outcome for verdict in verdicts], minlength=8)
    assert counts[Outcome.MISSED :].sum() >= simulated
    assert counts[Outcome.BRUSHED] >= simulated / 2
    world.close()
