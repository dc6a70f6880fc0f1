"""HDF5 files without usable grasps are refused, and the poses of our own fit the marker."""

from pathlib import Path

import h5py
import numpy as np
import pytest
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation
from tests.coordinator.export.foreign_files import acronym, check_refusal, matrix
from tests.coordinator.export.independent_readers import READERS
from tests.coordinator.recorded_runs import record

from qdgrasp_assets.catalog import build_scene
from qdgrasp_assets.genes import layout
from qdgrasp_assets.scene import Scene
from qdgrasp_coordinator.export.exporter import export_run
from qdgrasp_coordinator.rendering.hand_geometry import hand_geometry
from qdgrasp_protocol.rows import Outcome, RowShape
from qdgrasp_protocol.spec import RunSpec

SKEW = np.eye(4) + 0.1 * np.eye(4, k=1)
MIRROR = np.diag([1.0, 1.0, -1.0, 1.0])
BAD_TRANSFORMS = {
    "none": (np.zeros((0, 4, 4)), "there is none in it"),
    "another shape": (np.zeros((2, 3, 4)), "must be numbers of shape (n, 4, 4)"),
    "a scalar": (np.array([1.0]), "must be numbers of shape (n, 4, 4)"),
    "words": (np.full((1, 4, 4), b"x"), "must be numbers of shape (n, 4, 4)"),
    "NaN": (np.full((1, 4, 4), np.nan), "transform 0 is not a rotation and a translation"),
    "infinity": (np.full((1, 4, 4), np.inf), "transform 0 is not a rotation and a translation"),
    "no rotation": (np.stack([np.eye(4), SKEW]), "transform 1 is not a rotation and a translation"),
    "a mirror": (np.stack([MIRROR]), "transform 0 is not a rotation and a translation"),
    "zeros": (np.zeros((1, 4, 4)), "transform 0 is not a rotation and a translation"),
    "a last row": (np.stack([np.eye(4)]) * 2, "transform 0 is not a rotation and a translation"),
}


@pytest.mark.parametrize(("transforms", "why"), BAD_TRANSFORMS.values(), ids=BAD_TRANSFORMS)
def test_hdf5_with_impossible_transforms_is_refused(panda, tmp_path: Path, transforms, why: str) -> None:
    acronym(tmp_path / "f.h5", transforms)
    check_refusal(panda, tmp_path / "f.h5", why)


BAD_DATASETS = {
    "too few positions": (
        {"gripper__joint_names": ["a", "b"], "grasps__pregrasp_joint_positions": np.zeros((1, 1))},
        "must be numbers of shape (1, 2)",
    ),
    "no names": ({"grasps__pregrasp_joint_positions": np.zeros((1, 1))}, "no dataset 'gripper/joint_names'"),
    "a label": (
        {"gripper__synergy_names": ["a"], "grasps__synergy": [5]},
        "must hold -1 or places in 'gripper/synergy_names'",
    ),
    "another synergy": ({"gripper__synergy_names": ["a"], "grasps__synergy": [0]}, "it names synergy 'a'"),
    "too few numbers": ({"qdgrasp__number": [1, 2]}, "'qdgrasp/number' must be numbers of shape (1)"),
    "words": ({"qdgrasp__about": "{}"}, "what it says of itself cannot be read"),
    "no weight": (
        {"object__mass": -1.0},
        "the object's mass in it must be a number greater than 0, and is -1",
    ),
    "a list": ({"object__friction": [1.0, 2.0]}, "'object/friction' must be a number"),
    "a list of texts": ({"qdgrasp__about": ["{}"]}, "'qdgrasp/about' must be a text"),
    "a long name": (
        {"gripper__synergy_names": ["a" * 201], "grasps__synergy": [0]},
        "its synergies must be of 200 letters at most, and 'aaaaaaaaaaaaaaaaaaaa...' is longer",
    ),
    "wide names": (
        {"gripper__synergy_names": np.array([b"a"], "S100000"), "grasps__synergy": [0]},
        "'gripper/synergy_names' must be a list of names",
    ),
    "a group": ({"qdgrasp__about__x": 1}, "its 'qdgrasp/about' is no dataset"),
}


@pytest.mark.parametrize(("datasets", "why"), BAD_DATASETS.values(), ids=BAD_DATASETS)
def test_hdf5_with_impossible_datasets_is_refused(panda, tmp_path: Path, datasets, why: str) -> None:
    acronym(tmp_path / "f.h5", [matrix()], **datasets)
    check_refusal(panda, tmp_path / "f.h5", why)


def test_hdf5_that_promises_more_than_can_be_read_is_refused_unread(panda, tmp_path: Path) -> None:
    with h5py.File(tmp_path / "f.h5", "w") as file:
        file.create_dataset("grasps/transforms", (10**12, 4, 4), "f8", chunks=(1, 4, 4))
    check_refusal(panda, tmp_path / "f.h5", "it has 1000000000000 grasps; at most 2000000 are read")


