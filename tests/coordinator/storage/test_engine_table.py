"""Tables of another engine's verdicts: written, read, and unknown for other rows."""

import numpy as np
import pytest
from tests.coordinator.recorded_runs import record
from tests.coordinator.scenes import made_scene

from qdgrasp_coordinator.storage.engine_table import (
    HeldShare,
    held_shares,
    other_tables,
    read_table,
    table_path,
    verdicts,
    write_table,
)
from qdgrasp_coordinator.storage.run_folder import RunFolder
from qdgrasp_protocol.errors import InputError
from qdgrasp_protocol.rows import Outcome, Rows, RowShape

DROPPED, SHAKEN, HELD = Outcome.DROPPED, Outcome.SHAKEN, Outcome.HELD
FITNESS = {DROPPED: 0, SHAKEN: 2, HELD: 6}
RECORDED = [HELD, DROPPED, HELD, SHAKEN, HELD]
NUMBERS = np.arange(len(RECORDED))


def rows_of(*outcomes: Outcome) -> Rows:
    rows = RowShape(7, 1).empty(len(outcomes))
    rows["outcome"] = outcomes
    rows["fitness"] = [FITNESS.get(each, 0) for each in outcomes]
    return rows


@pytest.fixture
def folder(tmp_path) -> RunFolder:
    return record(tmp_path / "run", made_scene(), rows_of(), method="contact_rand", protocol="physical")


def write(folder: RunFolder, numbers: list[int], *now: Outcome, engine: str = "mujoco") -> None:
    recorded = rows_of(*(RECORDED[number] for number in numbers))
    write_table(folder, engine, np.array(numbers), recorded, rows_of(*now))


def test_both_verdicts_of_each_row_are_in_the_table(folder):
    write(folder, [0, 1, 3], SHAKEN, HELD, Outcome.OVERLAP)
    assert table_path(folder, "mujoco").read_text().splitlines() == [
        "row,outcome,fitness,outcome_now,fitness_now",
        "0,held,6,shaken,2",
        "1,dropped,0,held,6",
        "3,shaken,2,overlap,0",
    ]
    found = verdicts(read_table(table_path(folder, "mujoco")), NUMBERS, np.array(RECORDED))
    assert found["outcome"].tolist() == [SHAKEN, HELD, -1, Outcome.OVERLAP, -1]
    np.testing.assert_array_equal(found["fitness"], [2, 6, np.nan, 0, np.nan])


def test_a_sample_keeps_what_the_table_has_of_other_rows_and_renews_its_own(folder):
    write(folder, [0, 2, 4], HELD, HELD, HELD)
    write(folder, [1, 2], DROPPED, SHAKEN)
    table = read_table(table_path(folder, "mujoco"))
    assert table["row"].tolist() == [0, 1, 2, 4]
    assert table["outcome_now"].tolist() == [HELD, DROPPED, SHAKEN, HELD]


def test_a_row_of_another_recorded_outcome_is_not_known(folder):
    write(folder, [0, 2], HELD, HELD)
    other = np.array([HELD, HELD, DROPPED, HELD, HELD])
    (table,) = other_tables(folder).values()
    assert verdicts(table, NUMBERS, other)["outcome"].tolist() == [HELD, -1, -1, -1, -1]
    assert verdicts(table[:0], NUMBERS, other)["outcome"].tolist() == [-1] * 5


def test_the_share_is_of_those_that_hold_as_recorded(folder):
    assert held_shares(folder) == {}
    write(folder, [0, 1, 2, 3], HELD, HELD, SHAKEN, HELD)
    assert held_shares(folder) == {"mujoco": HeldShare(1, 2)}
    assert held_shares(folder)["mujoco"].words == "1 of 2, 50%"
    assert HeldShare(0, 0).words == "0 of 0"


@pytest.mark.parametrize(
    "text",
    ["row,outcome\n1,held\n"]
    + [
        f"row,outcome,fitness,outcome_now,fitness_now\n{line}\n"
        for line in ("1,x,6,held,6", "5", "1,held,inf,held,6")
    ]
    + ["row,outcome,fitness,outcome_now,fitness_now\n12345678901234567890,held,6,held,6\n"],
)
def test_another_file_of_that_name_is_refused_in_one_sentence(folder, text):
    table_path(folder, "mujoco").write_text(text)
    with pytest.raises(InputError, match=r"is no table that `qdgrasp verify --engine` wrote .*; remove it"):
        other_tables(folder)
