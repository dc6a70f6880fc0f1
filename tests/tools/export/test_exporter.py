"""`qdgrasp export`: the grasps that it takes, the files that it writes, and its refusals."""

from pathlib import Path

import numpy as np
import pytest
from tests.coordinator.recorded_runs import record
from tests.tools.export.conftest import MakeRun, random_rows
from tests.tools.export.independent_readers import READERS
from typer.testing import CliRunner, Result

import qdgrasp
from qdgrasp_assets.scene import Scene
from qdgrasp_coordinator.storage.engine_table import write_table
from qdgrasp_coordinator.storage.run_folder import RunFolder
from qdgrasp_protocol.errors import InputError
from qdgrasp_protocol.rows import SHAKES, TRIALS, Outcome, Rows
from qdgrasp_tools.cli.main import app
from qdgrasp_tools.export.exporter import export_grasps
from qdgrasp_tools.export.grasp_reader import GraspChoice, read_run


def command(*arguments: object) -> Result:
    return CliRunner().invoke(app, ["export", *map(str, arguments)])


def refusal(run: Path, name: str, out: Path, *more: object) -> str:
    error = command(run, "--format", name, "-o", out, *more).exception
    assert isinstance(error, InputError)
    return str(error)


def test_a_format_or_frame_that_is_none_is_refused(run, tmp_path) -> None:
    out = tmp_path / "out"
    assert "Did you mean 'isaac'?" in refusal(run.path, "isac", out)
    assert "Unknown frame 'world'" in refusal(run.path, "csv", out, "--frame", "world")
    assert "no place for failures" in refusal(run.path, "isaac", out, "--negatives", 1)


def test_where_no_grasp_is_to_be_written_it_is_said_what_there_is(make_run: MakeRun, tmp_path: Path) -> None:
    weak, none = make_run(*[Outcome.DROPPED] * 3, name="weak"), make_run(Outcome.MISSED, name="none")
    out = tmp_path / "out"
    assert "among 3 successes, whose fitness is at most 0" in refusal(weak.path, "csv", out)
    assert "among 0 successes" in refusal(none.path, "csv", out)
    assert not out.exists()
    assert "among 0 successes" in refusal(make_run(name="new").path, "csv", out)


@pytest.mark.parametrize("settings", [{"protocol": "physical"}, {"protocol": "robust", "base": "physical"}])
def test_under_physical_grasps_survived_every_push_unless_it_is_asked(make_run, tmp_path, settings) -> None:
    run, out = make_run(Outcome.SHAKEN, Outcome.MISSED, Outcome.HELD, **settings), tmp_path / "out"
    for asked, expected in ((None, [6]), (1, [3, 6])):
        export_grasps(run, out, "csv", GraspChoice(min_fitness=asked), force=True)
        assert READERS["csv"](out).beside["fitness"].astype(float).tolist() == expected
        assert f"\n# min_fitness: {asked or 6}\n" in out.read_text()
        assert qdgrasp.open(run.path).grasps(min_fitness=asked).fitness.tolist() == expected
    weak = make_run(Outcome.SHAKEN, name="weak", **settings)
    said = refusal(weak.path, "csv", tmp_path / "none")
    assert "among 1 success, whose fitness is at most 3" in said
    rows = random_rows(run.scene(), [Outcome.SHAKEN, Outcome.HELD])  # a custom evaluator's: held, fitness 2
    custom = record(tmp_path / "custom", run.scene(), rows, method="contact_rand", **settings)
    assert export_grasps(custom, out, "csv", force=True).startswith("1 grasp ")
    assert "\n# min_fitness: 2\n" in out.read_text()
    assert command(weak.path, "--format", "csv", "-o", out, "--min-fitness", 7).exit_code == 2


@pytest.mark.parametrize(
    ("asked", "least", "expected"), [(None, 1, 6), (0, 1, 0), (3, 1, 3), (100, 1, 6), (None, 0, 6)]
)
def test_failures_are_written_once_as_many_as_are_asked_for(run, tmp_path, asked, least, expected) -> None:
    export_grasps(run, tmp_path / "out", "graspgen", GraspChoice(min_fitness=least), negatives=asked)
    read = READERS["graspgen"](tmp_path / "out")
    assert (np.count_nonzero(~read.quality), np.count_nonzero(read.quality)) == (expected, 4)
    assert len(np.unique(read.matrices.reshape(-1, 16), axis=0)) == expected + 4


def trials_of(rows: Rows, totals: list[int]) -> Rows:
    """The trials of successes, whose fitness sums up to these totals."""
    repeated = np.repeat(rows, TRIALS)
    repeated["trial"] = np.tile(np.arange(1, TRIALS + 1), len(rows))
    held = repeated["trial"] <= np.repeat(totals, TRIALS) // SHAKES
    repeated["fitness"] = np.where(held, SHAKES, 0)
    return repeated


def test_confidence_is_eta_where_all_trials_are_there(scene: Scene, tmp_path: Path) -> None:
    rows = random_rows(scene, [Outcome.SHAKEN, Outcome.MISSED, Outcome.HELD, Outcome.HELD])
    successes = rows[[0, 2, 3]]
    journal = np.concatenate([rows, trials_of(successes, [150, 40, 90])[:-1]])  # the last trial is to come
    run = record(tmp_path / "run", scene, journal, method="contact_rand", protocol="robust")
    grasps = read_run(run)
    np.testing.assert_allclose(grasps.eta, [0.75, 0.2, np.nan])
    np.testing.assert_allclose(grasps.confidence, [0.75, 0.2, 1.0])
    export_grasps(run, tmp_path / "out", "csv", GraspChoice(top=1))
    assert READERS["csv"](tmp_path / "out").quality.tolist() == [0.75]


def judge(run: RunFolder, *now: Outcome) -> None:
    """Give the first successes of a run these verdicts in MuJoCo."""
    found = read_run(run)[: len(now)]
    rows = found.rows.copy()
    rows["outcome"], rows["fitness"] = now, [max(0, one - Outcome.DROPPED) for one in now]
    write_table(run, "mujoco", found.numbers, found.rows, rows)


def test_only_what_holds_in_the_other_engine_is_written_and_what_is_not_known_is_counted(make_run, tmp_path):
    run = make_run(*[Outcome.HELD] * 4, Outcome.SHAKEN, Outcome.DROPPED)
    assert "run 'qdgrasp verify DIR --engine mujoco --all' first" in refusal(
        run.path, "csv", tmp_path / "out.csv", "--holds-in", "mujoco"
    )
    judge(run, Outcome.HELD, Outcome.SHAKEN, Outcome.HELD)
    said = command(run.path, "--format", "csv", "-o", tmp_path / "out.csv", "--holds-in", "mujoco")
    assert said.stdout.startswith("2 grasps written")
    assert said.stdout.endswith("Left out: 2 grasps whose verdict in mujoco is not known.\n")
    lines = [line for line in (tmp_path / "out.csv").read_text().splitlines() if not line.startswith("#")]
    assert [line.split(",")[0] for line in lines] == ["number", "0", "2"]
    judge(run, Outcome.OVERLAP, Outcome.SHAKEN, Outcome.DROPPED)
    refused = refusal(run.path, "csv", tmp_path / "none.csv", "--holds-in", "mujoco")
    assert "has no such grasp" in refused
    assert "Unknown engine 'mujoca'" in refusal(run.path, "csv", tmp_path / "a", "--holds-in", "mujoca")