def test_small_hdf5_that_promises_much_is_refused_unread(panda, tmp_path: Path) -> None:
    with h5py.File(tmp_path / "f.h5", "w") as file:
        file.create_dataset("grasps/transforms", (10**6, 4, 4), "f8", chunks=(1, 4, 4))
    check_refusal(panda, tmp_path / "f.h5", "its dataset 'grasps/transforms' is far larger than the file")
    acronym(tmp_path / "g.h5", [matrix()])
    with h5py.File(tmp_path / "g.h5", "a") as file:
        file.create_dataset("qdgrasp/about", (2**40,), "f8", chunks=(1,))
    check_refusal(panda, tmp_path / "g.h5", "its dataset 'qdgrasp/about' must be a text")


def test_hdf5_that_points_out_of_itself_is_refused_unread(panda, tmp_path: Path) -> None:
    acronym(tmp_path / "whole.h5", [matrix()])
    (tmp_path / "secret").write_bytes(np.eye(4).tobytes())
    with h5py.File(tmp_path / "link.h5", "w") as file:
        file["grasps"] = h5py.ExternalLink("whole.h5", "/grasps")
    with h5py.File(tmp_path / "soft.h5", "w") as file:
        file["grasps"] = h5py.SoftLink("/grasps")
    with h5py.File(tmp_path / "raw.h5", "w") as file:
        outside = [(str(tmp_path / "secret"), 0, 128)]
        file.create_dataset("grasps/transforms", (1, 4, 4), "f8", external=outside)
    with h5py.File(tmp_path / "virtual.h5", "w") as file:
        made = h5py.VirtualLayout((1, 4, 4), "f8")
        made[:] = h5py.VirtualSource(tmp_path / "whole.h5", "grasps/transforms", (1, 4, 4))
        file.create_virtual_dataset("grasps/transforms", made)
    for name in ("link.h5", "soft.h5"):
        check_refusal(panda, tmp_path / name, "is a link to elsewhere, which is not followed")
    for name in ("raw.h5", "virtual.h5"):
        check_refusal(panda, tmp_path / name, "lies in another file, which is not read")


def test_hdf5_that_is_no_acronym_file_is_refused(panda, tmp_path: Path) -> None:
    with h5py.File(tmp_path / "f.h5", "w") as file:
        file["a"] = 1
    check_refusal(panda, tmp_path / "f.h5", "it is HDF5, but not an ACRONYM file")


MARKER = np.array([(x, 0.0, z) for x in (0.041, -0.041) for z in (0.066, 0.0875, 0.109)])
"""Points on the fingers of ACRONYM's gripper marker [m]: x = +-0.041, z 0.066 to 0.112."""
THICKNESS = 2e-3
"""Of the marker's tubes, and how far its fingers may be beside those of the hand [m]."""
OPENED = 0.04
TURNS = {"from above": (180, 0, 0), "from the side": (0, -90, 0), "aslant": (35, -140, 70)}


@pytest.fixture(scope="module")
def scene() -> Scene:
    return build_scene(RunSpec(gripper="panda", object="rubiks_cube"))


@pytest.fixture(params=TURNS)
def grasp(request: pytest.FixtureRequest, scene: Scene, tmp_path: Path) -> np.ndarray:
    """Pose (7,) in a run's only row; the cube's centre is 9 cm in front of the hand."""
    turn = Rotation.from_euler("xyz", TURNS[request.param], degrees=True)
    rows = RowShape(len(layout(scene, "contact")), 2).empty(1)
    rows["outcome"], rows["fitness"], rows["joints"] = Outcome.HELD, 2.0, 0.028
    rows["base_to_object"][0] = [*turn.apply([0, 0, -0.09]), *turn.as_quat()]
    run = record(
        tmp_path / "run", scene, rows, gripper="panda", object="rubiks_cube", mass=None, method="contact_rand"
    )
    export_run(run, tmp_path / "cube.h5", "acronym")
    return rows["base_to_object"][0].astype(float)


def placed(path: Path, points: np.ndarray) -> np.ndarray:
    """Points of the marker in the frame of the mesh, as a reader of the file places them."""
    (transform,) = READERS["acronym"](path).matrices
    return points @ transform[:3, :3].T + transform[:3, 3]


def is_inside(points: np.ndarray, vertices: np.ndarray) -> np.ndarray:
    """Flag points (n, 3) that are in the convex hull of others, or nearly."""
    planes = ConvexHull(vertices).equations
    return (points @ planes[:, :3].T + planes[:, 3] <= THICKNESS).all(axis=1)


def test_the_markers_fingers_are_in_the_fingers_of_the_open_hand(
    scene: Scene, grasp: np.ndarray, tmp_path: Path
) -> None:
    marker = placed(tmp_path / "cube.h5", MARKER) - np.array(scene.object.com_in_mesh)
    links = {
        shape.link: points
        for shape, points in hand_geometry(scene.gripper).place_meshes(grasp, np.full(2, OPENED))
    }
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
    links = {
        shape.link: points
        for shape, points in hand_geometry(scene.gripper).place_meshes(grasp, np.full(2, OPENED))
    }
    assert not is_inside(marker, links["panda_leftfinger"]).any()
    assert not is_inside(marker, links["panda_rightfinger"]).any()
