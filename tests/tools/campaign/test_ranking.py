"""Choice of the grasps that are scored again, and their ranks."""

import csv
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from tests.coordinator.recorded_runs import record_spec
from tests.coordinator.scenes import made_scene

from qdgrasp_coordinator.metrics import successes
from qdgrasp_coordinator.metrics.cells import MIDDLES, GenomeReader, cell_keys, cells
from qdgrasp_coordinator.storage.run_folder import RunFolder
from qdgrasp_protocol.rows import Gene, Layout, Outcome, Rows, RowShape
from qdgrasp_protocol.spec import RunSpec
from qdgrasp_tools.campaign.source_runs import (
    best_of_kinds,
    is_reranking,
    kinds_of_run,
    rank_poses,
    source_file,
    write_ranking,
)

SHAPE = RowShape(genes=7, joints=2)
TRIALS = 100
BODY = made_scene().object


def spec(protocol: str = "paper", population: int = 50) -> RunSpec:
    return RunSpec(gripper="hand", object="thing", protocol=protocol, population=population)  # type: ignore[arg-type]


def rows(*outcomes: Outcome) -> Rows:
    made = SHAPE.empty(len(outcomes))
    made["index"], made["outcome"] = np.arange(len(outcomes)), outcomes
    made["fitness"] = np.maximum(np.array(outcomes, np.float32) - Outcome.DROPPED, 0)
    made["descriptor"][:, 0] = np.arange(len(outcomes)) / 100  # a cell each
    return made


def trials_of(row: np.void, total: int) -> Rows:
    """A hundred trials of a row that survive `total` shakes."""
    made = np.repeat(row, TRIALS)
    made["trial"] = np.arange(1, TRIALS + 1)
    made["fitness"] = np.where(np.arange(TRIALS) < total // 2, 2, 0)
    made["fitness"][-1] = total % 2
    return made


def test_of_equal_fitness_the_greater_margin_is_better_whatever_the_penetration(monkeypatch) -> None:
    asked: list[int] = []

    def margins(rows: Rows, body: object) -> NDArray[np.float64]:
        asked.extend(rows["index"].tolist())
        return np.array([0.02, np.nan, 0.0, 0.03])[rows["index"]]

    monkeypatch.setattr(successes, "recorded_margins", margins)
    found = rows(*[Outcome.HELD] * 3, Outcome.SHAKEN)
    found["penetration"] = [0.003, 0.001, 0.002, 0.0]
    assert best_of_kinds(found, 3, BODY)["index"].tolist() == [0, 2, 1]
    assert asked == [0, 1, 2]  # the fourth cannot be among the best


@given(st.integers(0, 2**32), st.integers(1, 60))
def test_the_best_of_each_cell_are_taken_whatever_the_order_of_rows(seed: int, most: int) -> None:
    random = np.random.default_rng(seed)
    found = rows(*[Outcome.HELD] * 60)
    found["descriptor"] = random.integers(0, 3, (60, 3)) / 100
    for column, high in (("fitness", 3), ("penetration", 2), ("contacts", 3)):
        found[column] = random.integers(0, high, 60)
    chosen = best_of_kinds(found, most, BODY)
    assert best_of_kinds(random.permutation(found), most, BODY).tobytes() == chosen.tobytes()
    places = cell_keys(cells(chosen["descriptor"]))
    assert len(set(places)) == len(chosen) == min(most, len(set(cell_keys(cells(found["descriptor"])))))
    for place, row in zip(places, chosen, strict=True):
        assert row["fitness"] == found["fitness"][cell_keys(cells(found["descriptor"])) == place].max()


@pytest.mark.parametrize(
    ("diversity", "chosen"),
    [(None, [0]), ("position", [0]), ("orientation", [0, 1]), ("contact", [0])],
)
def test_grasps_are_told_apart_as_the_search_did(diversity, chosen) -> None:
    found = rows(*[Outcome.HELD] * 3)
    found["descriptor"], found["base_to_object"][:, 3:] = 0, MIDDLES[[0, 1, 0]]
    reader = GenomeReader(Layout("given", (Gene("synergy", 0.0, 3.0),)))
    found["genome"][:, 0] = [0.0, 0.0, 2.0]
    asked = RunSpec(gripper="hand", object="thing", diversity=diversity)
    kinds = kinds_of_run(asked, found, reader)
    assert best_of_kinds(found, 4, BODY, kinds)["index"].tolist() == chosen


def test_a_ranking_is_by_eta_and_names_the_rows_that_it_came_from(tmp_path: Path) -> None:
    source = rows(*[Outcome.HELD] * 4)
    source["generation"], source["index"] = 7, [11, 3, 5, 2]
    again = rows(Outcome.HELD, Outcome.HELD, Outcome.MISSED, Outcome.SHAKEN)
    sums = (20, 150, None, 150)
    trials = [trials_of(row, total) for row, total in zip(again, sums, strict=True) if total is not None]
    folder = record_spec(tmp_path / "again", spec("robust"), np.concatenate([again, *trials]))
    assert not is_reranking(folder)
    (noted,) = source_file(RunFolder(tmp_path / "first"), source).items()
    (folder.path / noted[0]).write_bytes(noted[1])
    assert is_reranking(folder)
    assert [(line[1], *line[3:8]) for line in rank_poses(folder)] == [
        (0.75, 100, 2, 7, 3, 2),
        (0.75, 100, 1, 7, 2, 2),
        (0.1, 100, 2, 7, 11, 2),
        (0.0, 0, 0, 7, 5, 2),
    ]
    assert "4 grasps ranked" in write_ranking(folder)
    with (folder.path / "ranking.csv").open() as file:
        lines = list(csv.DictReader(file))
    assert [line["rank"] for line in lines] == ["1", "2", "3", "4"]
    assert [line["eta_error"] for line in lines[:3]] == ["0.043519414", "0.043519414", "0.0301511345"]
    assert [line["source_index"] for line in lines] == ["3", "2", "11", "5"]
    assert [line["cell_x"] for line in lines] == ["1", "3", "0", "2"]
