"""HDF5 files without usable grasps are refused, and the poses of our own fit the marker."""

from pathlib import Path

import h5py
import numpy as np
import pytest
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation
from tests.coordinator.recorded_runs import record
from tests.tools.export.foreign_files import acronym, check_refusal, matrix
from tests.tools.export.independent_readers import READERS

from qdgrasp_assets.catalog import build_scene
from qdgrasp_assets.genes import layout
from qdgrasp_assets.grippers.hand_geometry import hand_geometry
from qdgrasp_assets.scene import Scene
from qdgrasp_protocol.rows import Outcome, RowShape
from qdgrasp_protocol.spec import RunSpec
from qdgrasp_tools.export.exporter import export_run

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
    "no metadata": ({"qdgrasp__about": "{}"}, "what it says of itself cannot be read"),
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


@pytest.mark.parametrize(
    ("transforms", "datasets", "why"),
    [
        *((transforms, {}, why) for transforms, why in BAD_TRANSFORMS.values()),
        *(([matrix()], datasets, why) for datasets, why in BAD_DATASETS.values()),
    ],
    ids=[*BAD_TRANSFORMS, *BAD_DATASETS],
)
def test_hdf5_with_impossible_datasets_is_refused(panda, tmp_path: Path, transforms, datasets, why) -> None:
    acronym(tmp_path / "f.h5", transforms, **datasets)
    check_refusal(panda, tmp_path / "f.h5", why)


def test_hdf5_that_promises_more_than_it_has_or_than_can_be_read_is_refused_unread(panda, tmp_path: Path):
    for count, why in (
        (10**12, "it has 1000000000000 grasps; at most 2000000 are read"),
        (10**6, "its dataset 'grasps/transforms' is far larger than the file"),
    ):
        with h5py.File(tmp_path / "f.h5", "w") as file:
            file.create_dataset("grasps/transforms", (count, 4, 4), "f8", chunks=(1, 4, 4))
        check_refusal(panda, tmp_path / "f.h5", why)
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


def placed(scene: Scene, path: Path, points: np.ndarray) -> np.ndarray:
    """Points of the marker in the object's frame, as a reader of the file places them."""
    (transform,) = READERS["acronym"](path).matrices
    return points @ transform[:3, :3].T + transform[:3, 3] - np.array(scene.object.com_in_mesh)


def in_fingers(scene: Scene, grasp: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Flag points (n, 3) in the convex hull of the left or right finger, or nearly: (2, n)."""
    placed_links = hand_geometry(scene.gripper).place_meshes(grasp, np.full(2, OPENED))
    hulls = {shape.link: ConvexHull(vertices).equations for shape, vertices in placed_links}
    fingers = hulls["panda_leftfinger"], hulls["panda_rightfinger"]
    return np.array([(points @ hull[:, :3].T + hull[:, 3] <= THICKNESS).all(axis=1) for hull in fingers])


def test_the_markers_fingers_are_in_the_fingers_of_the_open_hand(scene, grasp, tmp_path: Path) -> None:
    inside = in_fingers(scene, grasp, placed(scene, tmp_path / "cube.h5", MARKER))
    assert (inside.sum(axis=0) == 1).all()
    assert inside[:, :3].all(axis=1).sum() == 1
    assert inside[:, 3:].all(axis=1).sum() == 1


def test_the_cube_is_between_the_markers_fingers_and_its_root_is_the_hands(scene, grasp, tmp_path) -> None:
    between = placed(scene, tmp_path / "cube.h5", np.array([[0, 0, 0.09], [0, 0, 0]]))
    np.testing.assert_allclose(between, [np.zeros(3), grasp[:3]], atol=1e-7)


def test_a_marker_that_is_not_turned_is_beside_the_fingers(scene, grasp, tmp_path: Path) -> None:
    turned = placed(scene, tmp_path / "cube.h5", MARKER[:, [1, 0, 2]])
    assert not in_fingers(scene, grasp, turned).any()
