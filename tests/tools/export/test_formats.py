"""Every format, by independent readers; and the metadata in its files."""

import json
from pathlib import Path

import h5py
import msgspec
import numpy as np
import pyarrow.parquet
import pytest
import trimesh
import yaml
from scipy.spatial.transform import Rotation
from tests.coordinator.recorded_runs import record
from tests.tools.export.conftest import COM, random_rows
from tests.tools.export.independent_readers import (
    CONTACTS,
    JOINTS,
    PENETRATIONS,
    READERS,
    TURNED,
    Read,
    homogeneous,
)

from qdgrasp_assets.scene import Scene
from qdgrasp_coordinator.storage.run_folder import RunFolder
from qdgrasp_protocol.rows import Outcome, Rows
from qdgrasp_protocol.spec import from_toml
from qdgrasp_tools.export.exporter import FORMATS, export_run
from qdgrasp_tools.export.grasp_reader import NOT_SETTLED, read_run
from qdgrasp_tools.export.grasp_set import Grasps
from qdgrasp_tools.export.grasp_table import GraspMetadata

ACROSS = Rotation.from_euler("z", 90, degrees=True)
"""The jaw's own axes open along y; turned by this first, they open along x."""
each_format = pytest.mark.parametrize("name", FORMATS)


@pytest.fixture
def grasps(run: RunFolder) -> Grasps:
    """The successes that survived a shake."""
    found = read_run(run)
    return found[found.is_grasp]


def expected(rows: Rows, column: str, name: str, origin: tuple[float, float, float]) -> np.ndarray:
    """The poses of a column as matrices, by another library."""
    poses = rows[column].astype(float)
    turns = Rotation.from_quat(poses[:, 3:])
    matrices = np.tile(np.eye(4), (len(poses), 1, 1))
    matrices[:, :3, :3] = (turns * ACROSS if name in TURNED else turns).as_matrix()
    matrices[:, :3, 3] = poses[:, :3] + origin
    return matrices


@each_format
@pytest.mark.parametrize(("frame", "origin"), [("mesh", COM), ("com", (0.0, 0.0, 0.0))])
def test_another_reader_finds_both_poses_of_the_hands_and_which_grasps_are_better(
    run: RunFolder, grasps: Grasps, tmp_path: Path, name: str, frame: str, origin: tuple[float, float, float]
) -> None:
    export_run(run, tmp_path / "out", name, frame=frame, negatives=0)
    read = READERS[name](tmp_path / "out")
    np.testing.assert_allclose(
        read.matrices, expected(grasps.rows, "base_to_object", name, origin), atol=1e-7
    )
    np.testing.assert_allclose(read.settled, expected(grasps.rows, "settled", name, origin), atol=1e-7)
    better = np.ones(len(grasps)) if name in TURNED else grasps.fitness / 2
    np.testing.assert_array_equal(read.quality, better)


def words_of(path: Path, name: str) -> dict[str, object]:
    """The metadata of a file, as a user would read it."""
    match name:
        case "isaac" | "moveit":
            return yaml.safe_load(path.read_text())["qdgrasp"]
        case "acronym":
            with h5py.File(path) as file:
                runs = json.loads(file["qdgrasp/about"][()])["runs"]
                return dict(file["qdgrasp"].attrs) | {"runs": runs}
        case "graspgen":
            return json.loads((path / "grasp_data" / "block.json").read_text())["qdgrasp"]
        case "parquet":
            return json.loads(pyarrow.parquet.read_schema(path).metadata[b"qdgrasp"])
        case "webdataset":
            return dict(READERS[name](path).beside.attrs)
        case _:
            lines = [line[2:].rstrip() for line in path.read_text().splitlines() if line.startswith("# ")]
            return dict(line.split(": ", 1) for line in lines if ": " in line)


