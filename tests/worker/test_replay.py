"""A replay gives the recorded verdict, and its course agrees with the recorded numbers."""

import xml.etree.ElementTree as ET
from dataclasses import dataclass
from pathlib import Path

import msgspec
import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from tests.worker.genomes import NEAR, draw

from qdgrasp_assets.geometry.object_surface import ObjectSurface
from qdgrasp_assets.geometry.resting_poses import resting_poses
from qdgrasp_assets.grippers.urdf import parse_robot
from qdgrasp_assets.scene import Scene
from qdgrasp_protocol.replay_messages import REPLAYED, ReplayAnswer, ReplayRequest, Snapshot
from qdgrasp_protocol.rows import GIVEN, RESULT, Outcome, Rows, unpack
from qdgrasp_worker import replay
from qdgrasp_worker.decoder import Decoder
from qdgrasp_worker.engines import make_world
from qdgrasp_worker.evaluation_protocols import scene_protocol
from qdgrasp_worker.evaluator import Evaluator
from qdgrasp_worker.replay import replay_evaluation


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


def request(row: np.void) -> ReplayRequest:
    return ReplayRequest(genome=tuple(row["genome"].tolist()), trial=int(row["trial"]))


def replayed(scene: Scene, row: np.void) -> ReplayAnswer:
    """Replay a row, and check that it found what the row says, bit for bit."""
    answer, found = replay_evaluation(scene, request(row)), row.copy()
    unpack(found.reshape(1), REPLAYED, answer.columns)
    assert all(found[column.name].tobytes() == row[column.name].tobytes() for column in RESULT)
    return answer


@pytest.fixture(scope="module", params=["paper", "paper in mujoco", "physical", "physical in mujoco"])
def on_the_cube(request, make_scene) -> RecordedEvaluation:
    protocol, _, engine = request.param.partition(" in ")
    scene = make_scene("panda", "rubiks_cube", protocol)
    return record_evaluation(msgspec.structs.replace(scene, engine=engine or None), 40)


def frame(pose) -> np.ndarray:
    """A pose as (4, 4)."""
    whole = np.eye(4)
    whole[:3, :3], whole[:3, 3] = Rotation.from_quat(pose[3:]).as_matrix(), pose[:3]
    return whole


def hand(scene: Scene, snapshot: Snapshot) -> np.ndarray:
    """The frame (4, 4) of the hand's base link."""
    robot = parse_robot(Path(), ET.fromstring(scene.gripper.urdf))  # noqa: S314
    return robot.forward(snapshot.joints, frame(snapshot.root))[scene.gripper.base_link]


def test_a_replay_comes_to_the_verdict_of_the_evaluation(on_the_cube):
    outcomes = set(map(Outcome, on_the_cube.rows["outcome"]))
    assert {Outcome.OVERLAP, Outcome.HELD} <= outcomes
    for outcome in outcomes:
        replayed(on_the_cube.scene, on_the_cube.one(outcome))


@pytest.mark.parametrize(
    ("gripper", "protocol", "trial"), [("panda", "robust", 3), ("barrett", "released", 0)]
)
def test_so_it_does_with_other_hands_and_protocols(make_scene, gripper, protocol, trial):
    found = record_evaluation(make_scene(gripper, "rubiks_cube", protocol), 12, trial)
    for row in found.rows[np.argsort(-found.rows["outcome"], kind="stable")[:2]]:
        replayed(found.scene, row)


def test_a_replay_in_two_engines_shows_the_first_one_and_judges_in_both(make_scene, monkeypatch):
    scene = msgspec.structs.replace(make_scene("panda", "rubiks_cube", "physical"), engine="bullet,mujoco")
    row = record_evaluation(scene, 12).one(Outcome.HELD)
    replayed(scene, row)
    slippery = msgspec.structs.replace(scene.object, lateral_friction=0.005)
    other = msgspec.structs.replace(scene, object=slippery)
    monkeypatch.setattr(
        replay,
        "make_world",
        lambda first, protocol, name="": make_world(other if name else first, protocol, name),
    )
    judged = replay_evaluation(scene, request(row))
    found = row.copy()
    unpack(found.reshape(1), REPLAYED, judged.columns)
    assert found["outcome"] == Outcome.DROPPED
    assert found["joints"].tolist() == row["joints"].tolist()
    assert judged.snapshots[-1].phase == "pushes"


