"""CSV: its lines, as the command of docs/formats.md reads them."""

from pathlib import Path

import pandas
import pyarrow as pa
import pyarrow.parquet
import pytest
from msgspec.structs import replace
from tests.coordinator.recorded_runs import record
from tests.tools.export.conftest import random_rows
from tests.tools.export.foreign_files import check_refusal

from qdgrasp_assets.scene import Scene
from qdgrasp_coordinator.storage.run_folder import RunFolder
from qdgrasp_protocol.rows import Outcome
from qdgrasp_tools.export import tabular
from qdgrasp_tools.export.exporter import export_run


def as_documented(path: Path) -> pandas.DataFrame:
    return pandas.read_csv(path, comment="#")


@pytest.mark.parametrize("name", ["run#1", "#first", 'a "b", c', "#", "# \n2"])
def test_no_character_in_the_name_of_a_run_costs_a_reader_its_rows(make_run, tmp_path, name) -> None:
    export_run(make_run(Outcome.HELD, Outcome.SHAKEN, name=name), tmp_path / "out.csv", "csv")
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
    export_run(run, tmp_path / "out.csv", "csv")
    table = as_documented(tmp_path / "out.csv")
    assert table["joint.thumb #1, left"].notna().all()
    assert table.penetration.notna().all()


def test_a_parquet_file_of_others_is_refused(panda, tmp_path: Path) -> None:
    pyarrow.parquet.write_table(pa.table({"a": [1]}), tmp_path / "f.parquet")
    check_refusal(panda, tmp_path / "f.parquet", "not one that `qdgrasp export` wrote")


def test_a_parquet_file_without_its_columns_is_refused(run: RunFolder, panda, tmp_path: Path) -> None:
    export_run(run, tmp_path / "whole", "parquet")
    table = pyarrow.parquet.read_table(tmp_path / "whole").drop_columns(["base_to_object"])
    pyarrow.parquet.write_table(table, tmp_path / "f.parquet")
    check_refusal(panda, tmp_path / "f.parquet", "it is a damaged Parquet file")


def test_a_small_parquet_file_that_stands_for_much_is_refused(run, panda, tmp_path, monkeypatch) -> None:
    export_run(run, tmp_path / "f", "parquet")
    monkeypatch.setattr(tabular, "MOST_NUMBERS", 10)
    check_refusal(panda, tmp_path / "f", "it has more than 10 numbers")


def test_a_parquet_file_with_long_words_is_refused(run: RunFolder, panda, tmp_path: Path) -> None:
    export_run(run, tmp_path / "whole", "parquet")
    table = pyarrow.parquet.read_table(tmp_path / "whole")
    words = pa.array(["a" * 1000] * len(table)).dictionary_encode()
    table = table.set_column(table.schema.get_field_index("synergy"), "synergy", words)
    pyarrow.parquet.write_table(table, tmp_path / "f.parquet")
    check_refusal(panda, tmp_path / "f.parquet", "its synergies must be of 200 letters at most")
