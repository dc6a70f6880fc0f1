"""CSV tables are read as they are written."""

from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from qdgrasp_coordinator.storage.tables import csv_text, read_csv
from qdgrasp_protocol.errors import InputError

CELLS = st.text(st.characters(blacklist_categories=("Cs", "Cc"), blacklist_characters="\ufeff"), min_size=1)


@given(rows=st.lists(st.tuples(CELLS, CELLS), min_size=1))
def test_what_is_written_is_read_again(
    tmp_path_factory: pytest.TempPathFactory, rows: list[tuple[str, str]]
) -> None:
    path = tmp_path_factory.mktemp("table") / "table.csv"
    path.write_text(csv_text([{"first": a, "second": b} for a, b in rows]), encoding="utf-8")

    expected = [{"first": a.strip(), "second": b.strip()} for a, b in rows]

    assert read_csv(path, ["second"]) == [row for row in expected if any(row.values())]


@given(cells=st.lists(st.tuples(st.floats(allow_nan=False, allow_infinity=False), st.integers()), min_size=1))
def test_a_table_of_a_spreadsheet_has_semicolons_and_decimal_commas(
    tmp_path_factory: pytest.TempPathFactory, cells: list[tuple[float, int]]
) -> None:
    path = tmp_path_factory.mktemp("table") / "table.csv"
    lines = [f"{str(a).replace('.', ',')};part {b},{b}.stl" for a, b in cells]
    path.write_text("\r\n".join(["\ufeffmass; file", *lines]), encoding="utf-8")

    found = [(float(row["mass"]), row["file"]) for row in read_csv(path, ["file"])]

    assert found == [(a, f"part {b},{b}.stl") for a, b in cells]


def test_columns_are_in_the_order_of_their_first_occurrence() -> None:
    assert csv_text([{"a": 1}, {"b": None, "a": 0.5}]) == "a,b\n1,\n0.5,\n"
    assert csv_text([{"a": 1, "b": 2}], ["b"]) == "b\n2\n"


@pytest.mark.parametrize("text", ["a\n1\n", "a,b\n1,2,3\n", b"\xff\xfe", None])
def test_another_file_is_refused(tmp_path: Path, text: str | bytes | None) -> None:
    path = tmp_path / "table.csv"
    if text is not None:
        path.write_bytes(text.encode() if isinstance(text, str) else text)

    with pytest.raises(InputError, match="cannot be read as a table"):
        read_csv(path, ["a", "b"])
