"""Grasps and hands as notebooks show them, as scenes, and as tables of pandas."""

import io
from base64 import b64decode
from html import escape
from pathlib import Path

import numpy as np
import pytest
from msgspec.structs import replace
from PIL import Image
from tests.coordinator.recorded_campaigns import record_campaign
from tests.coordinator.recorded_runs import record
from tests.coordinator.scenes import made_scene
from tests.tools.export.conftest import random_rows

import qdgrasp
from qdgrasp_assets.grippers.hand_geometry import hand_geometry
from qdgrasp_assets.scene import Scene
from qdgrasp_protocol.errors import ImpossibleValue, UnknownName
from qdgrasp_protocol.rows import Outcome

COM = (0.01, -0.02, 0.03)
OUTCOMES = [Outcome.MISSED, Outcome.DROPPED, *[Outcome.HELD] * 8]
HOSTILE = "<script>alert('x')</script>\"&"
MOST_BYTES = 200_000


@pytest.fixture
def scene() -> Scene:
    made = made_scene()
    return replace(made, object=replace(made.object, com_in_mesh=COM))


@pytest.fixture
def run(tmp_path: Path, scene: Scene) -> qdgrasp.Run:
    folder = record(tmp_path / "mug", scene, random_rows(scene, OUTCOMES), method="contact_rand")
    return qdgrasp.open(folder.path)


def test_a_grasp_is_shown_as_a_picture_with_figures_and_names_are_words(tmp_path: Path, scene: Scene) -> None:
    body, hand = replace(scene.object, name=HOSTILE), replace(scene.gripper, name=HOSTILE)
    names = {"gripper": HOSTILE, "object": f"{HOSTILE}.stl"}
    made = replace(scene, object=body, gripper=hand)
    folder = record(tmp_path / "run", made, random_rows(scene, OUTCOMES), method="contact_rand", **names)
    html = qdgrasp.open(folder.path).grasps()[0]._repr_html_()
    assert len(html.encode()) < MOST_BYTES
    assert "<script" not in html
    assert f"of {escape(HOSTILE)} on {escape(HOSTILE)}" in html
    assert "<th>fitness</th>" in html
    data = html.partition("data:image/png;base64,")[2].partition('"')[0]
    assert len(Image.open(io.BytesIO(b64decode(data))).convert("RGB").getcolors(1 << 16) or []) > 20


def test_a_scene_has_the_object_and_the_hand_at_the_grasp(run: qdgrasp.Run) -> None:
    grasp = run.grasps()[3]
    for frame, offset in (("mesh", np.array(COM)), ("com", np.zeros(3))):
        scene = grasp.scene(frame)
        assert set(scene.graph.nodes_geometry) == {
            *("object", "hand/palm", "hand/left_finger", "hand/right_finger")
        }
        body = scene.graph.get("object")[0] @ np.append(scene.geometry["object"].vertices[0], 1.0)
        np.testing.assert_allclose(body[:3], run.scene.object.vertices[0] + offset, atol=1e-7)
        (pose,) = grasp.arrays.settled_poses(frame)
        np.testing.assert_allclose(scene.graph.get("hand")[0][:3, 3], pose[:3], atol=1e-9)
        placed = hand_geometry(run.scene.gripper).place_meshes(pose, grasp.joints.astype(float))
        expected = {shape.link: vertices for shape, vertices in placed}
        for link, vertices in expected.items():
            matrix, name = scene.graph.get(f"hand/{link}")
            found = scene.geometry[name].vertices @ matrix[:3, :3].T + matrix[:3, 3]
            np.testing.assert_allclose(found, vertices, atol=1e-6)
        assert scene.units == "meters"
        assert scene.metadata["frame"] == frame
    assert len(grasp.scene().export(file_type="glb")) > 1000
    with pytest.raises(UnknownName):
        grasp.scene("world")


def test_a_hand_is_a_scene_with_any_joints() -> None:
    hand = qdgrasp.Hand("panda")
    assert (hand.name, len(hand.joint_names)) == ("panda", 2)
    opened, closed = hand.scene(), hand.scene(hand.closed)
    np.testing.assert_array_equal(opened.graph.get("hand")[0], np.eye(4))
    assert opened.extents[1] == pytest.approx(closed.extents[1])  # the palm is wider than both
    gaps = [abs(scene.graph.get("hand/panda_leftfinger")[0][1, 3]) for scene in (opened, closed)]
    assert gaps == pytest.approx([0.04, 0.0])
    for joints in ([0.1], [0.1, np.nan], [[0.1, 0.1]]):
        with pytest.raises(ImpossibleValue, match="2 finite numbers, of panda_finger_joint1"):
            hand.scene(joints)


def test_grasps_are_a_table_of_pandas(run: qdgrasp.Run) -> None:
    pytest.importorskip("pandas", reason="needs pandas")
    grasps = run.grasps()
    table = grasps.to_pandas("com")
    assert table["number"].tolist() == grasps.numbers.tolist()
    np.testing.assert_array_equal(table[["x", "y", "z"]].to_numpy(), grasps.poses("com")[:, :3])
    assert {"outcome", "fitness", "joint.left", "pregrasp.right", "margin"} <= {*table.columns}
    with pytest.raises(UnknownName):
        grasps.to_pandas("world")


def test_the_runs_of_a_campaign_are_a_table_of_pandas(tmp_path: Path) -> None:
    pytest.importorskip("pandas", reason="needs pandas")
    opened = qdgrasp.open(record_campaign(tmp_path / "parts", 3).path)
    table = opened.to_pandas()
    assert table.index.tolist() == list(opened.names)
    assert table["grasps"].tolist() == [run.summary.grasps for run in opened]
