"""Shortcuts change no result: filters of poses, and early ends of closings."""

from dataclasses import replace

import numpy as np
import pytest
from tests.worker.genomes import HANDS, decoded, draw, evaluated

from qdgrasp_assets.genes import layout
from qdgrasp_protocol.rows import Outcome
from qdgrasp_worker.engines import make_world
from qdgrasp_worker.episode import ShakenEpisode
from qdgrasp_worker.evaluation_protocols import ROBUST

QUICK = {"panda": 200, "robotiq_2f": 300, "barrett": 40, "allegro": 40, "shadow": 40}


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
    ("hand", "protocol", "engine"),
    [(hand, "paper", None) for hand in HANDS]
    + [("panda", "paper", "mujoco"), ("barrett", "paper", "mujoco")]
    + [pytest.param("barrett", "released", None, marks=pytest.mark.slow)],
)
def test_a_built_in_hand_has_the_same_rows_without_them(hand, protocol, engine, make_scene):
    assert_same_without(make_scene(hand, "mug", protocol, engine), QUICK[hand], seed=4)


@pytest.mark.parametrize(("target", "n", "simulated"), [("tennis_ball", 450, 200), ("mug", 1500, 75)])
@pytest.mark.parametrize(("trial", "engine"), [(0, None), (1, None), (1, "mujoco")])
def test_ending_a_closing_whose_object_has_left_changes_no_verdict(
    target, n, simulated, trial, engine, make_scene
):
    scene = make_scene("panda", target, "robust", engine)
    poses = decoded(scene, "approach", draw(n))
    trials = [ROBUST.trial(poses[i], trial) for i in range(n)]
    world = make_world(scene, ROBUST)
    patient = ShakenEpisode(world, replace(ROBUST, shakes=()), stops_early=False)
    verdicts = [patient.run(trial) for trial in trials]
    early = replace(patient, stops_early=True)
    assert [early.run(trial) for trial in trials] == verdicts
    counts = np.bincount([verdict.outcome for verdict in verdicts], minlength=8)
    assert counts[Outcome.MISSED :].sum() >= simulated
    assert counts[Outcome.BRUSHED] >= simulated / 2
    world.close()
