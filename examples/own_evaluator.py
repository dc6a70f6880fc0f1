"""An evaluator of one's own in the simulator's place: a hand holds the object that it points at.

qdgrasp run --gripper panda --object mug --method approach_rand --workers 0 --out runs/aim
python own_evaluator.py tcp/127.0.0.1:7447              in another terminal; the run says where it listens
"""

import sys

import numpy as np
from scipy.spatial.transform import Rotation

import qdgrasp
from qdgrasp import Hands, Outcome, Verdicts

NEAR = {Outcome.HELD: 0.01, Outcome.SHAKEN: 0.02, Outcome.DROPPED: 0.04}  # [m]


class Aim:
    """Judges by how far the hand's approach axis passes from the object's centre of mass."""

    def __init__(self, scene: qdgrasp.Scene) -> None:
        self.axis = scene.gripper.approach_axis

    def __call__(self, hands: Hands) -> Verdicts:
        positions, quaternions = np.split(hands.base_to_object, [3], axis=1)
        axes = Rotation.from_quat(quaternions).apply(self.axis)
        misses = np.linalg.norm(np.cross(positions, axes), axis=1)
        return Verdicts(np.select([misses < near for near in NEAR.values()], list(NEAR), Outcome.MISSED))


if __name__ == "__main__":
    qdgrasp.serve(Aim, connect=sys.argv[1] if len(sys.argv) > 1 else None)
