"""Every format, by independent readers; and the metadata in its files."""

from dataclasses import replace
from pathlib import Path

import msgspec
import numpy as np
import pyarrow.parquet
import pytest
import trimesh
from scipy.spatial.transform import Rotation
from tests.coordinator.recorded_runs import record
from tests.coordinator.scenes import restricted_scene
from tests.tools.export.conftest import COM, random_rows
from tests.tools.export.independent_readers import READERS, TURNED, Read, homogeneous

from qdgrasp_assets.scene import Scene
from qdgrasp_coordinator.storage.run_folder import RunFolder
from qdgrasp_protocol.errors import InputError
from qdgrasp_protocol.rows import Outcome, Rows
from qdgrasp_protocol.spec import from_toml
from qdgrasp_tools.export import exporter
from qdgrasp_tools.export.exporter import FORMATS, export_grasps
from qdgrasp_tools.export.grasp_reader import GraspChoice, read_run
from qdgrasp_tools.export.grasp_set import Grasps
from qdgrasp_tools.export.grasp_table import GraspMetadata
from qdgrasp_tools.export.tabular import read_parquet

ACROSS = Rotation.from_euler("z", -90, degrees=True)
"""The jaw's own axes open along y; turned by this first, they open along x, as NVIDIA's hands do."""
ORIGINS = {"mesh": COM, "com": (0.0, 0.0, 0.0)}
"""The centre of mass in each frame."""


@pytest.fixture
def grasps(run: RunFolder) -> Grasps:
    """The successes that survived a shake."""
    found = read_run(run)
    return found[found.is_grasp]


def expected(rows: Rows, column: str, name: str, origin: tuple[float, float, float]) -> np.ndarray:
    """The poses of a column as matrices, by another library."""
    matrices = homogeneous(rows[column])
    if name in TURNED:
        matrices[:, :3, :3] = matrices[:, :3, :3] @ ACROSS.as_matrix()
    matrices[:, :3, 3] += origin
    return matrices


def files(out: Path) -> dict[Path, bytes]:
    found = out.rglob("*") if out.is_dir() else [out]
    return {file.relative_to(out): file.read_bytes() for file in found if file.is_file()}


