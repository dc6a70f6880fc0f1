"""Stopping early changes no verdict, wherever a trial puts the object."""

from dataclasses import replace

import numpy as np
import pytest

from qdgrasp_protocol.outcome import Outcome
from qdgrasp_worker.decode import Decoder
from qdgrasp_worker.episode import Episode
from qdgrasp_worker.protocols import ROBUST
from qdgrasp_worker.surface import Surface
from qdgrasp_worker.world import World


@pytest.mark.parametrize(("target", "n", "simulated"), [("tennis_ball", 450, 200), ("mug", 1500, 75)])
@pytest.mark.parametrize("trial", [0, 1])
def test_ending_a_closing_whose_object_has_left_changes_no_verdict(
    target, n, simulated, trial, make_scene, draw
):
    scene = make_scene("panda", target, "robust")
    poses = Decoder(scene, "approach", Surface(scene))(draw(n))
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
