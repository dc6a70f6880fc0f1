"""What programs of others read of our files: by their own packages, or by readers of their description."""

from pathlib import Path

import numpy as np
import pytest
from tests.tools.export.conftest import COM, MakeRun
from tests.tools.export.independent_readers import (
    READERS,
    acronym_mesh,
    graspdatagen,
    graspgen_contacts,
    graspgen_shards,
)

from qdgrasp_coordinator.storage.run_folder import RunFolder
from qdgrasp_protocol.rows import Outcome
from qdgrasp_tools.export.exporter import export_grasps
from qdgrasp_tools.export.grasp_reader import read_run

OUTCOMES = [*sorted([*Outcome, *Outcome]), *[Outcome.HELD] * 3]


@pytest.fixture
def runs(make_run: MakeRun) -> list[RunFolder]:
    """Two runs of one hand, the second with a point in its name."""
    return [make_run(*OUTCOMES, name=name, seed=seed) for seed, name in enumerate(("cup", "ball.2"))]


@pytest.mark.parametrize("frame", ["mesh", "com"])
def test_acronym_names_a_mesh_that_lies_beside_it_and_has_failures(runs, tmp_path, frame) -> None:
    export_grasps(runs[0], tmp_path / "one.h5", "acronym", frame=frame)
    export_grasps(runs, tmp_path / "all", "acronym", frame=frame)
    files = [tmp_path / "one.h5", *(tmp_path / "all" / "data" / "jaw").glob("*.h5")]
    assert len(files) == 3
    for file in files:
        mesh, read = acronym_mesh(file), READERS["acronym"](file)
        np.testing.assert_allclose(mesh.extents, (0.04, 0.05, 0.06), atol=1e-8)
        np.testing.assert_allclose(mesh.center_mass, COM if frame == "mesh" else np.zeros(3), atol=1e-8)
        assert set(read.quality) == {0, 1}


@pytest.mark.parametrize("evaluated_run", ["panda", "allegro"], indirect=True)
def test_a_jaw_has_two_contacts_across_it_and_another_hand_none(evaluated_run, tmp_path: Path) -> None:
    export_grasps(evaluated_run, tmp_path / "one.h5", "acronym", negatives=0)
    export_grasps(evaluated_run, tmp_path / "many", "graspgen", negatives=0)
    read, file = READERS["acronym"](tmp_path / "one.h5"), READERS["graspgen"](tmp_path / "many").beside
    if evaluated_run.scene().gripper.jaw is None:
        assert "grasps/contact_points" not in read.beside
        assert "contact_locations" not in file["grasps"]
        return
    transforms, pairs = graspgen_contacts(file)
    np.testing.assert_array_equal(transforms, read.matrices)  # every grasp has both
    np.testing.assert_array_equal(pairs, read.beside["grasps/contact_points"])
    across = np.einsum("nij,nj->ni", np.linalg.inv(read.settled)[:, :3, :3], pairs[:, 1] - pairs[:, 0])
    assert (across[:, 0] > 0.02).all()
    assert (np.abs(across[:, 1:]) < 0.03).all()


@pytest.mark.parametrize("several", [False, True])
def test_graspgen_reads_its_shards_as_its_json(runs, tmp_path, several) -> None:
    export_grasps(runs if several else runs[0], tmp_path / "out", "graspgen")
    home = tmp_path / "out" / "data" / "jaw" if several else tmp_path / "out"
    found = graspgen_shards(home / "grasp_shards")
    assert len(found) == (2 if several else 1)
    for uuid, file in found.items():
        assert uuid in (home / "splits" / "train.txt").read_text().split()
        assert np.shape(file["grasps"]["contact_locations"])[1:] == (2, 3)
        assert (home / "object_data" / file["object"]["file"]).is_file()
        assert len(graspgen_contacts(file)[0]) == 0  # no grasp has both fingers' contacts here


def test_graspdatagen_converts_isaac_files(run: RunFolder, tmp_path: Path) -> None:
    export_grasps(run, tmp_path / "out.yaml", "isaac")
    found = graspdatagen(tmp_path / "out.yaml")
    np.testing.assert_allclose(found["transforms"], READERS["isaac"](tmp_path / "out.yaml").settled)
    assert found["object"] == {"file": "block.stl", "scale": 1.0}
    assert all(found["object_in_gripper"])


def test_moveit_closes_the_drives_of_a_hand_with_their_effort(run: RunFolder, tmp_path: Path) -> None:
    export_grasps(run, tmp_path / "out.yaml", "moveit")
    hand = run.scene().gripper
    for message in READERS["moveit"](tmp_path / "out.yaml").beside["grasps"]:
        assert message["grasp_posture"]["joint_names"] == ["left"]  # the other finger of a jaw follows
        assert message["grasp_posture"]["points"][0]["effort"] == [hand.joints[0].effort]


@pytest.mark.parametrize("name", ["parquet", "webdataset"])
def test_a_folder_is_loaded_by_datasets_without_a_name(runs, tmp_path, monkeypatch, name) -> None:
    datasets = pytest.importorskip("datasets", reason="the reader is not installed")
    monkeypatch.setattr(datasets.config, "HF_HUB_OFFLINE", True)
    export_grasps(runs, tmp_path / "out", name)
    found = datasets.load_dataset(str(tmp_path / "out"), cache_dir=str(tmp_path / "cache"))["train"]
    assert len(found) == sum(int(read_run(run).is_grasp.sum()) for run in runs)
    fitness = [each["json"]["fitness"] for each in found] if name == "webdataset" else found["fitness"]
    assert min(fitness) >= 1


def test_a_sample_of_webdataset_is_a_grasp_and_samples_make_batches(runs, tmp_path: Path) -> None:
    reason = "the reader is not installed"
    webdataset = pytest.importorskip("webdataset", reason=reason)
    torch_data = pytest.importorskip("torch.utils.data", reason=reason)
    export_grasps(runs[1], tmp_path / "out.tar", "webdataset")
    samples = webdataset.WebDataset(str(tmp_path / "out.tar"), shardshuffle=False).decode()
    batches = list(torch_data.DataLoader(samples, batch_size=2))
    grasps = read_run(runs[1])
    grasps = grasps[grasps.is_grasp]
    settled = np.concatenate([batch["settled.npy"].numpy() for batch in batches])
    np.testing.assert_allclose(settled, grasps.settled_poses("mesh"), atol=1e-6)
    numbers = [int(number) for batch in batches for number in batch["json"]["number"]]
    assert numbers == grasps.numbers.tolist()
