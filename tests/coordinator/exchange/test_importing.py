"""`qdgrasp import`: files of ours and of others as poses."""

import json
from pathlib import Path

import h5py
import numpy as np
import pytest
import yaml
from tests.coordinator.exchange.conftest import COM as ORIGIN
from tests.coordinator.exchange.conftest import MakeRun
from tests.coordinator.exchange.foreign import (
    COM,
    ISAAC,
    POSITION,
    acronym,
    check_pose,
    check_refusal,
    matrix,
)

from qdgrasp_assets.scene import Scene
from qdgrasp_coordinator.exchange import importing
from qdgrasp_coordinator.exchange.exporting import export
from qdgrasp_coordinator.exchange.taking import read_grasps
from qdgrasp_coordinator.exchange.things import Thing
from qdgrasp_coordinator.exchange.told import Unusable
from qdgrasp_coordinator.folders.folder import RunFolder
from qdgrasp_protocol.outcome import Outcome


def test_grasps_of_other_tools_in_isaac_yaml_are_read(panda, tmp_path: Path) -> None:
    (tmp_path / "f.yaml").write_text(ISAAC)
    found = panda(tmp_path / "f.yaml")
    check_pose(found)
    assert found.arrays["confidence"].tolist() == [0.7]
    assert found.arrays["name"].tolist() == ["grasp 0"]
    assert found.notes == ()


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("_frame_link", "_frame"),
        ("object_frame_link: /World/mug\ngripper_frame_link: /World/panda_hand\n", ""),
        ("format_version: 1.0", 'format_version: "1.0"'),
        ("    confidence: 0.7\n", ""),
        ("0.1, -0.2", "1e-1, -2.0e-01"),
    ],
    ids=["Isaac ROS", "no frames", "a version in quotes", "no confidence", "exponents"],
)
def test_spellings_of_other_writers_are_read(panda, tmp_path: Path, old: str, new: str) -> None:
    assert old in ISAAC
    (tmp_path / "f.yaml").write_text(ISAAC.replace(old, new))
    check_pose(panda(tmp_path / "f.yaml"))


def test_grasps_of_other_tools_in_acronym_files_are_read(panda, tmp_path: Path) -> None:
    acronym(tmp_path / "f.h5", [matrix()])
    check_pose(panda(tmp_path / "f.h5"))


def test_flat_json_is_read(panda, tmp_path: Path) -> None:
    told = {
        "object": "mug.obj",
        "object_scale": 1.0,
        "transforms": [matrix().tolist()],
        "quality_flex_object_in_gripper": [1],
    }
    (tmp_path / "f.json").write_text(json.dumps(told))
    check_pose(panda(tmp_path / "f.json"))


def test_graspgen_json_is_read(panda, tmp_path: Path) -> None:
    grasps = {"transforms": [matrix().tolist()], "object_in_gripper": [True]}
    (tmp_path / "f.json").write_text(json.dumps({"object": {"file": "a", "scale": 1.0}, "grasps": grasps}))
    check_pose(panda(tmp_path / "f.json"))


def test_poses_may_be_told_at_the_centre_of_mass(panda, tmp_path: Path) -> None:
    (tmp_path / "f.yaml").write_text(ISAAC)
    check_pose(panda(tmp_path / "f.yaml", frame="com"), POSITION)


def test_another_scale_is_pointed_out(panda, tmp_path: Path) -> None:
    acronym(tmp_path / "f.h5", [matrix()])
    with h5py.File(tmp_path / "f.h5", "a") as file:
        file["object/scale"][()] = 0.5
    (note,) = panda(tmp_path / "f.h5").notes
    assert note == (
        "The file scales its mesh by 0.5, and here it is scaled by 1: "
        "if it is the same mesh, add --scale 0.5."
    )


def test_another_object_and_another_link_are_pointed_out(run: RunFolder, panda, tmp_path: Path) -> None:
    export(run, tmp_path / "f", "parquet")
    assert panda(tmp_path / "f").notes == (
        "The file tells poses of link 'palm' of gripper 'jaw'; they are taken for those of link "
        "'panda_hand' of gripper 'panda'.",
        "The file names joints that gripper 'panda' does not have: left, right; they are left aside.",
        "The object 'block' of the file has its centre of mass elsewhere in its mesh, so it is not the same "
        "object.",
    )
    hand = run.scene().gripper
    found = importing.read_grasps(tmp_path / "f", hand, Thing(COM, 1.0))
    assert [note[:39] for note in found.notes] == ["The object 'block' of the file has its "]


