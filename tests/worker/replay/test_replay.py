"""A replay gives the recorded verdict, and its pictures agree with the numbers."""

import xml.etree.ElementTree as ET
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path

import msgspec
import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from tests.worker.replay.recorded_evaluations import RecordedEvaluation, record_evaluation, request

from qdgrasp_assets.geometry.resting_poses import resting_poses
from qdgrasp_assets.grippers.hand_geometry import hand_geometry
from qdgrasp_assets.grippers.urdf import parse_robot
from qdgrasp_assets.scene import Scene
from qdgrasp_protocol.errors import InputError
from qdgrasp_protocol.process import Stop
from qdgrasp_protocol.rows import RESULT, Outcome
from qdgrasp_worker.engines import make_world
from qdgrasp_worker.evaluation_protocols import scene_protocol
from qdgrasp_worker.replay import renderer, replay
from qdgrasp_worker.replay.episode_recorder import still_snapshot
from qdgrasp_worker.replay.renderer import (
    FILLED_SHARE,
    NO_LINK,
    CameraMatrices,
    Renderer,
    SegmentationMask,
    Snapshot,
    best_view,
    corners_around,
    fit_camera,
)
from qdgrasp_worker.replay.replay import EpisodeReplay, requested_grasp

WIDTH, HEIGHT = 640, 480
SLACK = 2.0
"""Pixels by which a corner may be seen beside itself."""


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


def drawn(replay: EpisodeReplay):
    """The answer and the frames of a replay."""
    frames = []

    def make(*shape: int) -> np.ndarray:
        frames.append(np.zeros((*shape, 3), dtype=np.uint8))
        return frames[0]

    return replay.render(make), frames[0]


def assert_same(row: np.void, replay: EpisodeReplay) -> None:
    """The replay found what the row says, bit for bit."""
    found = row.copy()
    for name in ("outcome", "fitness", "joints", "penetration"):
        found[name] = getattr(replay.verdict, name)
    found["contacts"] = replay.verdict.finger_links
    if replay.verdict.outcome.is_success:
        assert found["settled"].any()
        assert found["contact_links"].any()
    answer, _ = drawn(replay)
    for name in ("settled", "contact_links", "contact_points"):
        found[name] = 0
        found[name][: len(getattr(answer, name))] = getattr(answer, name)
    assert all(found[column.name].tobytes() == row[column.name].tobytes() for column in RESULT)


def test_a_replay_comes_to_the_verdict_of_the_evaluation(on_the_cube):
    outcomes = set(map(Outcome, on_the_cube.rows["outcome"]))
    assert {Outcome.OVERLAP, Outcome.HELD} <= outcomes
    for outcome in outcomes:
        row = on_the_cube.one(outcome)
        assert_same(row, EpisodeReplay(on_the_cube.scene, request(row)))


@pytest.mark.parametrize(
    ("gripper", "protocol", "trial"), [("panda", "robust", 3), ("barrett", "released", 0)]
)
def test_so_it_does_with_other_hands_and_protocols(make_scene, gripper, protocol, trial):
    found = record_evaluation(make_scene(gripper, "rubiks_cube", protocol), 12, trial)
    for row in found.rows[np.argsort(-found.rows["outcome"], kind="stable")[:2]]:
        assert_same(row, EpisodeReplay(found.scene, request(row)))


def test_a_replay_in_two_engines_shows_the_first_one_and_judges_in_both(make_scene, monkeypatch):
    scene = msgspec.structs.replace(make_scene("panda", "rubiks_cube", "physical"), engine="bullet,mujoco")
    row = record_evaluation(scene, 12).one(Outcome.HELD)
    assert_same(row, EpisodeReplay(scene, request(row)))
    slippery = msgspec.structs.replace(scene.object, lateral_friction=0.005)
    other = msgspec.structs.replace(scene, object=slippery)
    monkeypatch.setattr(
        replay,
        "make_world",
        lambda first, protocol, name="": make_world(other if name else first, protocol, name),
    )
    judged = EpisodeReplay(scene, request(row))
    assert judged.verdict.outcome is Outcome.DROPPED
    assert judged.verdict.joints == pytest.approx(row["joints"].tolist())
    assert judged.snapshots[-1].phase == "pushes"


