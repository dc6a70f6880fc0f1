"""An ACRONYM file, read by the format's own conventions, shows the Panda hand where its links are."""

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation
from tests.coordinator.exchange.readers import READERS
from tests.coordinator.recorded_runs import record

from qdgrasp_assets.catalog import build_scene
from qdgrasp_assets.genes import layout
from qdgrasp_assets.scene import Scene
from qdgrasp_coordinator.analysis.hand import hand
from qdgrasp_coordinator.exchange.exporting import export
from qdgrasp_protocol.outcome import Outcome
from qdgrasp_protocol.rows import Shape
from qdgrasp_protocol.spec import RunSpec

MARKER = np.array([(x, 0.0, z) for x in (0.041, -0.041) for z in (0.066, 0.0875, 0.109)])
"""Points on the two fingers of ACRONYM's gripper marker [m]: at x = +-0.041, z from 0.066 to 0.112."""
THICKNESS = 2e-3
"""Of the marker's tubes, and how far its fingers may be beside those of the hand [m]."""
OPENED = 0.04
TURNS = {
    "from above": (180, 0, 0),
    "from the side": (0, -90, 0),
    "aslant": (35, -140, 70),
}


@pytest.fixture(scope="module")
def scene() -> Scene:
    return build_scene(RunSpec(gripper="panda", object="rubiks_cube"))


@pytest.fixture(params=TURNS)
def grasp(request: pytest.FixtureRequest, scene: Scene, tmp_path: Path) -> np.ndarray:
    """A known grasp: the cube's centre is 9 cm in front of the hand. Its pose (7,), in a run's only row."""
    turn = Rotation.from_euler("xyz", TURNS[request.param], degrees=True)
    rows = Shape(len(layout(scene, "contact")), 2).empty(1)
    rows["outcome"], rows["fitness"], rows["joints"] = Outcome.HELD, 2.0, 0.028
    rows["base_to_object"][0] = [*turn.apply([0, 0, -0.09]), *turn.as_quat()]
    run = record(
        tmp_path / "run", scene, rows, gripper="panda", object="rubiks_cube", mass=None, method="contact_rand"
    )
    export(run, tmp_path / "cube.h5", "acronym")
    return rows["base_to_object"][0].astype(float)


def placed(path: Path, points: np.ndarray) -> np.ndarray:
    """Points of the marker in the frame of the mesh, as whoever reads the file places them."""
    (transform,) = READERS["acronym"](path).matrices
    return points @ transform[:3, :3].T + transform[:3, 3]


def is_inside(points: np.ndarray, vertices: np.ndarray) -> np.ndarray:
    """Which points (n, 3) are in the convex hull of others, or nearly."""
    planes = ConvexHull(vertices).equations
    return (points @ planes[:, :3].T + planes[:, 3] <= THICKNESS).all(axis=1)


def test_the_markers_fingers_are_in_the_fingers_of_the_open_hand(
    scene: Scene, grasp: np.ndarray, tmp_path: Path
) -> None:
    marker = placed(tmp_path / "cube.h5", MARKER) - np.array(scene.object.com_in_mesh)
    links = {shape.link: points for shape, points in hand(scene.gripper).posed(grasp, np.full(2, OPENED))}
    left, right = links["panda_leftfinger"], links["panda_rightfinger"]
    in_fingers = np.array([is_inside(marker, left), is_inside(marker, right)])
    assert (in_fingers.sum(axis=0) == 1).all()
    assert in_fingers[:, :3].all(axis=1).sum() == 1
    assert in_fingers[:, 3:].all(axis=1).sum() == 1


def test_the_cube_is_between_the_markers_fingers_and_its_root_is_the_hands(
    scene: Scene, grasp: np.ndarray, tmp_path: Path
) -> None:
    com = np.array(scene.object.com_in_mesh)
    between = placed(tmp_path / "cube.h5", np.array([[0, 0, 0.09], [0, 0, 0]]))
    np.testing.assert_allclose(between, [com, grasp[:3] + com], atol=1e-7)


def test_a_marker_that_is_not_turned_is_beside_the_fingers(
    scene: Scene, grasp: np.ndarray, tmp_path: Path
) -> None:
    turned = MARKER[:, [1, 0, 2]]
    marker = placed(tmp_path / "cube.h5", turned) - np.array(scene.object.com_in_mesh)
    links = {shape.link: points for shape, points in hand(scene.gripper).posed(grasp, np.full(2, OPENED))}
    assert not is_inside(marker, links["panda_leftfinger"]).any()
    assert not is_inside(marker, links["panda_rightfinger"]).any()