def test_a_pose_stays_where_it_is_in_the_mesh_if_the_centre_of_mass_is_elsewhere(
    run: RunFolder, scene: Scene, tmp_path: Path
) -> None:
    grasps = read_grasps(run)
    export(run, tmp_path / "f", "parquet", min_fitness=0)
    found = importing.read_grasps(tmp_path / "f", scene.gripper, Thing(COM, 1.0))
    np.testing.assert_allclose(found.arrays["base_position"], grasps.poses("mesh")[:, :3] - COM, atol=1e-7)


@pytest.mark.parametrize("name", ["parquet", "isaac", "acronym", "graspgen"])
def test_a_frame_other_than_that_of_the_file_is_refused_and_its_own_changes_nothing(
    run: RunFolder, tmp_path: Path, name: str
) -> None:
    out = tmp_path / "f"
    export(run, out, name)
    file = out / "grasp_data" / "block.json" if out.is_dir() else out
    hand, thing = run.scene().gripper, Thing(COM, 1.0)
    plain, named = (importing.read_grasps(file, hand, thing, frame) for frame in (None, "mesh"))
    np.testing.assert_array_equal(named.arrays["base_position"], plain.arrays["base_position"])
    with pytest.raises(Unusable, match="poses are told in the object's mesh frame; leave --frame out"):
        importing.read_grasps(file, hand, thing, "com")


@pytest.mark.parametrize(
    ("changed", "why"),
    [
        ({"com_in_mesh": ["nan", 0, 0]}, "com_in_mesh in it must be finite"),
        ({"com_in_mesh": [0, 1e300, 0]}, "com_in_mesh in it must be finite, and not more than 1000 m away"),
        ({"object_mass": -3}, "object_mass in it must be a number greater than 0, and is -3"),
        ({"object_mass": "nan"}, "object_mass in it must be a number greater than 0, and is nan"),
        ({"object_scale": 0}, "scale in it must be a number greater than 0, and is 0"),
        ({"object_friction": -0.5}, "object_friction in it must not be negative, and is -0.5"),
        ({"runs": [{"run": "a", "digest": "", "spec": "own?"}]}, "the spec of run 'a' in it cannot be read"),
    ],
)
def test_impossible_numbers_in_what_a_file_of_ours_says_are_refused(
    run: RunFolder, panda, tmp_path: Path, changed: dict[str, object], why: str
) -> None:
    export(run, tmp_path / "f", "isaac")
    told = yaml.safe_load((tmp_path / "f").read_text())
    told["qdgrasp"] |= changed
    (tmp_path / "f").write_text(yaml.safe_dump(told))
    check_refusal(panda, tmp_path / "f", why)


def test_joints_that_the_hand_does_not_have_are_left_aside_with_a_note(panda, tmp_path: Path) -> None:
    (tmp_path / "f.yaml").write_text(ISAAC.replace("panda_finger_joint1", "finger_joint"))
    found = panda(tmp_path / "f.yaml")
    check_pose(found)
    assert found.notes == (
        "The file names joints that gripper 'panda' does not have: finger_joint; they are left aside.",
    )


def test_a_file_of_another_gripper_is_pointed_out(panda, tmp_path: Path) -> None:
    acronym(tmp_path / "f.h5", [matrix()], gripper__type="robotiq")
    (tmp_path / "f.yaml").write_text(ISAAC.replace("panda_hand", "palm"))
    taken = "; they are taken for those of link 'panda_hand' of gripper 'panda'."
    assert panda(tmp_path / "f.h5").notes == (f"The file tells poses of gripper 'robotiq'{taken}",)
    assert panda(tmp_path / "f.yaml").notes == (f"The file tells poses of link 'palm'{taken}",)


def test_a_graspgen_file_of_a_scaled_object_is_of_that_scale(make_run: MakeRun, tmp_path: Path) -> None:
    run = make_run(Outcome.HELD, scale=0.001)
    export(run, tmp_path / "out", "graspgen")
    file, hand = tmp_path / "out" / "grasp_data" / "block.json", run.scene().gripper
    assert importing.read_grasps(file, hand, Thing(np.array(ORIGIN), 0.001)).notes == ()
