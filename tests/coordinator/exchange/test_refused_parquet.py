"""Parquet files that tell no grasps, and how they are refused."""

from pathlib import Path

import pyarrow as pa
import pyarrow.parquet
import pytest
from tests.coordinator.exchange.foreign import check_refusal

from qdgrasp_coordinator.exchange import parquet
from qdgrasp_coordinator.exchange.exporting import export
from qdgrasp_coordinator.folders.folder import RunFolder


def test_a_parquet_file_of_others_is_refused(panda, tmp_path: Path) -> None:
    pyarrow.parquet.write_table(pa.table({"a": [1]}), tmp_path / "f.parquet")
    check_refusal(panda, tmp_path / "f.parquet", "not one that `qdgrasp export` wrote")


def test_a_parquet_file_without_its_columns_is_refused(run: RunFolder, panda, tmp_path: Path) -> None:
    export(run, tmp_path / "whole", "parquet")
    table = pyarrow.parquet.read_table(tmp_path / "whole").drop_columns(["base_to_object"])
    pyarrow.parquet.write_table(table, tmp_path / "f.parquet")
    check_refusal(panda, tmp_path / "f.parquet", "it is a damaged Parquet file")


def test_a_small_parquet_file_that_stands_for_much_is_refused(
    run: RunFolder, panda, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    export(run, tmp_path / "f", "parquet")
    monkeypatch.setattr(parquet, "MOST_NUMBERS", 10)
    check_refusal(panda, tmp_path / "f", "it has more than 10 numbers")


def test_a_parquet_file_with_long_words_is_refused(run: RunFolder, panda, tmp_path: Path) -> None:
    export(run, tmp_path / "whole", "parquet")
    table = pyarrow.parquet.read_table(tmp_path / "whole")
    words = pa.array(["a" * 1000] * len(table)).dictionary_encode()
    table = table.set_column(table.schema.get_field_index("synergy"), "synergy", words)
    pyarrow.parquet.write_table(table, tmp_path / "f.parquet")
    check_refusal(panda, tmp_path / "f.parquet", "its synergies must be of 200 letters at most")
