"""`qdgrasp import`: files of ours and of others as poses."""

import json
from pathlib import Path

import numpy as np
import pytest
from tests.tools.export.foreign_files import (
    ACROSS,
    COM,
    ISAAC,
    TURN,
    acronym,
    check_pose,
    check_refusal,
    imported_file,
    matrix,
)
from typer.testing import CliRunner

from qdgrasp_coordinator.storage.run_folder import RunFolder
from qdgrasp_protocol.errors import InputError
from qdgrasp_tools.cli.main import app
from qdgrasp_tools.export import importer
from qdgrasp_tools.export.exporter import export_grasps
from qdgrasp_tools.export.importer import ImportedPoses, ObjectFrame


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


TRANSFORMS = {"transforms": [matrix().tolist()]}


@pytest.mark.parametrize(
    "told",
    [
        {"object": "mug.obj", "object_scale": 1.0, "quality_flex_object_in_gripper": [1]} | TRANSFORMS,
        {"object": {"file": "a", "scale": 1.0}, "grasps": TRANSFORMS | {"object_in_gripper": [True]}},
    ],
    ids=["flat", "GraspGen"],
)
def test_json_is_read(panda, tmp_path: Path, told: dict[str, object]) -> None:
    (tmp_path / "f.json").write_text(json.dumps(told))
    check_pose(panda(tmp_path / "f.json"))


def test_the_jaw_of_a_file_may_point_the_other_way(panda, tmp_path: Path) -> None:
    acronym(tmp_path / "f.h5", [matrix(TURN * ACROSS.inv())])
    check_pose(panda(tmp_path / "f.h5", flip_jaw=True))
    (tmp_path / "f.yaml").write_text(ISAAC)
    with pytest.raises(InputError, match="leave --flip-jaw out"):
        panda(tmp_path / "f.yaml", flip_jaw=True)


TAKEN = "they are taken for those of link 'panda_hand' of gripper 'panda'."


@pytest.mark.parametrize(
    ("other", "notes"),
    [
        ({}, []),
        (
            {"object__scale": 0.5},
            ["The file scales its mesh by 0.5, and here it is scaled by 1: "
             "if it is the same mesh, add --units 0.5."],
        ),
        ({"gripper__type": "robotiq"}, [f"The file has poses of gripper 'robotiq'; {TAKEN}"]),
        (("panda_hand", "palm"), [f"The file has poses of link 'palm'; {TAKEN}"]),
        (
            ("panda_finger_joint1", "finger_joint"),
            ["The file names joints that gripper 'panda' does not have: finger_joint; they are ignored."],
        ),
    ],
)  # fmt: skip
def test_another_scale_hand_link_or_joint_is_pointed_out(panda, tmp_path: Path, other, notes) -> None:
    if isinstance(other, dict):
        acronym(tmp_path / "f", [matrix()], **other)
    else:
        (tmp_path / "f").write_text(ISAAC.replace(*other))
    found = panda(tmp_path / "f")
    check_pose(found)
    assert found.notes == tuple(notes)


def test_the_command_takes_a_file_of_another_hand_or_object_only_where_that_is_said(run, tmp_path) -> None:
    export_grasps(run, tmp_path / "f", "parquet")
    out = tmp_path / "poses.npz"
    asked = ["import", str(tmp_path / "f"), "--gripper", "panda", "--object", "mug", "-o", str(out)]
    refusal = CliRunner().invoke(app, asked).exception
    assert isinstance(refusal, InputError)
    assert "of gripper 'jaw'" in str(refusal)
    assert str(refusal).endswith(f"Name the hand and object of '{tmp_path / 'f'}', or add --anyway.")
    assert not out.exists()
    taken = CliRunner().invoke(app, [*asked, "--anyway"])
    assert (taken.exit_code, out.is_file()) == (0, True)
    assert "so it is not the same object" in taken.stderr


def test_an_object_of_another_size_is_another_one_and_a_changed_mesh_is_not(run, tmp_path) -> None:
    export_grasps(run, tmp_path / "f", "parquet")
    scene = run.scene()
    com, size = np.array(scene.object.com_in_mesh), np.subtract(scene.object_high, scene.object_low)
    largest = float(size.max())

    def imported(shift: float, more: float) -> ImportedPoses:
        along, across = np.eye(3)[0] * shift * largest, np.eye(3)[1] * more * largest
        there = ObjectFrame(com + along, 1.0, size + across)
        return importer.import_poses(tmp_path / "f", scene.gripper, there)

    assert (imported(0, 0).mismatches, imported(0, 0).notes) == ((), ())
    assert imported(0.01, 0.01).mismatches == ()
    assert "m large, and the one named here" in imported(0, 0.05).mismatches[0]
    assert "centre of mass elsewhere" in imported(0.05, 0).mismatches[0]


@pytest.mark.parametrize("name", ["acronym", "parquet", "isaac", "graspgen"])
def test_what_was_damaged_anywhere_is_read_or_refused(run: RunFolder, tmp_path: Path, name: str) -> None:
    export_grasps(run, tmp_path / "whole", name)
    content, hand = imported_file(tmp_path / "whole").read_bytes(), run.scene().gripper
    refused, random = 0, np.random.default_rng(0)
    for _ in range(40):
        first, (gone, come) = int(random.integers(len(content))), random.integers(0, 30, 2).tolist()
        (tmp_path / "damaged").write_bytes(content[:first] + random.bytes(come) + content[first + gone :])
        try:
            importer.import_poses(tmp_path / "damaged", hand, ObjectFrame(COM, 1.0, np.ones(3)))
        except InputError:
            refused += 1
    assert refused > 3


BAD_FILES = {
    "empty": (b"", "it is empty"),
    "binary": (b"\0\1\2\3", "it is of none of the formats that are read: ACRONYM"),
    "no JSON": (b"{", "it is damaged, or not of its format"),
    "another JSON": (b'{"a": 1}', "it is damaged, or not of its format"),
    "no transforms": (b'{"transforms": []}', "there is none in it"),
    "too few bits": (
        b'{"transforms": [[[1,0,0,0],[0,1,0,0],[0,0,1,0],[0,0,0,1]]], "quality_flex_object_in_gripper": []}',
        "it has 1 poses, and 0 of its confidence",
    ),
    "a picture": (b"\x89PNG\r\n\x1a\n\0\0", "it is of none of the formats"),
}


@pytest.mark.parametrize(("content", "why"), BAD_FILES.values(), ids=BAD_FILES)
def test_a_file_of_none_of_the_formats_is_refused(panda, tmp_path: Path, content: bytes, why: str) -> None:
    (tmp_path / "f").write_bytes(content)
    check_refusal(panda, tmp_path / "f", why)


def test_what_is_no_file_is_refused(panda, tmp_path: Path) -> None:
    check_refusal(panda, tmp_path / "none", "no such file or directory")
    check_refusal(panda, tmp_path, "it is a folder; name a file in it")