@pytest.mark.parametrize("name", READERS)
class TestFormat:
    """What holds of every format."""

    def read(self, run: RunFolder, out: Path, name: str, **settings: object) -> Read:
        export_grasps(run, out, name, **settings)
        return READERS[name](out)

    @pytest.mark.parametrize("frame", ORIGINS)
    def test_another_reader_finds_what_the_run_recorded(self, run, grasps, tmp_path, name, frame) -> None:
        read = self.read(run, tmp_path / "out", name, frame=frame, negatives=0)
        for matrices, column in ((read.matrices, "base_to_object"), (read.settled, "settled")):
            ours = expected(grasps.rows, column, name, ORIGINS[frame])
            np.testing.assert_allclose(matrices, ours, atol=1e-7)
        better = np.ones(len(grasps)) if name in TURNED else grasps.fitness / 2
        np.testing.assert_array_equal(read.quality, better)
        for place, joint in enumerate(("left",) if name == "moveit" else ("left", "right")):
            np.testing.assert_allclose(read.joints[joint], grasps.joints[:, place], rtol=1e-7)
            np.testing.assert_allclose(read.starts[joint], 0.04, rtol=1e-7)
            np.testing.assert_array_equal(read.squeeze[joint], 0.0)  # `paper` closes all the way
        np.testing.assert_allclose(read.penetration, grasps.rows["penetration"], rtol=1e-7)
        recorded = grasps.rows["contact_points"].astype(float).reshape(len(grasps), -1, 7)
        for contacts, values in zip(read.contacts or (), recorded, strict=read.contacts is not None):
            assert [contact.link for contact in contacts] == ["palm", "left_finger"]
            flat = [contact.values - [*ORIGINS[frame], 0, 0, 0, 0] for contact in contacts]
            np.testing.assert_allclose(flat, values[:2], atol=1e-6, rtol=1e-6)

    def test_every_file_says_frames_units_and_licences(self, run, tmp_path, name) -> None:
        about = self.read(run, tmp_path / "out", name).about
        asked = {"runs", "arm", "original_base", "approach_distance", "resting_poses"}
        assert set(GraspMetadata.__struct_fields__) - asked <= set(about)
        assert "original_base" not in about
        assert (about["gripper"], about["gripper_frame"], about["object"]) == ("jaw", "palm", "block")
        assert (about["frame"], about["units"], about["protocol"]) == ("mesh", "m, rad, kg, N", "paper")
        assert (about["gripper_licence"], about["object_licence"]) == ("Apache-2.0", "Apache-2.0")
        assert float(about["object_scale"]) == 1.0
        assert ("x from one finger to the other" in about["gripper_axes"]) == (name in TURNED)

    def test_a_file_of_a_centred_hand_says_where_its_original_base_link_is(self, scene, tmp_path, name):
        centred = (
            '<link name="palm_centre"/><joint name="palm_centre_joint" type="fixed">'
            '<parent link="palm_centre"/><child link="palm"/><origin xyz="-0.08 0 0.01"/></joint></robot>'
        )
        urdf = scene.gripper.urdf.replace("</robot>", centred)
        hand = msgspec.structs.replace(scene.gripper, urdf=urdf, base_link="palm_centre")
        rows, scene = random_rows(scene, [Outcome.HELD] * 2), msgspec.structs.replace(scene, gripper=hand)
        run = record(tmp_path / "run", scene, rows, method="contact_rand")
        base = str(self.read(run, tmp_path / "out", name).about["original_base"])
        assert "palm" in base
        assert "-0.08" in base

    def test_no_file_says_in_which_folders_its_author_has_files(self, make_run, tmp_path, name) -> None:
        run = make_run(Outcome.HELD, gripper="/home/somebody/hand.toml", object="/home/somebody/block.stl")
        about = self.read(run, tmp_path / "out", name).about
        whole = b"".join(files(tmp_path / "out").values())
        assert b"somebody" not in whole
        assert about["object_file"] == "block.stl"
        if name == "csv":
            assert b'#   gripper = "hand.toml"' in whole
            return
        (spec,) = (from_toml(each["spec"]) for each in about["runs"])
        assert spec == msgspec.structs.replace(run.spec, gripper="hand.toml", object="block.stl")

    def test_joints_of_the_real_hand_that_stand_still_are_named_too(self, make_run, tmp_path, name) -> None:
        read = self.read(make_run(Outcome.HELD, gripper="allegro"), tmp_path / "out", name)
        for joints in (read.starts, read.joints, read.squeeze):
            np.testing.assert_allclose(joints["joint_12"], 1.396, rtol=1e-7)

    def test_the_same_run_gives_the_same_bytes(self, run, tmp_path, name) -> None:
        for out in ("one", "two"):
            export_grasps(run, tmp_path / out / "out", name)
        assert files(tmp_path / "one") == files(tmp_path / "two")

    def test_a_run_without_settled_poses_says_so_and_leaves_them_out(self, scene, tmp_path, name) -> None:
        early = msgspec.structs.replace(scene, contact_slots=0)
        run = record(tmp_path / "run", early, random_rows(early, [Outcome.HELD] * 2), method="contact_rand")
        read = self.read(run, tmp_path / "out", name)
        assert read.about["settled"].startswith("recorded of 0 of 2 successes")
        if name in ("isaac", "moveit", "dexgraspbench"):
            np.testing.assert_allclose(read.settled, read.matrices, atol=1e-7)
        else:
            assert np.isnan(read.settled).all()
        assert not any(read.contacts or ())

    def test_what_fails_on_the_way_leaves_what_was_there(self, run, tmp_path, monkeypatch, name) -> None:
        def half(path: Path, grasps: Grasps, about: GraspMetadata) -> None:
            FORMATS[name].write(path, grasps, about)
            raise OSError(28, "No space left on device")

        for before in ({}, None):
            if before is None:
                export_grasps(run, tmp_path / "out", name)
                before = files(tmp_path / "out")
            with monkeypatch.context() as patch:
                patch.setattr(exporter, "format_of", lambda name: replace(FORMATS[name], write=half))
                with pytest.raises(InputError, match="no space left on device"):
                    export_grasps(run, tmp_path / "out", name, GraspChoice(min_fitness=2), force=True)
            there = {path.name for path in tmp_path.iterdir()} - {"out-object.obj"}
            assert there == ({"run", "out"} if before else {"run"})
            assert not before or files(tmp_path / "out") == before


def test_parquet_says_in_which_region_a_contact_is(scene, tmp_path) -> None:
    scene = msgspec.structs.replace(scene, regions=restricted_scene().regions)
    rows = random_rows(scene, [Outcome.HELD] * 9 + [Outcome.BRUSHED])
    run = record(tmp_path / "run", scene, rows, method="contact_rand")
    export_grasps(run, tmp_path / "out.parquet", "parquet", frame="com", negatives=1)
    *held, brushed = pyarrow.parquet.read_table(tmp_path / "out.parquet").to_pylist()
    for row in held:
        for contact, name in zip(row["contact_points"], row["contact_regions"], strict=True):
            assert (name == "top") == (contact["z"] > 0) or abs(contact["z"]) < 0.015
    assert brushed["contact_regions"] is None
    assert len(read_parquet(tmp_path / "out.parquet")) == 10


def test_graspgen_has_failures_and_the_mesh_that_its_poses_are_of(run, tmp_path) -> None:
    export_grasps(run, tmp_path / "out", "graspgen")
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
    export_grasps(run, tmp_path / "out", "graspgen", negatives=0)
    read = READERS["graspgen"](tmp_path / "out")
    position, turn = read.about["transform_offset_from_asset_to_graspgen_convention"]
    hands = read.matrices @ homogeneous([[*position, *turn]])
    links = Rotation.from_quat(grasps.rows["base_to_object"][:, 3:].astype(float))
    np.testing.assert_allclose(hands[:, :3, 2], links.apply(scene.gripper.approach_axis), atol=1e-6)
    np.testing.assert_allclose(hands[:, :3, 0], -links.apply(scene.gripper.jaw.axis), atol=1e-6)