@each_format
def test_every_file_says_frames_units_success_and_licences(run: RunFolder, tmp_path: Path, name: str) -> None:
    export_run(run, tmp_path / "out", name)
    said = words_of(tmp_path / "out", name)
    asked = {"approach_distance", "resting_poses"}
    assert set(GraspMetadata.__struct_fields__) - {"runs", "original_base"} - asked <= set(said)
    assert "original_base" not in said
    assert (said["gripper"], said["gripper_frame"], said["object"]) == ("jaw", "palm", "block")
    assert (said["frame"], said["units"], said["protocol"]) == ("mesh", "m, rad, kg, N", "paper")
    assert (said["gripper_licence"], said["object_licence"]) == ("Apache-2.0", "Apache-2.0")
    assert float(said["object_scale"]) == 1.0
    assert said["success"] == "a finger touches the object after closing"
    assert "at least one disturbance" in said["grasp"]
    assert "higher is better" in said["fitness"]
    assert ("x from one finger to the other" in said["gripper_axes"]) == (name in TURNED)


@each_format
def test_a_file_of_a_centred_hand_says_where_its_original_base_link_is(scene, tmp_path, name) -> None:
    centred = (
        '<link name="palm_centre"/><joint name="palm_centre_joint" type="fixed">'
        '<parent link="palm_centre"/><child link="palm"/><origin xyz="-0.08 0 0.01"/></joint></robot>'
    )
    urdf = scene.gripper.urdf.replace("</robot>", centred)
    hand = msgspec.structs.replace(scene.gripper, urdf=urdf, base_link="palm_centre")
    rows = random_rows(scene, [Outcome.HELD] * 2)
    run = record(tmp_path / "run", msgspec.structs.replace(scene, gripper=hand), rows, method="contact_rand")
    export_run(run, tmp_path / "out", name)
    said = words_of(tmp_path / "out", name)["original_base"]
    position = said["position"] if isinstance(said, dict) else said
    assert "palm" in str(said)
    assert "-0.08" in str(position)


@each_format
def test_no_file_says_in_which_folders_its_author_has_files(make_run, tmp_path, name) -> None:
    run = make_run(Outcome.HELD, gripper="/home/somebody/hand.toml", object="/home/somebody/block.stl")
    export_run(run, tmp_path / "out", name)
    assert not any(b"somebody" in file.read_bytes() for file in files(tmp_path / "out"))
    said = words_of(tmp_path / "out", name)
    assert said["object_file"] == "block.stl"
    if name == "csv":
        assert [line for line in (tmp_path / "out").read_text().splitlines() if "hand.toml" in line] == [
            '#   gripper = "hand.toml"'
        ]
    else:
        (spec,) = (from_toml(each["spec"]) for each in said["runs"])
        assert spec == msgspec.structs.replace(run.spec, gripper="hand.toml", object="block.stl")


@each_format
def test_the_same_run_gives_the_same_bytes(run: RunFolder, tmp_path: Path, name: str) -> None:
    for out in ("one", "two"):
        export_run(run, tmp_path / out, name)
    one, two = ({file.relative_to(tmp_path / out): file.read_bytes() for file in files(tmp_path / out)}
                for out in ("one", "two"))  # fmt: skip
    assert one == two


def files(out: Path) -> list[Path]:
    return [file for file in out.rglob("*") if file.is_file()] if out.is_dir() else [out]


@each_format
@pytest.mark.parametrize("frame", ["mesh", "com"])
def test_contacts_are_told_in_the_frame_of_the_poses_by_the_names_of_links(
    run: RunFolder, grasps: Grasps, tmp_path: Path, name: str, frame: str
) -> None:
    export_run(run, tmp_path / "out", name, frame=frame, negatives=0)
    read = READERS[name](tmp_path / "out")
    np.testing.assert_allclose(PENETRATIONS[name](read.beside), grasps.rows["penetration"], rtol=1e-7)
    if name not in CONTACTS:
        return
    origin = COM if frame == "mesh" else (0.0, 0.0, 0.0)
    recorded = grasps.rows["contact_points"].astype(float).reshape(len(grasps), -1, 7)
    for told, values in zip(CONTACTS[name](read.beside), recorded, strict=True):
        assert [contact.link for contact in told] == ["palm", "left_finger"]
        flat = [[*one.point - origin, *one.normal, one.force] for one in told]
        np.testing.assert_allclose(flat, values[:2], atol=1e-6, rtol=1e-6)


