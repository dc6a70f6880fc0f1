"""The rows of runs, from their journals."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.benchmarks.results.measure import harvest
from tests.benchmarks.results.programme import Programme, Wanted
from tests.benchmarks.results.row import Row
from tests.benchmarks.results.store import Store
from tests.coordinator.recorded_runs import SHAPE, random_rows
from tests.results.make_rows import BEFORE, TODAY

from qdgrasp_assets.catalog import build_scene
from qdgrasp_assets.scene import pack_scene
from qdgrasp_coordinator.analysis.target import Targets
from qdgrasp_coordinator.counts.stretch import Stretch
from qdgrasp_coordinator.folders.folder import RunFolder
from qdgrasp_coordinator.folders.journal_format import Identity
from qdgrasp_coordinator.folders.journal_writer import JournalWriter
from qdgrasp_protocol.outcome import Outcome
from qdgrasp_protocol.rows import Rows
from qdgrasp_protocol.spec import RunSpec, to_toml

BUNDLE = pack_scene(build_scene(RunSpec(gripper="panda", object="tennis_ball")))
ROWS = random_rows(300)
CODE = {"code": TODAY * 4, "numpy": "2"}


def record(path: Path, rows: Rows = ROWS, platform: dict[str, str] = CODE, **settings: Any) -> RunFolder:
    """A run's folder with these rows, in blocks of ten."""
    values = {"gripper": "panda", "object": "tennis_ball", "method": "me_rand", "population": 10}
    spec = RunSpec(**{**values, "evaluations": 300, "overlaps": "count", **settings})  # type: ignore[arg-type]
    folder = RunFolder.create(path, spec, BUNDLE)
    with JournalWriter.create(path, Identity("run", to_toml(spec), BUNDLE.digest, SHAPE)) as journal:
        journal.set_platform(platform)
        journal.begin_turn(1, 0.0)
        for first in range(0, len(rows), 10):
            part = rows[first : first + 10]
            journal.append(Stretch(first, part, float(np.sum(part["outcome"] >= Outcome.DROPPED))), 1, 1.0)
    return folder


def rows_of(path: Path, *budgets: int) -> list[Row]:
    return list(harvest(path, lambda asked: {asked.budget, *budgets}, Targets()))


class TestHarvest:
    def test_a_finished_run_has_a_row(self, tmp_path) -> None:
        record(tmp_path / "run")
        (row,) = rows_of(tmp_path / "run")
        assert (row.code, row.evaluations, row.proposals) == (TODAY, 300, 0)
        assert row.grasps >= row.robust > 0
        assert 0 < (row.mean_best or 0) <= 2

    def test_an_unfinished_run_has_none(self, tmp_path) -> None:
        record(tmp_path / "run", evaluations=301)
        assert rows_of(tmp_path / "run") == []

    def test_a_longer_run_has_the_row_of_the_shorter_one(self, tmp_path) -> None:
        record(tmp_path / "long")
        record(tmp_path / "short", ROWS[:200], evaluations=200)
        (short,) = rows_of(tmp_path / "short")
        part, whole = rows_of(tmp_path / "long", 200)
        assert (part.budget, whole.budget) == (200, 300)
        assert {name: getattr(part, name) for name in part.__struct_fields__ if name != "wall_seconds"} == {
            name: getattr(short, name) for name in short.__struct_fields__ if name != "wall_seconds"
        }

    def test_an_unfinished_run_has_the_rows_of_what_it_has_spent(self, tmp_path) -> None:
        record(tmp_path / "run", evaluations=1000)
        assert [row.budget for row in rows_of(tmp_path / "run", 200, 900)] == [200]

    def test_a_budget_ends_with_a_counted_row_when_overlaps_are_redrawn(self, tmp_path) -> None:
        record(tmp_path / "run", evaluations=1000, overlaps="redraw")
        (row,) = rows_of(tmp_path / "run", 50)
        assert row.evaluations == row.simulated == 50

    def test_what_a_success_costs_is_read_from_the_blocks(self, tmp_path) -> None:
        record(tmp_path / "run")
        (row,) = rows_of(tmp_path / "run")
        assert row.success_ms == pytest.approx(1000.0)


class TestStore:
    def store(self, path: Path, *current: str) -> Store:
        spec = RunSpec(
            gripper="panda", object="tennis_ball", method="me_rand", population=10, overlaps="count"
        )
        return Store(path / "results" / "runs.csv", Programme({"some": (Wanted("a", spec),)}), set(current))

    def test_adding_twice_changes_nothing(self, tmp_path) -> None:
        record(tmp_path / "run")
        store = self.store(tmp_path, TODAY)
        assert store.add([tmp_path / "run"]).new == 1
        before = store.file.read_bytes()
        assert store.add([tmp_path / "run"]).new == 0
        assert store.file.read_bytes() == before

    def test_the_page_is_written_with_the_table(self, tmp_path) -> None:
        record(tmp_path / "run")
        store = self.store(tmp_path, TODAY)
        store.add([tmp_path / "run"])
        assert "0 of the 1 runs" in (store.file.parent / "index.md").read_text()

    def test_a_run_of_older_code_is_left_out_and_said_so(self, tmp_path) -> None:
        record(tmp_path / "new")
        record(tmp_path / "old", ROWS[::-1].copy(), {"code": BEFORE * 4})
        store = self.store(tmp_path, TODAY)
        store.add([tmp_path / "new"])
        found = store.add([tmp_path / "old"])
        assert (found.new, found.kept) == (0, 1)
        assert "1 of other code were left out" in found.words
