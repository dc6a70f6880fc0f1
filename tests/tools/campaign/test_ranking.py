"""Choice of the grasps that are scored again, and their ranks."""

import csv
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from tests.coordinator.recorded_runs import record_spec

from qdgrasp_coordinator.metrics.cells import MIDDLES, GenomeReader, cell_keys, cells
from qdgrasp_coordinator.metrics.successes import TrialPlan, all_successes, best_first
from qdgrasp_coordinator.search.source_runs import best_of_kinds, is_reranking, kinds_of_run, source_file
from qdgrasp_coordinator.storage.run_folder import RunFolder
from qdgrasp_protocol.rows import Gene, Layout, Outcome, Rows, RowShape
from qdgrasp_protocol.spec import RunSpec
from qdgrasp_tools.campaign.ranking import rank_poses, write_ranking

SHAPE = RowShape(genes=7, joints=2)
TRIALS = 100


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


def test_of_equals_the_harder_trials_decide_and_then_how_little_the_object_moved() -> None:
    found = RowShape(genes=7, joints=2, contact_slots=1).empty(5)
    found["index"], found["outcome"], found["fitness"] = np.arange(5), Outcome.HELD, 6
    found["base_to_object"][:, 6] = found["settled"][:, 6] = 1
    found["settled"][:, 0] = [0.009, 0.003, 0.002, 0.001, 0.004]
    found["settled"][3] = 0  # not recorded
    assert best_first(found).tolist() == [2, 1, 4, 0, 3]
    scores, hard = np.array([0.9, 0.9, 0.9, 0.9, 1.0]), np.array([0.7, np.nan, 0.2, 0.7, 0.0])
    assert best_first(found, scores, hard).tolist() == [4, 0, 3, 2, 1]


def test_trials_after_the_hundredth_count_apart_from_eta() -> None:
    found = rows(Outcome.HELD, Outcome.MISSED, Outcome.HELD)
    trials = np.repeat(found[[0, 2]], TRIALS + 2)
    trials["trial"], trials["fitness"] = np.tile(np.arange(1, TRIALS + 3), 2), 6
    trials["fitness"][[TRIALS, TRIALS + 1]] = [0, 3]
    plan = TrialPlan(TRIALS + 2, 6)
    known = all_successes(np.concatenate([found, trials]), plan)
    assert plan.eta(known.scores).tolist() == [1, 1]
    assert known.eta_hard.tolist() == [0.25, 1]
    assert known.trials.tolist() == [TRIALS, TRIALS]
    lacking = all_successes(np.concatenate([found, trials[:-1]]), plan)
    assert np.isnan([lacking.scores[1], lacking.eta_hard[1]]).all()


@given(st.integers(0, 2**32), st.integers(1, 60))
def test_the_best_of_each_cell_are_taken_whatever_the_order_of_rows(seed: int, most: int) -> None:
    random = np.random.default_rng(seed)
    found = rows(*[Outcome.HELD] * 60)
    found["descriptor"] = random.integers(0, 3, (60, 3)) / 100
    for column, high in (("fitness", 3), ("penetration", 2), ("contacts", 3)):
        found[column] = random.integers(0, high, 60)
    chosen = best_of_kinds(found)[:most]
    assert best_of_kinds(random.permutation(found))[:most].tobytes() == chosen.tobytes()
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
    assert best_of_kinds(found, kinds)[:4]["index"].tolist() == chosen


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
    assert [(line[1], *line[4:9]) for line in rank_poses(folder)] == [
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
