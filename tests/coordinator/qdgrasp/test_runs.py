"""Runs as a program reads them."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.coordinator.recorded_runs import random_rows, record
from tests.coordinator.scenes import made_scene

import qdgrasp
from qdgrasp_protocol.errors import FolderError, ImpossibleValue, UnknownName
from qdgrasp_protocol.rows import RowShape

GIVEN = RowShape(genes=7, joints=2)


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> qdgrasp.Run:
    path = tmp_path_factory.mktemp("runs") / "mine"
    few = random_rows(300)
    rows = GIVEN.empty(len(few))
    for name in few.dtype.names:
        if name != "genome":
            rows[name] = few[name]
    rows["genome"] = rows["base_to_object"]
    poses = tuple(tuple(map(float, pose)) for pose in rows["genome"][:1])
    record(path, made_scene(), rows, method="given", poses=poses, evaluations=1)
    return qdgrasp.open(path)


def test_a_run_says_what_was_asked_for(run: qdgrasp.Run) -> None:
    assert run.spec.gripper == "jaw"
    assert run.scene.object.name == "block"
    assert run.layout.names == ("x", "y", "z", "qx", "qy", "qz", "qw")
    assert run.summary.rows == 300


def test_grasps_are_those_that_survived_a_shake(run: qdgrasp.Run) -> None:
    rows, grasps = run.rows(), run.grasps()
    assert len(rows) == 300
    assert grasps.numbers.tolist() == np.flatnonzero(rows["outcome"] >= qdgrasp.Outcome.SHAKEN).tolist()
    assert [grasp.number for grasp in grasps] == grasps.numbers.tolist()
    assert grasps.poses("com")[:, :3] == pytest.approx(rows["base_to_object"][grasps.numbers][:, :3])
    assert grasps.matrices().shape == (len(grasps), 4, 4)


def test_the_best_and_the_well_spread_are_some_of_them(run: qdgrasp.Run) -> None:
    robust = run.grasps(min_fitness=2)
    assert (robust.fitness == 2).all()
    assert len(run.grasps(top=7)) == 7
    assert (run.grasps(top=7).fitness == 2).all()
    assert set(run.grasps(min_fitness=2, diverse=5).numbers) < set(robust.numbers)


@pytest.mark.parametrize(
    "asked", [{"top": -5}, {"diverse": -5}, {"top": 2.5}, {"min_fitness": "a"}, {"min_fitness": float("nan")}]
)
def test_what_cannot_be_asked_for_is_refused(run: qdgrasp.Run, asked: dict[str, Any]) -> None:
    with pytest.raises(ImpossibleValue, match="not less than 0"):
        run.grasps(**asked)


def test_a_frame_that_is_none_is_refused(run: qdgrasp.Run) -> None:
    with pytest.raises(UnknownName, match=r"Unknown frame 'world'\. Known: com, mesh\."):
        run.grasps().poses("world")  # type: ignore[arg-type]


def test_blocks_are_the_rows_piece_by_piece(run: qdgrasp.Run) -> None:
    assert np.concatenate(list(run.blocks())).tobytes() == run.rows().tobytes()


def test_a_run_is_shown_as_it_was_opened(run: qdgrasp.Run) -> None:
    assert repr(run) == f"qdgrasp.open('{run.path}')"


def test_grasps_are_shown_in_a_few_words(run: qdgrasp.Run) -> None:
    assert repr(run.grasps(top=7)) == "<7 grasps of jaw on block>"


def test_a_run_that_has_nothing_yet_has_no_rows(tmp_path: Path) -> None:
    empty = record(tmp_path / "empty", made_scene(), GIVEN.empty(0), method="given", evaluations=1)
    assert len(qdgrasp.open(empty.path).rows()) == 0
    assert len(qdgrasp.open(str(empty.path)).grasps()) == 0


def test_a_folder_without_a_run_is_refused(tmp_path: Path) -> None:
    with pytest.raises(FolderError, match="holds no run"):
        qdgrasp.open(tmp_path)


@pytest.mark.parametrize("path", [3, None])
def test_what_is_no_path_is_refused(path: Any) -> None:
    with pytest.raises(ImpossibleValue, match="path must be a path"):
        qdgrasp.open(path)