def test_hands_that_cannot_come_to_their_pose_overlap_as_recorded(make_scene):
    scene = make_scene("panda", "rubiks_cube", "physical")
    poses = resting_poses(scene.object.collision)[:1]
    table = msgspec.structs.replace(scene, resting_poses=poses, approach_distance=0.1)
    found, free = record_evaluation(table, 12), record_evaluation(scene, 12)
    refused = (found.rows["outcome"] == Outcome.OVERLAP) & (free.rows["outcome"] == Outcome.HELD)
    assert refused.any()
    for row in (found.rows[refused][0], found.rows[found.rows["outcome"].argmax()]):
        replayed(table, row)


@pytest.mark.parametrize("engine", [None, "mujoco"])
def test_a_hand_that_was_stopped_on_its_way_is_placed_where_it_stopped(make_scene, engine):
    robust = make_scene("panda", "rubiks_cube", "robust")
    scene = msgspec.structs.replace(robust, base="physical", engine=engine)
    found = record_evaluation(scene, 24, trial=3)
    stopped = 0
    for row in found.rows[found.rows["outcome"] >= Outcome.DROPPED]:
        shots = [shot for shot in replayed(scene, row).snapshots if shot.phase == "placed"]
        genome = np.array([request(row).genome], dtype=np.float32)
        goal = scene_protocol(scene).trial(Decoder(scene, GIVEN, ObjectSurface(scene))(genome)[0], 3).pose
        back = np.linalg.inv(frame((*goal.position, *goal.quaternion))) @ hand(scene, shots[-1])
        assert np.allclose(back[:3, :3], np.eye(3), atol=1e-6)
        assert np.allclose(back[:2, 3], 0.0, atol=1e-6)
        stopped += back[2, 3] < -1e-3
    assert stopped


def test_the_open_hand_is_where_it_was_commanded_and_the_closed_one_where_it_settled(on_the_cube):
    row, scene = on_the_cube.one(Outcome.HELD), on_the_cube.scene
    last = "closing" if scene.protocol == "paper" else "settling"
    for phase, name in (("placed", "base_to_object"), (last, "settled")):
        shot = [shot for shot in replayed(scene, row).snapshots if shot.phase == phase][-1]
        in_object = np.linalg.inv(frame(shot.object)) @ hand(scene, shot)
        assert np.allclose(in_object, frame(row[name]), atol=1e-6)


def test_an_overlap_is_one_snapshot_where_the_row_has_it(on_the_cube):
    row = on_the_cube.one(Outcome.OVERLAP)
    (shot,) = replayed(on_the_cube.scene, row).snapshots
    np.testing.assert_allclose(hand(on_the_cube.scene, shot), frame(row["base_to_object"]), atol=1e-6)
    assert any(touch.distance < 0 for touch in shot.touches)


def test_contacts_lie_on_the_object_and_their_normals_point_out_of_it(on_the_cube):
    scene, row = on_the_cube.scene, on_the_cube.one(Outcome.HELD)
    shots = replayed(scene, row).snapshots
    shot = [shot for shot in shots if shot.phase in ("closing", "settling")][-1]
    assert {touch.link for touch in shot.touches} == {"panda_leftfinger", "panda_rightfinger"}
    into = np.linalg.inv(frame(shot.object))
    for touch in shot.touches:
        point, normal = into[:3, :3] @ touch.point + into[:3, 3], into[:3, :3] @ touch.normal
        is_near = np.linalg.norm(scene.surface_points - point, axis=1) < 0.006
        assert (scene.surface_normals[is_near] @ normal).max() > 0.9


def test_the_course_ends_where_the_evaluation_ends(on_the_cube):
    shots = replayed(on_the_cube.scene, on_the_cube.one(Outcome.HELD)).snapshots
    phases = list(dict.fromkeys(shot.phase for shot in shots))
    if on_the_cube.scene.protocol == "paper":
        assert phases == ["placed", "closing", "shake z", "shake x"]
        assert shots[-1].step == 204
    else:
        assert phases == ["placed", "closing", "settling", "pushes"]
