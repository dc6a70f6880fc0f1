"""Grasps that hands come to, above a table or not, and how files say so."""

import dataclasses
import json
from pathlib import Path

import numpy as np
import pyarrow.parquet
import pytest
from msgspec.structs import replace
from scipy.spatial.transform import Rotation
from tests.coordinator.recorded_runs import record
from tests.tools.export.conftest import COM, random_rows

from qdgrasp_assets.geometry.resting_poses import resting_poses
from qdgrasp_assets.scene import Scene
from qdgrasp_coordinator.search.source_runs import reachable_grasps
from qdgrasp_coordinator.storage.run_folder import RunFolder
from qdgrasp_protocol.errors import ImpossibleValue, InputError
from qdgrasp_protocol.rows import Outcome
from qdgrasp_tools.export.exporter import FORMATS, export_grasps
from qdgrasp_tools.export.grasp_reader import GraspChoice, read_run, select_grasps
from qdgrasp_tools.export.grasp_set import Grasps

POSES = {
    "from above": (Rotation.from_euler("x", 180, degrees=True), (0.0, 0.0, 0.12)),
    "from below": (Rotation.identity(), (0.0, 0.0, -0.12)),
    "from the side, fingers level": (Rotation.from_euler("y", 90, degrees=True), (-0.12, 0.0, 0.0)),
    "from the side, upright": (Rotation.from_euler("zy", (90, 90), degrees=True), (-0.12, 0.0, 0.0)),
    "away from the block": (Rotation.identity(), (0.0, 0.0, 0.04)),
}
"""The jaw at the block of 4 x 5 x 6 cm: how it is turned, and where its palm is [m]."""
ABOVE, BELOW, LEVEL, UPRIGHT, AWAY = range(5)
WAY = 0.1


@pytest.fixture
def made(scene: Scene, tmp_path: Path) -> RunFolder:
    """A run with these hands, all of which hold."""
    rows = random_rows(scene, [Outcome.HELD] * len(POSES))
    for row, (turn, position) in zip(rows, POSES.values(), strict=True):
        row["base_to_object"][:3], row["base_to_object"][3:] = position, turn.as_quat()
    return record(tmp_path / "made", scene, rows, method="contact_rand")


def reachable(run: RunFolder, distance: float | None = None, pose: int | str | None = None) -> Grasps:
    found = read_run(run)
    check = GraspChoice(approach_distance=distance, resting_pose=pose).reachability(found.scene, found.spec)
    return select_grasps(dataclasses.replace(found, approach=check))


def test_hands_come_through_no_object_and_no_table(made: RunFolder) -> None:
    assert reachable(made).numbers.tolist() == [ABOVE, BELOW, LEVEL, UPRIGHT, AWAY]
    assert reachable(made, WAY).numbers.tolist() == [ABOVE, BELOW, LEVEL, UPRIGHT]
    assert reachable(made, 0.0, "any").numbers.tolist() == [ABOVE, BELOW, LEVEL, UPRIGHT, AWAY]
    found = reachable(made, WAY, "any")
    assert found.numbers.tolist() == [ABOVE, BELOW, LEVEL, UPRIGHT]
    assert found.approach is not None
    ups = {number: pose.up for number, pose in found.approach.poses.items()}
    standing = next(number for number, up in ups.items() if up == (0.0, 0.0, 1.0))
    upside_down = next(number for number, up in ups.items() if up == (0.0, 0.0, -1.0))
    assert standing in found.resting_poses[ABOVE]
    assert upside_down not in found.resting_poses[ABOVE]
    assert upside_down in found.resting_poses[BELOW]
    assert {standing, upside_down} <= {*found.resting_poses[LEVEL]}
    assert not {standing, upside_down} & {*found.resting_poses[UPRIGHT]}
    assert reachable(made, WAY, standing).numbers.tolist() == [ABOVE, LEVEL]
    assert reachable(made, pose=standing).numbers.tolist() == [ABOVE, LEVEL]
    shares = [sum(found.approach.poses[number].probability for number in row) for row in found.resting_poses]
    assert found.reach.probability == pytest.approx(shares)
    with pytest.raises(ImpossibleValue, match="'any' or 0 to"):
        reachable(made, WAY, 50)


def test_the_way_begins_behind_the_commanded_pose(made: RunFolder) -> None:
    found = reachable(made, WAY)
    moved = found.approach_poses() - found.poses()
    assert np.allclose(moved[:, :3], -WAY * found.approach_directions)
    assert not moved[:, 3:].any()
    assert np.allclose(found.approach_directions[[ABOVE, BELOW]], [(0, 0, -1), (0, 0, 1)], atol=1e-6)
    with pytest.raises(InputError, match="not asked for"):
        _ = read_run(made).reach


def test_a_reranking_takes_those_that_are_reachable(made: RunFolder) -> None:
    with made.journal() as journal:
        rows = journal.slice(0, journal.count).rows
    assert reachable_grasps(made, rows, WAY)["index"].tolist() == [ABOVE, BELOW, LEVEL, UPRIGHT]
    with pytest.raises(InputError, match="comes to no grasp"):
        reachable_grasps(made, rows[[AWAY]], WAY)


def written(run: RunFolder, tmp_path: Path, name: str) -> Path:
    out = tmp_path / f"out{FORMATS[name].suffix}"
    export_grasps(run, out, name, GraspChoice(approach_distance=WAY, resting_pose="any"))
    return out


START = np.array(COM) + POSES["from above"][1] + np.array([0.0, 0.0, WAY])
"""Where the hand from above comes from, in the frame of the mesh."""


def test_tables_say_how_hands_come(made: RunFolder, tmp_path: Path) -> None:
    table = pyarrow.parquet.read_table(written(made, tmp_path, "parquet"))
    about = json.loads(table.schema.metadata[b"qdgrasp"])
    row = table.to_pylist()[ABOVE]
    assert len(table) == 4
    assert [row[f"approach_from_{axis}"] for axis in "xyz"] == pytest.approx(START, abs=1e-7)
    assert [row[f"approach_{axis}"] for axis in "xyz"] == pytest.approx([0, 0, -1], abs=1e-6)
    assert about["approach_distance"] == WAY
    poses = {pose["number"]: pose for pose in about["resting_poses"]}
    reached = [poses[int(number)] for number in row["resting_poses"].split()]
    assert row["resting_probability"] == pytest.approx(sum(pose["probability"] for pose in reached))
    standing = next(pose for pose in poses.values() if pose["up"] == [0.0, 0.0, 1.0])
    assert standing["height"] == pytest.approx(-0.03 + COM[2])


def test_a_lift_is_told_as_one(scene: Scene, tmp_path: Path) -> None:
    lifted = replace(scene, protocol="lift", resting_poses=resting_poses(scene.object.collision)[:1])
    rows = random_rows(lifted, [Outcome.HELD] * 2)
    rows["fitness"] = 1.0
    turn, position = POSES["from above"]
    rows["base_to_object"] = (*position, *turn.as_quat())
    asked = {"method": "contact_rand", "protocol": "lift", "resting_pose": 0, "approach_distance": 0.0}
    run = record(tmp_path / "lifted", lifted, rows, **asked)
    assert read_run(run).confidence.tolist() == [1.0, 1.0]
    export_grasps(run, tmp_path / "out.csv", "csv")
    said = (tmp_path / "out.csv").read_text()
    assert "# protocol: lift" in said
    assert "# fitness: 1: the hand lifted the object off the table" in said
