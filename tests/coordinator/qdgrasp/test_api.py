"""Names of `import qdgrasp`, and the time of their loading."""

import ast
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.coordinator.recorded_runs import random_rows, record
from tests.coordinator.scenes import made_scene
from tests.worker.runtime import evaluators

import qdgrasp
from qdgrasp.evaluator_worker import evaluator_name
from qdgrasp_protocol.errors import FolderError, ImpossibleValue, InputError
from qdgrasp_protocol.rows import RowShape

SOURCE = ast.parse(Path(qdgrasp.__file__).read_text())


def loaded_by(code: str) -> list[str]:
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, check=True, text=True)
    return done.stdout.split()


def test_nothing_is_loaded_before_it_is_used() -> None:
    loaded = loaded_by(
        "import sys; before = set(sys.modules); import qdgrasp; print(*(set(sys.modules) - before))"
    )
    assert {name.partition(".")[0] for name in loaded} <= {"qdgrasp", *sys.stdlib_module_names}
    assert "qdgrasp.evaluations" not in loaded


def test_a_run_is_read_without_a_bus_or_a_simulator() -> None:
    loaded = loaded_by("import sys, qdgrasp; qdgrasp.open; print(*sys.modules)")
    assert "numpy" in loaded
    assert not {"zenoh", "pybullet"} & set(loaded)


def test_what_a_type_checker_sees_is_what_there_is() -> None:
    seen = {
        alias.name: node.module
        for block in SOURCE.body
        if isinstance(block, ast.If)
        for node in block.body
        if isinstance(node, ast.ImportFrom)
        for alias in node.names
    }
    assert seen == qdgrasp.HOMES
    assert set(dir(qdgrasp)) == {*seen, "__version__"}


def test_an_evaluator_in_a_package_goes_by_the_name_of_its_module() -> None:
    assert evaluator_name(evaluators.Height) == "tests.worker.runtime.evaluators:Height"


@pytest.mark.parametrize("evaluator", [evaluators.nested(), lambda scene: evaluators.Height(scene), 3])
def test_an_evaluator_that_no_other_process_finds_is_refused(evaluator: object) -> None:
    with pytest.raises(InputError, match="at the top of a module"):
        evaluator_name(evaluator)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("said", "why"),
    [
        ({"workers": 0}, "'--workers': it must be greater than or equal to 1"),
        ({"connect": "here"}, "'here' is not an endpoint"),
        ({"wait": "long"}, "'--wait'"),
    ],
)
def test_how_it_cannot_be_served_is_refused(said: dict[str, Any], why: str) -> None:
    with pytest.raises(InputError, match=why):
        qdgrasp.serve(evaluators.Height, **said)


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


def test_grasps_are_those_that_survived_a_shake(run: qdgrasp.Run) -> None:
    rows, grasps = run.rows(), run.grasps()
    assert len(rows) == 300
    assert grasps.numbers.tolist() == np.flatnonzero(rows["outcome"] >= qdgrasp.Outcome.SHAKEN).tolist()
    assert [grasp.number for grasp in grasps] == grasps.numbers.tolist()
    assert grasps.poses("com")[:, :3] == pytest.approx(rows["base_to_object"][grasps.numbers][:, :3])
    assert grasps.matrices().shape == (len(grasps), 4, 4)


def test_the_best_and_the_well_spread_are_some_of_them(run: qdgrasp.Run) -> None:
    rows, robust = run.rows(), run.grasps(min_fitness=2)
    assert (robust.fitness == 2).all()
    assert len(run.grasps(top=7)) == 7
    both = run.grasps(top=7, failures=True)
    assert both.numbers[:7].tolist() == run.grasps(top=7).numbers.tolist()
    simulated = rows["outcome"] >= qdgrasp.Outcome.MISSED
    assert both.numbers[7:].tolist() == np.flatnonzero(simulated & (rows["fitness"] == 0)).tolist()
    assert (run.grasps(top=7).fitness == 2).all()
    assert set(run.grasps(min_fitness=2, diverse=5).numbers) < set(robust.numbers)


@pytest.mark.parametrize(
    "asked", [{"top": -5}, {"diverse": -5}, {"top": 2.5}, {"min_fitness": "a"}, {"min_fitness": float("nan")}]
)
def test_what_cannot_be_asked_for_is_refused(run: qdgrasp.Run, asked: dict[str, Any]) -> None:
    with pytest.raises(ImpossibleValue, match="not less than 0"):
        run.grasps(**asked)


def test_a_folder_without_a_run_is_refused(tmp_path: Path) -> None:
    with pytest.raises(FolderError, match="holds no run"):
        qdgrasp.open(tmp_path)


def test_an_archive_of_pyribs_has_the_best_success_of_each_cell(tmp_path: Path) -> None:
    record(tmp_path / "run", made_scene(), random_rows(300), evaluations=300)
    run = qdgrasp.open(tmp_path / "run")
    archive, rows = run.archive(), run.grasps(min_fitness=0).rows
    cells = np.rint(100 * rows["descriptor"][:, :3].astype(np.float64)).astype(int)
    best = {}
    for cell, fitness in zip(map(tuple, cells.tolist()), rows["fitness"].tolist(), strict=True):
        best[cell] = max(fitness, best.get(cell, 0))
    kept = {tuple(np.rint(100 * one["measures"]).astype(int).tolist()): one["objective"] for one in archive}
    assert kept
    assert kept.items() <= best.items()
    assert len(archive.data(return_type="pandas")) == len(kept)
