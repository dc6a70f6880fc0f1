"""Reach of an arm: its joints put the hand where it is to be, checked by other kinematics."""

import csv
import re
from itertools import product
from pathlib import Path
from shutil import copy

import numpy as np
import pytest
from msgspec import structs
from pyarrow import parquet
from scipy.spatial.transform import Rotation
from typer.testing import CliRunner

from qdgrasp_assets.geometry.mesh import hull, parts_to_obj
from qdgrasp_assets.grippers.urdf import read_urdf
from qdgrasp_coordinator.storage.run_folder import RunFolder
from qdgrasp_protocol.errors import InputError
from qdgrasp_protocol.rows import Outcome
from qdgrasp_tools.cli.main import app
from qdgrasp_tools.export.arm import Arm
from qdgrasp_tools.export.grasp_table import to_matrices

PANDA = Path(pytest.importorskip("pybullet_data").getDataPath(), "franka_panda", "panda.urdf")
BASE, ON_FLANGE = (-0.5, 0.1, -0.2, 0.0, 0.0, 0.3), (0.0, 0.01, 0.02, 0.1, 0.2, -0.7)
AXIS, DISTANCE = np.array([0.0, 0.0, 1.0]), 0.1


def matrix(pose: tuple[float, ...]) -> np.ndarray:
    made = np.eye(4)
    made[:3, :3], made[:3, 3] = Rotation.from_euler("xyz", pose[3:]).as_matrix(), pose[:3]
    return made


def test_the_hand_is_at_each_pose_and_on_the_way_there_where_an_arm_reaches_it() -> None:
    arm, robot = Arm(PANDA, "mesh", BASE, "palm", "panda_hand", ON_FLANGE), read_urdf(PANDA)
    names = [joint.name for joint in robot.joints if joint.kind == "revolute"]
    turns = Rotation.random(100, random_state=0)
    poses = np.hstack([-0.1 * turns.apply(AXIS), turns.as_quat()])
    reached = 0
    for pose, joints in zip(poses, arm.columns(poses, AXIS, DISTANCE)[1].values, strict=True):
        way = arm.way(pose, AXIS, DISTANCE)
        np.testing.assert_array_equal(way[0], joints)
        if np.isnan(joints[0]):
            continue
        reached += 1
        hand = robot.forward(dict(zip(names, way.T, strict=True)), matrix(BASE))["panda_hand"] @ matrix(
            ON_FLANGE
        )
        aimed = np.repeat(to_matrices(pose[None]), len(way), axis=0)
        aimed[:, :3, 3] -= np.linspace(0, DISTANCE, len(way))[:, None] * aimed[0, :3, 2]
        assert np.linalg.norm(hand[:, :3, 3] - aimed[:, :3, 3], axis=1).max() < 1e-3
        off = Rotation.from_matrix(hand[:, :3, :3]).inv() * Rotation.from_matrix(aimed[:, :3, :3])
        assert np.degrees(off.magnitude()).max() < 0.5
        assert np.abs(np.diff(way, axis=0)).max() < 0.5
    assert reached >= 50


def test_it_reaches_no_grasp_through_a_neighbour_of_the_object(make_run, tmp_path) -> None:
    scene, arm = make_run(Outcome.HELD).scene(), Arm(PANDA, "com", BASE, "palm", "panda_hand", ON_FLANGE)
    turns = Rotation.random(12, random_state=1)
    poses = np.hstack([-0.1 * turns.apply(AXIS), turns.as_quat()])
    free = arm.columns(poses, AXIS, DISTANCE)[0].values
    assert free.sum() > 3
    plate = np.array([*product((0.0, 0.02), (-2.0, 2.0), (-2.0, 2.0))])
    for place, reached in ((-0.25, np.zeros(12, bool)), (1.5, free)):  # before the object, and far behind it
        beside = structs.replace(scene, neighbours=parts_to_obj([hull(plate + np.array([place, 0, 0]))]))
        assert np.array_equal(arm.among(beside).columns(poses, AXIS, DISTANCE)[0].values, reached)
    copy(PANDA, tmp_path / "arm.urdf")
    with pytest.raises(InputError, match="meshes of its links are not where"):
        Arm(tmp_path / "arm.urdf", "com", BASE, "palm", "panda_hand", ON_FLANGE).among(beside)


FLAGS = ("--arm", PANDA, "--base", -0.7, *BASE[1:], "--flange", "panda_hand")


def export(run: RunFolder, out: Path, *flags: object) -> BaseException | None:
    command = ["export", run.path, "--format", out.suffix[1:], "--min-fitness", 0, "-o", out, *flags]
    return CliRunner().invoke(app, list(map(str, command))).exception


def test_tables_have_the_joints_and_leave_out_what_is_out_of_reach_if_asked(make_run, tmp_path) -> None:
    run = make_run(*[Outcome.HELD] * 20)
    assert export(run, tmp_path / "all.parquet", *FLAGS) is None
    assert export(run, tmp_path / "some.csv", *FLAGS, "--reachable") is None
    every = parquet.read_table(tmp_path / "all.parquet").to_pylist()
    near = [grasp for grasp in every if grasp["reachable"]]
    assert 3 < len(near) < len(every) == 20
    assert all((grasp["arm_joints"] is None) != grasp["reachable"] for grasp in every)
    with (tmp_path / "some.csv").open() as file:
        lines = list(csv.DictReader(line for line in file if line[0] != "#"))
    assert [int(line["number"]) for line in lines] == [grasp["number"] for grasp in near]
    assert list(map(float, lines[0]["arm_joints"].split())) == near[0]["arm_joints"]


@pytest.mark.parametrize(
    ("flags", "words"),
    [
        (FLAGS[:2], "--arm and --base go together"),
        (("--reachable",), "--reachable with them"),
        ((*FLAGS[:-1], "wrist"), "Unknown link of the arm 'wrist'"),
        (FLAGS[:-2], "Unknown link of the arm 'palm'"),
        ((*FLAGS[:-1], "panda_link0"), "No joint of .* moves its link 'panda_link0'"),
        (("--arm", __file__, *FLAGS[2:]), "test_arm.py"),
        ((*FLAGS[:2], "--base", 9, 9, 9, 0, 0, 0, *FLAGS[9:], "--reachable"), "has no such grasp"),
    ],
)
def test_what_cannot_be_is_refused_in_a_sentence(make_run, tmp_path, flags, words) -> None:
    refused = export(make_run(Outcome.HELD), tmp_path / "out.csv", *flags)
    assert isinstance(refused, InputError)
    assert re.search(words, str(refused))
