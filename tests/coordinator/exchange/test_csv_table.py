"""CSV: what its lines say, as the line of docs/formats.md reads it."""

from pathlib import Path

import pandas
import pytest
from msgspec.structs import replace
from tests.coordinator.exchange.conftest import MakeRun, random_rows
from tests.coordinator.recorded_runs import record

from qdgrasp_assets.scene import Scene
from qdgrasp_coordinator.exchange.exporting import export
from qdgrasp_protocol.outcome import Outcome


def as_documented(path: Path) -> pandas.DataFrame:
    return pandas.read_csv(path, comment="#")


@pytest.mark.parametrize("name", ["run#1", "#first", 'a "b", c', "#", "# \n2"])
def test_no_character_in_the_name_of_a_run_costs_a_reader_its_rows(
    make_run: MakeRun, tmp_path: Path, name: str
) -> None:
    export(make_run(Outcome.HELD, Outcome.SHAKEN, name=name), tmp_path / "out.csv", "csv")
    table = as_documented(tmp_path / "out.csv")
    assert table.run.tolist() == [name, name]
    assert table.outcome.tolist() == ["held", "shaken"]
    assert table.qw.notna().all()
    assert table.contacts.tolist() == [0, 0]


def test_no_character_in_the_name_of_a_joint_costs_a_reader_its_columns(scene: Scene, tmp_path: Path) -> None:
    first, *others = scene.gripper.joints
    joints = (replace(first, name="thumb #1, left"), *others)
    strange = replace(scene, gripper=replace(scene.gripper, joints=joints))
    run = record(tmp_path / "run", strange, random_rows(strange, [Outcome.HELD]), method="contact_rand")
    export(run, tmp_path / "out.csv", "csv")
    table = as_documented(tmp_path / "out.csv")
    assert table["joint.thumb #1, left"].notna().all()
    assert table.penetration.notna().all()
