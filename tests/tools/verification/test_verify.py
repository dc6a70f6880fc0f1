"""Choice of rows, each kind with its share, and their comparison."""

from pathlib import Path

import numpy as np
import pytest
from tests.coordinator.recorded_runs import random_rows, record, reshape_rows
from tests.coordinator.scenes import made_scene

from qdgrasp_coordinator.storage.engine_table import read_table
from qdgrasp_coordinator.storage.run_folder import RunFolder
from qdgrasp_protocol.errors import InputError
from qdgrasp_protocol.process import Stop
from qdgrasp_protocol.rows import Outcome, Rows, RowShape
from qdgrasp_tools.local.supervisor import LocalJobConfig
from qdgrasp_tools.verification import verify
from qdgrasp_tools.verification.verify import (
    MOST_ROWS,
    ReevaluationQueue,
    balanced_sample,
    choose_rows,
    compare_engine,
)

KINDS = np.repeat(np.array([1, 2, 4, 7], dtype=np.uint8), [500, 3, 40, 8])


def drawn(n: int, seed: int = 0) -> np.ndarray:
    return balanced_sample(KINDS, n, np.random.default_rng(seed))


@pytest.mark.parametrize("n", [1, 12, 30, 100, 551])
def test_no_kind_has_more_than_another_unless_that_has_no_more(n: int) -> None:
    assert (np.diff(drawn(n)) > 0).all(), "each row once, and in order"
    found = np.bincount(KINDS[drawn(n)], minlength=8)
    there = np.bincount(KINDS, minlength=8)
    assert found.sum() == n
    assert all(found[k] == there[k] or found[k] >= found.max() - 1 for k in (1, 2, 4, 7))


def test_all_rows_are_drawn_where_there_are_no_more() -> None:
    assert drawn(10_000).tolist() == list(range(len(KINDS)))
    assert len(balanced_sample(KINDS[:0], 5, np.random.default_rng(0))) == 0


def test_a_seed_draws_the_same_again_or_more_of_it_and_another_one_others() -> None:
    assert drawn(100).tolist() == drawn(100).tolist()
    assert drawn(100).tolist() != drawn(100, seed=1).tolist()
    assert set(drawn(20)) <= set(drawn(50))


N = 200


@pytest.fixture
def folders(tmp_path: Path) -> list[RunFolder]:
    """Two runs of one scene; some rows of each are errors."""
    made = []
    for seed in (0, 1):
        rows = own(random_rows(N, seed=seed))
        rows["outcome"][:5] = Outcome.ERROR
        made.append(record(tmp_path / f"s{seed}", made_scene(), rows, seed=seed, evaluations=N))
    return made


def own(rows: Rows) -> Rows:
    """Rows as wide as those of a run with the default method."""
    return reshape_rows(rows, RowShape(genes=36, joints=2))


def test_rows_on_which_the_other_engine_failed_are_counted_apart_and_in_no_table(tmp_path, monkeypatch):
    rows = own(random_rows(3))
    rows["outcome"] = (Outcome.HELD, Outcome.DROPPED, Outcome.DROPPED)
    folder = record(tmp_path / "run", made_scene(), rows, protocol="physical")

    now = rows.copy()
    now["outcome"] = (Outcome.HELD, Outcome.SHAKEN, Outcome.ERROR)
    monkeypatch.setattr(verify, "score_genomes", lambda *_: now)
    config, display = LocalJobConfig(workers=1), None
    found = compare_engine(folder, "mujoco", None, 0, config, display, Stop())  # type: ignore[arg-type]
    assert found is not None
    assert (found.rows, found.failed, found.same_verdict) == (2, 1, 2)
    assert found.outcomes == {"held": {"held": 1}, "dropped": {"shaken": 1}}
    assert "mujoco failed on 1 more" in found.table
    assert len(read_table(Path(found.file))) == 2
    Path(found.file).write_text("row,outcome\n3,held\n")
    monkeypatch.setattr(verify, "score_genomes", lambda *_: pytest.fail("it was simulated"))
    with pytest.raises(InputError, match=r"is no table that .*; remove it"):
        compare_engine(folder, "mujoco", None, 0, config, display, Stop())  # type: ignore[arg-type]


def test_nothing_to_choose_from_is_refused(tmp_path: Path) -> None:
    empty = record(tmp_path / "empty", made_scene(), random_rows(0))
    with pytest.raises(InputError, match="Nothing is recorded there"):
        choose_rows([empty], None, 0)


def test_many_rows_are_several_lots(tmp_path: Path) -> None:
    folder = record(tmp_path / "many", made_scene(), random_rows(MOST_ROWS + 10))
    assert [len(lot.numbers) for lot in choose_rows([folder], None, 0)] == [MOST_ROWS, 10]


def test_lots_are_the_runs_of_a_job_one_after_the_other(folders: list[RunFolder]) -> None:
    lots = ReevaluationQueue(choose_rows(folders, 20, 0))
    assert lots.extent.evaluations == 20
    first = lots.next()
    lots.put_back(first.run)
    again, second = lots.next(), lots.next()
    assert second is not None
    assert (again.run, lots.next()) == (first.run, None)
    assert first.prior == "given"


def test_what_differs_is_noted_by_row_and_column(folders: list[RunFolder]) -> None:
    (lot,) = choose_rows(folders[:1], None, 0)
    found, recorded = ReevaluationQueue([lot]), lot.rows()
    now = recorded.copy()
    now["fitness"][1] += 1
    now["outcome"][0] = Outcome.HELD  # it failed before
    for place in range(3):
        found.add_row(lot, recorded, place, now[place], "it failed again")
    differ = [(each.number, *each.columns) for each in found.different]
    assert differ == [(0, "outcome"), (1, "fitness")]
    assert (dict(found.columns), sum(found.outcomes.values())) == ({"outcome": 1, "fitness": 1}, 3)