def test_hands_that_cannot_come_to_their_pose_are_drawn_there_and_overlap_as_recorded(make_scene):
    scene = make_scene("panda", "rubiks_cube", "physical")
    poses = resting_poses(scene.object.collision)[:1]
    table = msgspec.structs.replace(scene, resting_poses=poses, approach_distance=0.1)
    found, free = record_evaluation(table, 12), record_evaluation(scene, 12)
    refused = (found.rows["outcome"] == Outcome.OVERLAP) & (free.rows["outcome"] == Outcome.HELD)
    assert refused.any()
    for row in (found.rows[refused][0], found.rows[found.rows["outcome"].argmax()]):
        assert_same(row, EpisodeReplay(table, request(row)))


@pytest.mark.parametrize("engine", [None, "mujoco"])
def test_a_hand_that_was_stopped_on_its_way_is_drawn_where_it_stopped(make_scene, engine):
    robust = make_scene("panda", "rubiks_cube", "robust")
    scene = msgspec.structs.replace(robust, base="physical", engine=engine)
    found = record_evaluation(scene, 12, trial=3)
    stopped = 0
    for row in found.rows[found.rows["outcome"] >= Outcome.DROPPED]:
        replay = EpisodeReplay(scene, request(row))
        assert_same(row, replay)
        placed = msgspec.structs.replace(request(row), pregrasp=True)
        (shot,) = drawn(EpisodeReplay(scene, placed))[0].shots
        goal = scene_protocol(scene).trial(requested_grasp(scene, request(row))[0], 3).pose
        back = np.linalg.inv(frame((*goal.position, *goal.quaternion))) @ frame(shot.hand)
        assert np.allclose(back[:3, :3], np.eye(3), atol=1e-6)
        assert np.allclose(back[:2, 3], 0.0, atol=1e-6)
        stopped += back[2, 3] < -1e-3
    assert stopped


def test_the_open_hand_is_drawn_where_it_was_commanded_and_the_closed_one_where_it_settled(on_the_cube):
    row = on_the_cube.one(Outcome.HELD)
    placed, closed = (
        drawn(EpisodeReplay(on_the_cube.scene, msgspec.structs.replace(request(row), pregrasp=pregrasp)))[0]
        for pregrasp in (True, False)
    )
    last = "closing" if on_the_cube.scene.protocol == "paper" else "settling"
    for answer, phase, name in ((placed, "placed", "base_to_object"), (closed, last, "settled")):
        (shot,) = answer.shots
        assert shot.phase == phase
        in_object = np.linalg.inv(frame(shot.object)) @ frame(shot.hand)
        assert np.allclose(in_object, frame(row[name]), atol=1e-6)


def test_the_same_is_drawn_every_time(on_the_cube):
    row = on_the_cube.one(Outcome.HELD)
    (one, image), (other, again) = (drawn(EpisodeReplay(on_the_cube.scene, request(row))) for _ in range(2))
    assert one == other
    assert image.tobytes() == again.tobytes()
    assert len(np.unique(image)) > 50


def test_the_hand_is_shown_where_the_row_has_it(on_the_cube):
    row = on_the_cube.one(Outcome.OVERLAP)
    answer, _ = drawn(EpisodeReplay(on_the_cube.scene, request(row)))
    assert [shot.phase for shot in answer.shots] == ["placed"]
    np.testing.assert_allclose(frame(answer.shots[0].hand), frame(row["base_to_object"]), atol=1e-6)
    assert any(touch.distance < 0 for touch in answer.shots[0].touches)


