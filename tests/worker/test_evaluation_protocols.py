"""Trials: their draws and distributions, and hands that meet a displaced object."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from qdgrasp_protocol.rows import NO_SYNERGY
from qdgrasp_worker.decoder import HandPose
from qdgrasp_worker.evaluation_protocols import MIXTURE, ROBUST, TrialSetup, pose_seen_from

POSES = 60
POSE = HandPose([0.0, 0.0, 0.125], [1.0, 0.0, 0.0, 0.0], [0.25, 0.5], 1)


def random_poses() -> list[HandPose]:
    random = np.random.default_rng(11)
    positions = random.normal(0.0, 0.1, (POSES, 3)).astype(np.float32)
    quaternions = Rotation.random(POSES, random_state=random).as_quat().astype(np.float32)
    return [
        HandPose(position.tolist(), quaternion.tolist(), [0.0], NO_SYNERGY)
        for position, quaternion in zip(positions, quaternions, strict=True)
    ]


@pytest.mark.parametrize(
    "change",
    [
        {"position": [0.0, 0.0, float(np.nextafter(np.float32(0.125), np.float32(1)))]},
        {"quaternion": [0.0, 1.0, 0.0, 0.0]},
        {"joints": [0.25, float(np.nextafter(np.float32(0.5), np.float32(1)))]},
        {"synergy": 0},
    ],
    ids=lambda change: next(iter(change)),
)
def test_another_grasp_meets_other_trials(change):
    assert ROBUST.trial(replace(POSE, **change), 1).frictions != ROBUST.trial(POSE, 1).frictions


def test_a_mixture_without_noise_draws_the_grasp_itself_to_the_bit():
    still = replace(MIXTURE, position_sigma=0.0, angle_sigma=0.0, rolling=(0.01, 0.01), spinning=(0.1, 0.1))
    for pose in random_poses():
        assert still.trial(pose, 3) == TrialSetup(pose, (0.01, 0.1))


def test_a_displaced_object_sees_the_hand_where_the_hand_is():
    random = np.random.default_rng(3)
    for pose in random_poses():
        position, turn = random.normal(0.0, 0.1, 3), Rotation.random(random_state=random)
        seen = pose_seen_from(position, turn.as_quat(), pose)
        hand = Rotation.from_quat(pose.quaternion)
        np.testing.assert_allclose(position + turn.apply(seen.position), pose.position, atol=1e-7)
        assert (turn * Rotation.from_quat(seen.quaternion) * hand.inv()).magnitude() < 1e-6
