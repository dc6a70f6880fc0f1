"""Evaluations to replay, by outcome: poses near a scene's object, as the evaluator scores."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from tests.worker.genomes import NEAR, draw

from qdgrasp_assets.scene import Scene
from qdgrasp_protocol.replay_messages import ReplayPart, ReplayRequest
from qdgrasp_protocol.rows import GIVEN, Outcome, Rows
from qdgrasp_worker.evaluator import Evaluator


@dataclass(frozen=True)
class RecordedEvaluation:
    """Results of poses of the prior `given`."""

    scene: Scene
    rows: Rows

    def one(self, outcome: Outcome) -> np.void:
        """The first that ended so."""
        return self.rows[np.flatnonzero(self.rows["outcome"] == outcome)[0]]


def record_evaluation(scene: Scene, n: int, trial: int = 0) -> RecordedEvaluation:
    """Evaluate poses of the prior approach, three of four near, each in its open posture."""
    with Evaluator(scene) as evaluator:
        genomes = draw(n, evaluator.shape("approach").genes)
        genomes[np.arange(n) % 4 > 0, 3:5] = NEAR
        found = evaluator.evaluate("approach", genomes, np.zeros(n, dtype=np.uint16)).rows
        posed = found[found["base_to_object"].any(axis=1)]
        trials = np.full(len(posed), trial, dtype=np.uint16)
        return RecordedEvaluation(scene, evaluator.evaluate(GIVEN, given(scene, posed), trials).rows)


def given(scene: Scene, rows: Rows) -> NDArray[np.float32]:
    """The poses of rows with all driven fingers closing, and free joints in mid-range."""
    n, hand = len(rows), scene.gripper
    synergies = np.full((n, 1 if hand.synergies else 0), -1.0)
    free = np.tile([(joint.low + joint.high) / 2 for joint in hand.free_joints], (n, 1))
    return np.hstack([rows["base_to_object"], synergies, free]).astype(np.float32)


def request(row: np.void, what: ReplayPart | None = None, **settings: object) -> ReplayRequest:
    """Show a row."""
    values = {"genome": tuple(row["genome"].tolist()), "trial": int(row["trial"]), "what": what}
    return ReplayRequest(**{"width": 320, "height": 240} | values | settings)