def test_contacts_lie_on_the_object_and_their_normals_point_out_of_it(on_the_cube):
    row = on_the_cube.one(Outcome.HELD)
    answer, _ = drawn(EpisodeReplay(on_the_cube.scene, request(row)))
    (shot,) = answer.shots
    assert {touch.link for touch in shot.touches} == {"panda_leftfinger", "panda_rightfinger"}
    scene, into = on_the_cube.scene, np.linalg.inv(frame(shot.object))
    for touch in shot.touches:
        point, normal = into[:3, :3] @ touch.point + into[:3, 3], into[:3, :3] @ touch.normal
        is_near = np.linalg.norm(scene.surface_points - point, axis=1) < 0.006
        assert (scene.surface_normals[is_near] @ normal).max() > 0.9


def test_a_film_ends_where_the_evaluation_ends(on_the_cube):
    row = on_the_cube.one(Outcome.HELD)
    answer, frames = drawn(EpisodeReplay(on_the_cube.scene, request(row, "shakes")))
    assert len(frames) == len(answer.shots)
    phases = (answer.shots[0].phase, answer.shots[-1].phase)
    if on_the_cube.scene.protocol == "paper":
        assert (phases, answer.shots[-1].step) == (("shake z", "shake x"), 204)
    else:
        assert phases == ("pushes", "pushes")
    assert frames[0].tobytes() != frames[len(frames) // 3].tobytes()


def test_a_part_that_did_not_happen_is_refused(on_the_cube):
    row = on_the_cube.one(Outcome.OVERLAP)
    with pytest.raises(InputError, match="no shakes to show: its outcome is overlap"):
        drawn(EpisodeReplay(on_the_cube.scene, request(row, "shakes")))


def test_a_request_that_cannot_be_read_is_not_taken_for_a_full_disk(tmp_path, monkeypatch):
    monkeypatch.setattr(replay, "lifetime", lambda _title: nullcontext(Stop()))
    with pytest.raises(FileNotFoundError):
        replay.replay_folder(tmp_path)


def test_convex_parts_are_drawn_where_they_are_asked_for(on_the_cube):
    scene, row = on_the_cube.scene, on_the_cube.one(Outcome.HELD)
    half = (0.5 * np.frombuffer(scene.object.mesh_vertices, dtype="<f4")).astype("<f4").tobytes()
    small = msgspec.structs.replace(scene, object=msgspec.structs.replace(scene.object, mesh_vertices=half))
    view = (30.0, 20.0)
    (_, parts), (_, surface), (_, whole) = (
        drawn(EpisodeReplay(shown, request(row, parts=parts, view=view)))
        for shown, parts in ((small, True), (small, False), (scene, False))
    )
    assert np.count_nonzero(surface != whole) > 10 * np.count_nonzero(parts != whole)


class Watched:
    """A still of a grasp as rendered, and the places by forward kinematics."""

    def __init__(self, scene: Scene, row: np.void) -> None:
        replay = EpisodeReplay(scene, request(row, width=WIDTH, height=HEIGHT))
        snapshot = still_snapshot(replay.snapshots)
        drawer = Renderer(scene)
        corners = corners_around(drawer, [snapshot], snapshot)
        camera = fit_camera(corners, *best_view(drawer, snapshot), WIDTH / HEIGHT)
        drawer.place(snapshot)
        self.seen: SegmentationMask = drawer.segment(camera, WIDTH, HEIGHT)
        self.camera = camera.camera(WIDTH, HEIGHT)
        self.numbers = {link: number for number, link in enumerate(drawer.links)}
        robot = parse_robot(Path(), ET.fromstring(scene.gripper.urdf))  # noqa: S314
        self.frames = robot.forward(snapshot.joints, frame(row["base_to_object"]))
        self.hulls = hand_geometry(scene.gripper).hulls
        self.fingers = [link for link in scene.gripper.finger_links if self.hulls[link]]
        self.object = frame([*snapshot.object[0], *snapshot.object[1]])

    def corners(self, link: str) -> np.ndarray:
        """(n, 3): the corners of a link's shapes, by forward kinematics."""
        points = np.concatenate([hull.triangles.reshape(-1, 3) for hull in self.hulls[link]])
        return points @ self.frames[link][:3, :3].T + self.frames[link][:3, 3]


def within(mask: np.ndarray, pixels: np.ndarray) -> bool:
    """Return whether all that is drawn lies in the box around where points are seen."""
    rows, columns = np.nonzero(mask)
    low, high = pixels.min(axis=0) - SLACK, pixels.max(axis=0) + SLACK
    return bool(
        low[0] <= columns.min()
        and columns.max() <= high[0]
        and low[1] <= rows.min()
        and rows.max() <= high[1]
    )


@pytest.fixture(scope="module", params=["panda", "allegro"])
def watched(request, make_scene) -> Watched:
    """The best of some grasps of a hand."""
    found = record_evaluation(make_scene(request.param, "rubiks_cube", "paper"), 12)
    return Watched(found.scene, found.rows[int(found.rows["outcome"].argmax())])


def test_every_link_is_drawn_where_forward_kinematics_puts_it(watched):
    shown = {link: watched.seen.links == number for link, number in watched.numbers.items()}
    shown = {link: mask for link, mask in shown.items() if mask.any()}
    assert set(watched.fingers) & set(shown)
    corners = {link: watched.corners(link) for link in shown}
    for link, mask in shown.items():
        assert within(mask, watched.camera.pixels(corners[link])), link
    assert not all(within(mask, watched.camera.pixels(corners[link] + 0.005)) for link, mask in shown.items())


def test_the_middle_of_every_finger_link_lies_in_what_is_drawn(watched):
    fingers = watched.fingers
    middles = np.array([watched.corners(link).mean(axis=0) for link in fingers])
    columns, rows = np.floor(watched.camera.pixels(middles)).astype(int).T
    there = watched.seen.links[rows, columns]
    assert ((there != NO_LINK) | watched.seen.is_object[rows, columns]).all()
    itself = there == [watched.numbers[link] for link in fingers]
    assert itself.sum() >= len(fingers) / 2  # others stand in front of the rest


def test_the_object_is_drawn_where_the_simulator_has_it(on_the_cube):
    watched = Watched(on_the_cube.scene, on_the_cube.one(Outcome.HELD))
    corners = on_the_cube.scene.object.triangles.reshape(-1, 3).astype(float)
    moved = corners @ watched.object[:3, :3].T + watched.object[:3, 3]
    assert within(watched.seen.is_object, watched.camera.pixels(moved))
    assert not within(watched.seen.is_object, watched.camera.pixels(moved + 0.01))


@pytest.fixture
def drawing(on_the_cube) -> tuple[Renderer, Snapshot, CameraMatrices]:
    """A renderer of a grasp, its snapshot, and a camera that sees all of it."""
    replay = EpisodeReplay(on_the_cube.scene, request(on_the_cube.one(Outcome.HELD)))
    snapshot, drawer = still_snapshot(replay.snapshots), Renderer(on_the_cube.scene)
    camera = fit_camera(corners_around(drawer, [snapshot], snapshot), 40.0, 20.0, WIDTH / HEIGHT)
    drawer.place(snapshot)
    return drawer, snapshot, camera


def moved_back(snapshot: Snapshot, camera: CameraMatrices, metres: float) -> Snapshot:
    """The snapshot with the object's centre so far behind the eye."""
    place = (np.array([0.0, 0.0, metres]) - camera.view[:3, 3]) @ camera.view[:3, :3]
    return replace(snapshot, object=(place.tolist(), snapshot.object[1]))


def test_an_object_in_front_of_the_hand_hides_it(drawing):
    drawer, snapshot, camera = drawing
    before = drawer.segment(camera, WIDTH, HEIGHT)
    drawer.place(moved_back(snapshot, camera, -0.2))
    after = drawer.segment(camera, WIDTH, HEIGHT)
    assert (before.links != NO_LINK)[after.is_object].any()
    assert (after.links[after.is_object] == NO_LINK).all()


def test_an_object_lost_behind_the_camera_hides_nothing(drawing):
    drawer, snapshot, camera = drawing
    drawer.place(moved_back(snapshot, camera, -camera.far - 1.0))
    without = drawer.draw(camera, WIDTH, HEIGHT)
    assert (drawer.segment(camera, WIDTH, HEIGHT).links != NO_LINK).any()
    for metres in (0.0, 0.5):
        drawer.place(moved_back(snapshot, camera, metres))
        assert not drawer.segment(camera, WIDTH, HEIGHT).is_object.any()
        assert drawer.draw(camera, WIDTH, HEIGHT).tobytes() == without.tobytes()


def test_a_picture_does_not_depend_on_how_many_rays_are_cast_at_once(drawing, monkeypatch):
    drawer, _, camera = drawing
    picture = drawer.draw(camera, WIDTH, HEIGHT).tobytes()
    monkeypatch.setattr(renderer, "RAYS_AT_ONCE", 7 * WIDTH)
    assert drawer.draw(camera, WIDTH, HEIGHT).tobytes() == picture


def test_what_faces_the_lamp_is_brightest():
    square = np.array([[[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]])
    body, eye = renderer.DrawnBody(square, (1.0, 0.5, 0.0)), np.array([0.2, 0.2, 3.0])
    facing, aside, behind = (
        body.shaded(eye, np.array(light))[0] for light in ((0, 0, 1), (1, 0, 0), (0, 0, -1))
    )
    assert facing.tolist() == [255, 135, 0]
    assert aside.tolist() == behind.tolist() == [153, 76, 0]
    turned = renderer.DrawnBody(square[:, ::-1], (1.0, 0.5, 0.0)).shaded(eye, np.array([0, 0, 1]))
    assert turned[0].tolist() == facing.tolist()


PICTURE = 400, 300
"""Columns and rows of a picture."""
CLOUD = np.random.default_rng(0).uniform((0.1, -0.2, -0.1), (0.4, 0.1, 0.2), (50, 3))
VIEWS = [(0, 0), (40, 25), (200, -30), (90, 80), (-15, 90)]


@pytest.mark.parametrize("view", VIEWS, ids=str)
def test_everything_is_in_the_picture_and_fills_it(view):
    pixels = fit_camera(CLOUD, *view, 4 / 3).camera(*PICTURE).pixels(CLOUD)
    shares = np.abs(pixels / PICTURE - 0.5) * 2
    assert shares.max() == pytest.approx(FILLED_SHARE, abs=0.02)


@pytest.mark.parametrize("view", VIEWS[:4], ids=str)
def test_the_objects_z_points_up_in_the_picture(view):
    camera = fit_camera(CLOUD, *view, 4 / 3).camera(*PICTURE)
    (column, row), (above, higher) = camera.pixels(np.array([[0.2, 0, 0.1], [0.2, 0, 0.14]]))
    assert above == pytest.approx(column, abs=12)
    assert higher < row


def test_who_looks_along_minus_x_has_y_to_the_right():
    camera = fit_camera(CLOUD, 0.0, 0.0, 4 / 3).camera(*PICTURE)
    (left, _), (right, _) = camera.pixels(np.array([[0.2, 0.0, 0.1], [0.2, 0.05, 0.1]]))
    assert right > left


def test_what_is_nearer_is_larger():
    camera = fit_camera(CLOUD, 0.0, 0.0, 4 / 3).camera(*PICTURE)
    near, far = (np.ptp(camera.pixels(np.array([[x, -0.05, 0.1], [x, 0.05, 0.1]]))[:, 0]) for x in (0.4, 0.1))
    assert near > far