@each_format
def test_a_run_without_settled_poses_says_so_and_leaves_them_out(make_run, scene, tmp_path, name) -> None:
    early = msgspec.structs.replace(scene, contact_slots=0)
    run = record(tmp_path / "run", early, random_rows(early, [Outcome.HELD] * 2), method="contact_rand")
    assert export_run(run, tmp_path / "out", name).endswith(f" But {NOT_SETTLED}.")
    read = READERS[name](tmp_path / "out")
    assert words_of(tmp_path / "out", name)["settled"] == NOT_SETTLED
    if name in ("isaac", "moveit"):
        np.testing.assert_array_equal(read.settled, read.matrices)
    else:
        assert np.isnan(read.settled).all()
    if name in CONTACTS:
        assert not any(CONTACTS[name](read.beside))


def isaac_of(run: RunFolder, tmp_path: Path) -> Path:
    export_run(run, tmp_path / "isaac", "isaac", frame="com")
    return tmp_path / "isaac"


def centre_ways(read: Read) -> np.ndarray:
    """How far the centre of mass moved in the hand, of poses in its frame [m]."""
    before, after = (np.linalg.inv(poses)[:, :3, 3] for poses in (read.matrices, read.settled))
    return np.linalg.norm(after - before, axis=1)


@pytest.mark.parametrize("name", JOINTS)
def test_joints_have_names(run: RunFolder, grasps: Grasps, tmp_path: Path, name: str) -> None:
    export_run(run, tmp_path / "out", name, negatives=0)
    closed, start = JOINTS[name](READERS[name](tmp_path / "out").beside, ["right", "left"])
    np.testing.assert_allclose(closed, grasps.joints[:, ::-1], rtol=1e-7)
    np.testing.assert_allclose(start, np.full((len(grasps), 2), 0.04), rtol=1e-7)


def test_graspgen_has_failures_and_the_mesh_that_its_poses_are_told_of(run, tmp_path) -> None:
    export_run(run, tmp_path / "out", "graspgen")
    read = READERS["graspgen"](tmp_path / "out")
    simulated = read_run(run).rows["outcome"].size + 4  # two missed, two brushed
    assert (read.quality.sum(), len(read.quality)) == (4, simulated)
    mesh = trimesh.load_mesh(tmp_path / "out" / "object_data" / "block.obj")
    np.testing.assert_allclose(mesh.center_mass, COM, atol=1e-9)
    np.testing.assert_allclose(mesh.extents, (0.04, 0.05, 0.06), atol=1e-8)


def test_what_graspgen_reads_with_the_offset_of_the_file_approaches_along_z_and_opens_along_x(
    run: RunFolder, scene: Scene, grasps: Grasps, tmp_path: Path
) -> None:
    """GraspGen multiplies each transform by the offset that its gripper is described with."""
    export_run(run, tmp_path / "out", "graspgen", negatives=0)
    read = READERS["graspgen"](tmp_path / "out")
    position, turn = read.beside["qdgrasp"]["transform_offset_from_asset_to_graspgen_convention"]
    hands = read.matrices @ homogeneous([position], [turn])
    links = Rotation.from_quat(grasps.rows["base_to_object"][:, 3:].astype(float))
    np.testing.assert_allclose(hands[:, :3, 2], links.apply(scene.gripper.approach_axis), atol=1e-6)
    np.testing.assert_allclose(hands[:, :3, 0], links.apply(scene.gripper.jaw.axis), atol=1e-6)
